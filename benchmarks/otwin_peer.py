"""Forecasts with bands: otwin and twinmatch on recordings of real plants, from the same origins.

The recordings are not part of the project: TWINMATCH_RECORDINGS and TWINMATCH_PLANT_RECORDINGS name their
folders, and absent ones are skipped. Both programs get the recorded inputs and disturbances of the future,
because a loop in otwin has no memory of its own. `python -m benchmarks.otwin_peer` needs otwin.

otwin is used as its documentation advises: a network of its thermal components with the free parameters of
our structures, what they lack as a symbolic residual, a fit by its simulation, the extended Kalman filter
with the drift whose normalised innovations are nearest one, and a band from `horizon_conformal` on the errors
of its own earlier forecasts. It fits again before every fifth forecast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from benchmarks.common import Row, main, measure_side_by_side, peer, rows_of
from tests.support.places import OTHERS, RECORDINGS
from twinmatch.dynamics import Plant
from twinmatch.forecasting import CONFIDENCE, Band, Forecast
from twinmatch.importing import open_any
from twinmatch.importing.mapped import map_samples, with_plant_names
from twinmatch.importing.recordings import session_of
from twinmatch.importing.tables import read_table
from twinmatch.offline.backtest import Card, Choices, Marked, backtest, cards, marks
from twinmatch.offline.judging import terms_from_files
from twinmatch.plants import Incubator, Peltier, TCLab
from twinmatch.sampling.sources import parse_map
from twinmatch.sessions import Session
from twinmatch.signals import KELVIN, FloatArray, Window, stretches

HORIZONS: Final = (60.0, 300.0)
"""Seconds."""
LEARNT = 0.15
SCORED = 0.4
"""Shares of a recording after which otwin's errors count for its band, and after which both are scored."""
REFIT: Final = 5
"""Forecasts after which otwin's parameters are fitted again."""
DRIFTS: Final = (0.003, 0.03, 0.3)
"""Drifts of every temperature from the equations in one sample, K, that its Kalman filter may assume."""

_Terms = tuple[dict[str, Any], dict[str, float]]


@dataclass(frozen=True)
class Recording:
    """A recording, and its plant as a network of masses."""

    title: str
    plant: type[Plant]
    path: Path
    every: float
    """Time between two forecasts, s."""
    masses: Mapping[str, float]
    """Heat capacities, J/K."""
    links: Mapping[str, tuple[str, str, float]]
    """Two masses, or a mass and the room, and the conductance between them, W/K."""
    heated: Mapping[str, float]
    """Masses heated by the input and then by disturbances, and their power, W per unit."""
    seen: str
    """The mass whose temperature is measured."""
    free: tuple[str, ...]
    columns: tuple[str, ...] = ()
    """Columns of a table by signal, as for `twinmatch import --map`."""
    residual: Callable[[Any, ModuleType, float], _Terms] | None = None
    """What the components lack: terms by state, and start values of its parameters; its last argument is the
    temperature that the network calls zero, K."""
    room: float | None = None
    """Temperature of the room, K; None: the last disturbance, or where there is none the first reading."""

    def read(self) -> Session:
        """The recording as a session."""
        if not self.columns:
            return open_any(self.path)
        table = read_table(self.path)
        given = with_plant_names(table, self.plant, parse_map(self.columns))
        mapped = map_samples(table, given, self.plant)
        return session_of(
            self.path, mapped.samples, plant=self.plant.name, has_reference=False
        )


def _thermoelectric(model: Any, expr: ModuleType, zero: float) -> _Terms:
    """The rig's electrical side, with the constants of its plant file."""
    plate = model.symbol("plate.temperature")
    sink = model.symbol("sink.temperature")
    command = model.symbol("plate_heater")
    seebeck = model.parameter("seebeck")
    across = (-12.0 * command / 255.0 - seebeck * (sink - plate)) / 3.4
    current = expr.maximum(-5.0, expr.minimum(5.0, across))
    joule = 0.5 * 3.3 * current * current
    return {
        "plate.heat": joule
        - seebeck * (plate + zero) * current
        - command,  # the component's own heat is not there
        "sink.heat": joule
        + seebeck * (sink + zero) * current
        + model.parameter("load"),
    }, {"seebeck": 0.06, "load": 0.0}


def _radiation(model: Any, _: ModuleType, zero: float) -> _Terms:
    """Of the heater of a kit: emissivity, Stefan's constant and its area."""
    heater = model.symbol("heater.temperature") + zero
    return {"heater.heat": -0.9 * 5.67e-8 * 10e-4 * (heater**4 - zero**4)}, {}


