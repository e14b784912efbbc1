"""Structures a plant may have, and the fit of each to what was recorded.

A `Structure` says which parts of the rig are there and which of its parameters are unknown. `fit_structure`
finds those for one or more windows together: the closed-loop twin runs on each window's reference from its
third sample on, and the residuals of temperature and PWM, in units of the camera's noise, are made small.
Large ones count by their size and not by its square: a camera that corrects its flat field, or repeats
old pictures when a session begins, kicks the loop in a way that no structure explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.matching.bounds import BOUNDS, SCALES, SINK_START, MatchingError, checked_free
from twinmatch.matching.descent import descend
from twinmatch.matching.problem import Noise
from twinmatch.plant import (
    Driver,
    PidGains,
    PidState,
    RigParameters,
    controller_state,
    simulate_closed_loop,
)
from twinmatch.signals import KELVIN, FloatArray, Window

__all__ = ["SETTLE", "STRUCTURES", "Structure", "StructureFit", "fit_structure"]

SETTLE: Final = 60
"""Samples at a window's begin that are simulated but not judged: until the loop has forgotten how the twin
was put there, and the camera its first pictures."""

_SKIPPED = 2
"""A twin starts at the third sample, where the controller's memory is known."""
_STEP = 1e-4
"""Finite difference in units of a parameter's scale."""
_LOOK = 6
"""Evaluations after which only the best of several starts goes on."""
_MOST_EVALUATIONS = 40


@dataclass(frozen=True)
class Structure:
    """What a plant is made of, and what of it is unknown.

    Raises:
        MatchingError: a free name is unknown, or one that this rig does not feel.
    """

    name: str
    free: tuple[str, ...]
    """Rig parameters that are unknown, in canonical order; a sink with mass adds its start temperature."""
    start: RigParameters
    """What is known, and where the search for the rest begins."""

    def __post_init__(self) -> None:
        names = checked_free(self.free, self.start)
        object.__setattr__(self, "free", tuple(n for n in names if n != SINK_START))

    def n_parameters(self, windows: int = 1) -> int:
        """How many numbers a fit to so many windows is free to choose."""
        return len(self.free) + (windows if self.start.sink_has_mass else 0)


_HELD: Final = RigParameters(seebeck=0.06, conductance=0.7, heat_capacity=28.0, ambient=293.0)
_MOVING: Final = _HELD.replace(sink_heat_capacity=350.0, sink_convection=3.0)
_PLATE: Final = ("seebeck", "conductance", "heat_capacity")
_ROOM: Final = (*_PLATE, "ambient")
_SINK: Final = (*_PLATE, "sink_heat_capacity", "sink_convection")
_BOTH: Final = (*_ROOM, "sink_heat_capacity", "sink_convection")

STRUCTURES: Final = (
    Structure("held sink", _PLATE, RigParameters(seebeck=0.06, conductance=0.7, heat_capacity=28.0)),
    Structure("held sink, free ambient", _ROOM, _HELD),
    Structure("held sink, free ambient, switched drive", _ROOM, _HELD.replace(drive_ripple=1.0)),
    Structure("sink with mass", _SINK, _MOVING.replace(ambient=296.0)),
    Structure("sink with mass, sensor lag", (*_SINK, "sensor_lag"), _MOVING.replace(ambient=296.0)),
    Structure("sink with mass, free ambient", _BOTH, _MOVING),
    Structure("sink with mass, switched drive", _SINK, _MOVING.replace(ambient=296.0, drive_ripple=1.0)),
    Structure("sink with mass, free ambient, switched drive", _BOTH, _MOVING.replace(drive_ripple=1.0)),
    Structure(
        "sink with mass, free ambient, switched drive, sensor lag",
        (*_BOTH, "sensor_lag"),
        _MOVING.replace(drive_ripple=1.0),
    ),
    Structure(
        "sink with mass, free ambient, switched drive, α(T)",
        (*_BOTH, "seebeck_slope"),
        _MOVING.replace(drive_ripple=1.0),
    ),
    Structure(
        "sink with mass, free ambient, switched drive, sensor lag, α(T)",
        (*_BOTH, "sensor_lag", "seebeck_slope"),
        _MOVING.replace(drive_ripple=1.0),
    ),
)
"""What is tried, simpler ones first.

The ambient is free where nobody wrote down the temperature of the room and the camera may be off by a few
degrees. Whether the drive is switched or smoothed is a choice and costs no parameter.
"""