_KIT = {
    "plant": TCLab,
    "every": 10.0,
    "seen": "sensor",
    "residual": _radiation,
}
_HEATER = {"lag": ("heater", "sensor", 0.006), "loss": ("heater", "room", 0.006)}


def recordings() -> list[Recording]:
    """All of them, here or not."""
    rig = {
        "plant": Peltier,
        "every": 60.0,
        "masses": {"plate": 28.0, "sink": 300.0},
        "links": {"module": ("plate", "sink", 0.6), "loss": ("sink", "room", 4.0)},
        "heated": {"plate": 1.0},
        "seen": "plate",
        "free": (
            "plate.capacity",
            "sink.capacity",
            "module.conductance",
            "loss.conductance",
            "seebeck",
            "load",
        ),
        "residual": _thermoelectric,
        "room": 296.0,
    }
    kits = OTHERS / "tclab"
    box = OTHERS / "incubator" / "exp2_ht20_hg30.csv"
    return [
        *(
            Recording(f"rig {k}", path=RECORDINGS / f"BMData{k}_022722.mat", **rig)  # type: ignore[arg-type]
            for k in (1, 9)
        ),
        Recording(
            "one heater",
            path=kits / "one_heater_600s.csv",
            masses={"heater": 2.0, "sensor": 0.1},
            links=_HEATER,
            heated={"heater": 0.01},
            free=("heater.capacity", "lag.conductance", "loss.conductance"),
            columns=("time=time", "output=T", "input=Q"),
            **_KIT,  # type: ignore[arg-type]
        ),
        Recording(
            "two heaters",
            path=kits / "two_heaters_600s.csv",
            masses={"heater": 2.0, "sensor": 0.1, "other": 2.0},
            links={
                **_HEATER,
                "between": ("heater", "other", 0.005),
                "other_loss": ("other", "room", 0.006),
            },
            heated={"heater": 0.01, "other": 0.0075},
            free=(
                "heater.capacity",
                "lag.conductance",
                "loss.conductance",
                "between.conductance",
            ),
            columns=(
                "time=Time (sec)",
                "output=Temperature 1 (degC)",
                "input=Heater 1 (%)",
                "second=Heater 2 (%)",
            ),
            **_KIT,  # type: ignore[arg-type]
        ),
        Recording(
            "incubator",
            Incubator,
            box,
            60.0,
            masses={"bed": 240.0, "air": 177.6, "box": 1e4},
            links={
                "plate": ("bed", "air", 2.3),
                "loss": ("air", "box", 0.8),
                "wall": ("box", "room", 1.0),
            },
            heated={"bed": 127.1},
            seen="air",
            free=(
                "bed.capacity",
                "plate.conductance",
                "loss.conductance",
                "box.capacity",
            ),
            columns=("time=time", "output=t2, t3", "input=heater_on", "room=t1"),
        ),
    ]


class OtwinTwin:
    """One recording's twin, from its first sample on, in kelvin above the first reading."""

    def __init__(self, of: Recording, window: Window) -> None:
        self.of = of
        self.period = window.period
        self.zero = float(window.output[0])
        self.y = window.output - self.zero
        power = np.array(list(of.heated.values()))
        signals = np.hstack([window.inputs, window.disturbances])
        self.u = signals[:, : power.size] * power
        self.measured = "room" in of.plant.disturbances
        if self.measured:
            self.u = np.hstack([self.u, signals[:, -1:] - self.zero])
        self.time = np.arange(self.y.size) * self.period
        self.drawn = self.model = self._network()
        self.filter: Any = None
        self.at = self.made = 0

    def _network(self) -> Any:
        import otwin  # noqa: PLC0415
        from otwin.components.thermal import (  # noqa: PLC0415
            Ambient,
            Convection,
            HeatSource,
            ThermalMass,
        )

        of = self.of
        zero = self.zero + KELVIN
        masses = {
            n: ThermalMass(c, temperature=0.0, name=n) for n, c in of.masses.items()
        }
        held = None if self.measured else 0.0 if of.room is None else of.room - zero
        room = Ambient(held, name="room")
        ports: dict[str, list[Any]] = {n: [mass.port] for n, mass in masses.items()} | {
            "room": [room.port]
        }
        for name, (one, other, conductance) in of.links.items():
            link = Convection(conductance, name=name)
            ports[one].append(link.a)
            ports[other].append(link.b)
        for name in of.heated:
            ports[name].append(HeatSource(None, name=f"{name}_heater").port)
        system = otwin.System(name="plant")
        for joined in ports.values():
            system.connect(*joined)
        model = otwin.compile(system)
        if of.residual is not None:
            terms, parameters = of.residual(model, otwin.expr, zero)
            model = model.with_residual(terms, parameters=parameters)
        model.measurements = [f"{of.seen}.temperature"]
        return model

    def forecast(self, k: int, count: int) -> FloatArray:
        """Readings after sample k, °C, from samples up to k and the inputs of the future."""
        if self.made % REFIT == 0:
            self._fit(k)
        self.made += 1
        while self.at < k:
            self._step(self.filter, self.at + 1)
            self.at += 1
        return (
            self._run(self.model, self.filter.x, slice(k, k + count + 1))[1:]
            + self.zero
        )

    def _run(self, model: Any, states: FloatArray, part: slice) -> FloatArray:
        run = model.simulate(t=self.time[part], x0=states, inputs=self.u[part])
        return np.asarray(run[f"{self.of.seen}.temperature"])

    def _fit(self, k: int) -> None:
        """Fit the parameters to the samples up to k, and follow these with the filter that suits them.

        The search of `otwin.fit_parameters`, least squares in the logarithms of what is positive, with the
        temperatures of the masses at the first sample free, too: that one holds their heats.
        """
        start = self.drawn.parameters
        bent = np.array([start[name] > 0.0 for name in self.of.free])
        first = np.array(
            [np.log(start[n]) if start[n] > 0.0 else start[n] for n in self.of.free]
        )
        own = np.array(
            [not name.startswith(f"{self.of.seen}.") for name in self.drawn.state_names]
        )

        def taken(z: FloatArray) -> tuple[Any, FloatArray]:
            found = np.where(bent, np.exp(z[: bent.size]), z[: bent.size])
            model = self.drawn.with_parameters(
                dict(zip(self.of.free, found, strict=True))
            )
            begin = np.zeros(own.size)
            begin[own] = z[bent.size :]
            return model, begin * self._capacities(model)

        def off(z: FloatArray) -> FloatArray:
            model, states = taken(z)
            return self._run(model, states, slice(0, k + 1)) - self.y[: k + 1]

        middle = np.append(first, np.zeros(own.sum()))
        wide = np.append(np.where(bent, np.log(30.0), 30.0), np.full(own.sum(), 60.0))
        result = least_squares(
            off, middle, bounds=(middle - wide, middle + wide), max_nfev=60
        )
        self.model, states = taken(result.x)
        found = []
        self.at = k
        for drift in DRIFTS:
            following = self._filter(drift, states)
            innovations = [self._step(following, j) for j in range(k + 1)]
            found.append((abs(np.log(np.mean(innovations))), following))
        self.filter = min(found, key=lambda pair: pair[0])[1]

    def _capacities(self, model: Any) -> FloatArray:
        """Of the states, J/K."""
        return np.array(
            [model.parameters[f"{n.split('.')[0]}.capacity"] for n in model.state_names]
        )

    def _filter(self, drift: float, states: FloatArray) -> Any:
        from otwin.estimate import ExtendedKalmanFilter  # noqa: PLC0415

        model = self.model
        noise = self.of.plant.output.noise
        capacities = self._capacities(model)
        seen = (
            np.array([[n.startswith(f"{self.of.seen}.") for n in model.state_names]])
            / capacities
        )
        return ExtendedKalmanFilter(
            model,
            Q=np.diag((capacities * drift) ** 2),
            R_meas=np.array([[noise**2]]),
            P0=np.diag((4.5 * capacities) ** 2),
            x0=states,
            jac_f=model.jacobian,
            jac_h=lambda x, u, t: seen,  # noqa: ARG005
        )

    def _step(self, following: Any, k: int) -> float:
        """The filter takes sample k; returns its normalised squared innovation."""
        if k:
            following.predict(self.u[k - 1], self.period)
        following.update(self.y[k : k + 1], self.u[k])
        return float(following._last_nis)