_VALLEY: Final[tuple[dict[str, float], ...]] = (
    {},
    {"seebeck": 0.09, "conductance": 0.6, "heat_capacity": 40.0},
    {"seebeck": 0.13, "conductance": 0.3, "heat_capacity": 58.0},
)
"""Starts along the valley in which Seebeck coefficient, conductance and heat capacity trade off."""


@dataclass(frozen=True, eq=False)
class StructureFit:
    """A structure fitted to windows; its arrays leave out the first `SETTLE` samples of each window."""

    structure: Structure
    parameters: RigParameters
    sink_starts: tuple[float | None, ...]
    """Temperature of the sink at the third sample of each window, K; None where it starts at ambient."""
    measured: tuple[FloatArray, ...]
    """Temperature (°C) and PWM of each window, shape (2, M)."""
    simulated: tuple[FloatArray, ...]
    """The same of the twin."""
    converged: bool
    """Whether the search came to rest."""
    cost: float
    """What was made small: the mean over all residuals of 2(√(1 + e²) − 1), e in units of the noise."""

    @property
    def n_parameters(self) -> int:
        """How many numbers the fit was free to choose."""
        return self.structure.n_parameters(len(self.measured))

    @property
    def fit(self) -> tuple[float, float]:
        """NRMSE of temperature and PWM over all windows; 1 is perfect."""
        measured, simulated = np.hstack(self.measured), np.hstack(self.simulated)
        spread = np.linalg.norm(measured - measured.mean(axis=1, keepdims=True), axis=1)
        left = np.linalg.norm(measured - simulated, axis=1)
        y, u = (1.0 - left / spread).tolist()
        return y, u


def fit_structure(
    windows: Sequence[Window],
    structure: Structure,
    *,
    start: StructureFit | None = None,
    noise: Noise | None = None,
    gains: PidGains | None = None,
    driver: Driver | None = None,
    thorough: bool = True,
) -> StructureFit:
    """Find the unknown parameters of one structure from windows of one rig.

    Args:
        windows: what was recorded; each has more than `SETTLE` + 2 samples.
        structure: what the plant is taken to be.
        start: an earlier fit of the same structure; without it the search has several starts.
        noise: what the residuals are measured in.
        gains: of the running controller; the rig's if not given, at the windows' period.
        driver: bridge between PWM and module.
        thorough: search from several starts and to the end; otherwise from one start, and no further than
            the cost falls by a part in ten thousand or so, in a fifth of the time.

    Raises:
        MatchingError: no window, one that is too short, or windows of different periods.
    """
    runs = _runs(windows, gains)
    problem = _Problem(runs, structure, noise or Noise(), driver or Driver())
    if start is not None and start.structure == structure:
        values = problem.values_of(start.parameters, start.sink_starts[-1])
    elif thorough:
        firsts = [problem.values_of(structure.start.replace(**changes), None) for changes in _VALLEY]
        looks = [problem.search(first, _LOOK) for first in firsts]
        values = min(looks, key=lambda found: found[1])[0]
    else:
        values = problem.values_of(structure.start, None)
    values, cost, converged = problem.search(values, _MOST_EVALUATIONS if thorough else _LOOK)
    parameters, sinks = problem.named(values)
    return StructureFit(
        structure=structure,
        parameters=parameters,
        sink_starts=sinks,
        measured=tuple(run.measured for run in runs),
        simulated=tuple(problem.simulated(values)),
        converged=converged,
        cost=cost,
    )


@dataclass(frozen=True, eq=False)
class _Run:
    """One window, ready to be simulated."""

    reference: FloatArray
    plate: float
    controller: PidState
    gains: PidGains
    measured: FloatArray


def _runs(windows: Sequence[Window], gains: PidGains | None) -> list[_Run]:
    if not windows:
        raise MatchingError("structures: no window was given; a fit needs one at least")
    runs = []
    for window in windows:
        if len(window) <= SETTLE + _SKIPPED:
            msg = (
                f"structures: the window from sample {window.first} has {len(window)} samples; "
                f"the first {SETTLE + _SKIPPED} are not judged, give more"
            )
            raise MatchingError(msg)
        own = gains or PidGains(period=window.period)
        if own.period != window.period:
            msg = (
                f"structures: the controller runs every {own.period} s but the samples of a window come "
                f"every {window.period} s; give both the same period"
            )
            raise MatchingError(msg)
        runs.append(
            _Run(
                reference=window.reference[_SKIPPED:],
                plate=float(window.output[_SKIPPED]) + KELVIN,
                controller=controller_state(window, own),
                gains=own,
                measured=np.stack([window.output, window.input])[:, _SKIPPED + SETTLE :],
            )
        )
    return runs


class _Problem:
    """Least squares over all windows; the values are the free parameters and each window's sink start."""

    def __init__(self, runs: Sequence[_Run], structure: Structure, noise: Noise, driver: Driver) -> None:
        self._runs, self._structure, self._driver = runs, structure, driver
        self._weights = np.array([[1.0 / noise.output], [1.0 / noise.input]])
        sinks = structure.n_parameters(len(runs)) - len(structure.free)
        names = (*structure.free, *(SINK_START,) * sinks)
        self._lower = np.array([BOUNDS[name][0] for name in names])
        self._upper = np.array([BOUNDS[name][1] for name in names])
        self._scales = np.array([SCALES[name] for name in names])

    def values_of(self, parameters: RigParameters, sink: float | None) -> FloatArray:
        """The values at a rig whose sink is at `sink` (K), or else at ambient, when each window begins."""
        values = [getattr(parameters, name) for name in self._structure.free]
        missing = len(self._lower) - len(values)
        values += [parameters.ambient if sink is None else sink] * missing
        return np.clip(np.array(values, dtype=np.float64), self._lower, self._upper)

    def named(self, values: FloatArray) -> tuple[RigParameters, tuple[float | None, ...]]:
        """Rig, and sink start of each window."""
        free = self._structure.free
        own = values[: len(free)].tolist()
        parameters = self._structure.start.replace(**dict(zip(free, own, strict=True)))
        return parameters, tuple(values[len(free) :].tolist()) or (None,) * len(self._runs)

    def simulated(self, values: FloatArray) -> list[FloatArray]:
        """Temperature and PWM of the twin on each window, shape (2, M)."""
        parameters, sinks = self.named(values)
        found = []
        for run, sink in zip(self._runs, sinks, strict=True):
            response = simulate_closed_loop(
                parameters,
                run.reference,
                plate=run.plate,
                sink=sink,
                controller=run.controller,
                gains=run.gains,
                driver=self._driver,
            )
            found.append(np.stack([response.output, response.input])[:, SETTLE:])
        return found

    def residuals(self, values: FloatArray) -> FloatArray:
        """Measured minus simulated in units of the noise, all in a row."""
        pairs = zip(self._runs, self.simulated(values), strict=True)
        return np.hstack([(run.measured - twin) * self._weights for run, twin in pairs]).ravel()

    def jacobian(self, values: FloatArray, here: FloatArray) -> FloatArray:
        """Derivatives of the residuals, which are `here`; differences towards the middle of the bounds."""
        rows = []
        for i, scale in enumerate(self._scales):
            step = _STEP * scale if 2.0 * values[i] < self._lower[i] + self._upper[i] else -_STEP * scale
            there = values.copy()
            there[i] += step
            rows.append((self.residuals(there) - here) / step)
        return np.stack(rows)

    def search(self, start: FloatArray, evaluations: int) -> tuple[FloatArray, float, bool]:
        """Where the search from one start ends, its cost, and whether it came to rest."""
        found = descend(
            lambda values: _Point(self, values), start, self._lower, self._upper, self._scales, evaluations
        )
        count = sum(run.measured.size for run in self._runs)
        return found.values, found.cost / count, found.converged


class _Point:
    """The robust sum at some values, as a sum of squares whose weights are those of its own residuals."""

    def __init__(self, problem: _Problem, values: FloatArray) -> None:
        self._problem, self._values = problem, values
        self._residuals = problem.residuals(values)
        self._root = np.sqrt(1.0 + np.square(self._residuals))

    @property
    def cost(self) -> float:
        return float(2.0 * np.sum(self._root - 1.0))

    @property
    def normal(self) -> tuple[float, FloatArray, FloatArray]:
        jacobian = self._problem.jacobian(self._values, self._residuals)
        weighed = jacobian / self._root
        return self.cost, weighed @ self._residuals, weighed @ jacobian.T