def forecasts_of(of: Recording, window: Window) -> Iterator[Forecast]:
    """otwin's forecasts with bands, at every origin that is scored."""
    size = len(window)
    pace = round(of.every / window.period)
    longest = round(HORIZONS[-1] / window.period)
    twin = OtwinTwin(of, window)
    errors: list[tuple[int, FloatArray]] = []
    for k in range(pace - 1, size - round(HORIZONS[0] / window.period), pace):
        if k < LEARNT * size:
            continue
        count = min(longest, size - 1 - k)
        mean = twin.forecast(k, count)
        if k >= SCORED * size:
            low, high = _band(
                [error[: k - origin] for origin, error in errors], count
            ).apply(mean)
            yield _forecast(window, k, Band(mean, low, high))
        errors.append((k, window.output[k + 1 : k + 1 + count] - mean))


def _band(errors: Sequence[FloatArray], count: int) -> Any:
    """Calibrated on the errors of earlier forecasts; of one width where these are too few for more."""
    from otwin.forecast import horizon_conformal, split_conformal  # noqa: PLC0415

    ahead = [np.arange(1, each.size + 1) for each in errors]
    try:
        return horizon_conformal(
            np.concatenate(errors), np.concatenate(ahead), CONFIDENCE, count
        )
    except ValueError:
        return split_conformal(np.concatenate(errors), CONFIDENCE)


def _forecast(window: Window, k: int, band: Band) -> Forecast:
    size = band.mean.size
    given = window.input[k + 1 : k + 1 + size]
    return Forecast(
        sample=window.first + k,
        candidate="otwin",
        structure="",
        confidence=CONFIDENCE,
        time=np.arange(1.0, size + 1.0, dtype=np.float64) * window.period,
        references=np.full(size, np.nan),
        outputs=(band,),
        inputs=(Band(given, given, given),),
    )


def of_otwin(of: Recording, window: Window) -> list[Marked]:
    """The marks of otwin's forecasts."""
    marked = []
    for forecast in forecasts_of(of, window):
        came = window.part(forecast.sample + 1, forecast.sample + forecast.time.size)
        over = [horizon for horizon in HORIZONS if horizon <= forecast.time[-1]]
        results = zip(over, marks(forecast, came, over, of.plant), strict=True)
        marked += [
            Marked(of.title, forecast.sample, horizon, "otwin", each)
            for horizon, each in results
        ]
    return marked


def of_twinmatch(of: Recording, session: Session) -> list[Marked]:
    """The marks of our leader's forecasts, of twins driven by the recorded input."""
    terms = terms_from_files(session)
    driven = terms._replace(settings=replace(terms.settings, law=None))
    (tested,) = backtest(session, driven, Choices(of.every, HORIZONS, ()))
    return [
        replace(one, who="twinmatch") for one in tested.marked if one.who == "leader"
    ]


def _compared(found: Mapping[str, Sequence[Marked]]) -> list[Card]:
    """Cards of the origins at which both forecast."""
    places = [{(one.sample, one.horizon) for one in held} for held in found.values()]
    both = set.intersection(*places)
    return cards(
        [
            one
            for held in found.values()
            for one in held
            if (one.sample, one.horizon) in both
        ]
    )


def _note(held: Sequence[Card], plant: type[Plant]) -> str:
    return "; ".join(
        f"{card.horizon:g} s: error {card.median:.2f} / {card.nine_in_ten:.2f}, held "
        f"{card.coverage_output:.0%}, width {card.width_output * plant.output.noise:.2g} °C, "
        f"score {card.score:.1f}, n = {card.count}"
        for card in held
    )


def run(quick: bool) -> list[Row]:
    if peer("otwin") is None:
        raise SystemExit(
            "otwin_peer: otwin is not installed; run `make bench`, or pip install otwin==2.0.1"
        )
    rows = []
    for of in recordings()[2:3] if quick else recordings():
        if not of.path.is_file():
            rows.append(
                Row(
                    "otwin_peer",
                    of.title,
                    "twinmatch",
                    float("nan"),
                    note=f"no {of.path}",
                )
            )
            continue
        session = of.read()
        (window,) = stretches(session.samples, session.period)
        cases: dict[str, Callable[[], list[Marked]]] = {
            "twinmatch": partial(of_twinmatch, of, session),
            "otwin": partial(of_otwin, of, window),
        }
        timings = measure_side_by_side(cases, 1 if quick else 3, patience=150.0)
        found = {
            name: timing.result for name, timing in timings.items() if timing.result
        }
        compared = _compared(found) if len(found) == len(cases) else []
        notes = {
            who: _note([c for c in compared if c.who == who], of.plant) for who in cases
        }
        rows += rows_of("otwin_peer", of.title, timings, notes=notes)
    return rows


if __name__ == "__main__":
    main(run, __doc__)
