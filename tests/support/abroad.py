"""Simulated plants of five kinds that nobody tuned anything on.

Their equations are written here once more, in plain numbers, and integrated in small steps; twinmatch
computes only the controller. Every plant has its own parameters and something that the plant's file lacks. A
plant runs in closed loop, which reacts to what a faulty sensor shows, or under steps of its input.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final
from zlib import crc32

import numpy as np

from tests.support.plants import Motor
from twinmatch.dynamics import (
    Controller,
    Drive,
    Equations,
    Output,
    Parameter,
    PidGains,
    Plant,
    State,
    Structure,
)
from twinmatch.plants import Incubator, Peltier, TCLab
from twinmatch.plants.tclab import RESOLUTION
from twinmatch.signals import KELVIN, Sample

__all__ = ["KINDS", "LACKS", "MISHAPS", "AbroadKind", "AbroadPlant", "Mishap"]

Rates = tuple[float, ...]


class SpunMotor(Motor, name="spun_motor"):
    """The motor, of which its file knows what is typical."""

    typical = {"k": 0.05, "j": 4e-4, "b": 1e-4, "dry": 0.01}  # noqa: RUF012
    surroundings = "load and bearings"


class Cascade(Plant, name="cascade"):
    """A pump fills the upper of two tanks, which runs out into the lower one, whose level is measured."""

    title = "two tanks"
    typical = {"pump": 0.04, "upper_hole": 0.08, "lower_hole": 0.08}  # noqa: RUF012
    level = Output(
        unit="V",
        noise=0.03,
        span=(-0.5, 10.5),
        set_points=(1.5, 7.0),
        text="lower level",
    )
    pumping = Drive(unit="V", limits=(0.0, 10.0), noise=0.1, text="pump")
    upper = State(unit="V", span=(0.0, 12.0), start_bounds=(0.0, 12.0))
    lower = State(unit="V", span=(0.0, 12.0))
    pump = Parameter(unit="1/s", default=0.05, bounds=(0.002, 0.5), positive=True)
    upper_hole = Parameter(unit="√V/s", default=0.1, bounds=(0.005, 1.0), positive=True)
    lower_hole = Parameter(
        unit="√V/s", default=0.1, bounds=(0.005, 1.0), positive=True, role="losses"
    )
    structures = {  # noqa: RUF012
        "two tanks": Structure(
            free=("pump", "upper_hole", "lower_hole"), free_starts=("upper",)
        )
    }
    loop = PidGains(1.2, 0.012, 0.0, 0.1, 0.0, 10.0, period=4.0)

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """Torricelli's law, which bends below a tenth of a volt."""
        from_upper = self.upper_hole * self.upper / (self.upper + 0.1) ** 0.5
        from_lower = self.lower_hole * self.lower / (self.lower + 0.1) ** 0.5
        return Equations(
            rates={
                self.upper: self.pump * self.pumping - from_upper,
                self.lower: from_upper - from_lower,
            },
            output=self.lower,
            start={self.lower: self.level, self.upper: self.level},
        )


@dataclass(frozen=True)
class Around:
    """What acts on a plant beside its input."""

    room: float
    """Temperature of the room, °C."""
    load: float
    """Heat, torque or flow from elsewhere, in the plant's own unit."""
    losses: float = 1.0
    """Factor on what is lost."""


def _rig(p: Mapping[str, float], x: Rates, u: float, around: Around) -> Rates:
    plate, sink = x
    current = (-p["supply"] * u / 255.0 - p["seebeck"] * (sink - plate)) / 3.4
    current = min(max(current, -5.0), 5.0)
    joule = 0.5 * 3.3 * current * current
    across = p["conductance"] * (plate - sink)
    to_room = around.losses * p["convection"] * (sink - around.room - KELVIN)
    drawn = p["seebeck"] * plate * current
    released = p["seebeck"] * sink * current
    return (
        (joule - drawn - across + around.load) / p["capacity"],
        (released + joule + across - to_room) / p["sink_capacity"],
    )


def _kit(p: Mapping[str, float], x: Rates, u: float, around: Around) -> Rates:
    heater, sensor = x
    room = around.room + KELVIN
    lost = around.losses * p["losses"] * 1e-3 * (heater - room) + 5.1e-11 * (
        heater**4 - room**4
    )
    return (p["heating"] * u + around.load - lost) / p["capacity"], (
        heater - sensor
    ) / p["lag"]


def _incubator(p: Mapping[str, float], x: Rates, u: float, around: Around) -> Rates:
    air, bed, box, sensor = x
    from_bed = p["bed_conductance"] * (bed - air)
    into = p["box_conductance"] * (air - box)
    opened = (around.losses - 1.0) * p["box_conductance"] * (air - around.room)
    return (
        (from_bed + around.load - into - opened) / p["air_capacity"],
        (p["power"] * u - from_bed) / p["bed_capacity"],
        (into - p["wall_conductance"] * (box - around.room)) / p["box_capacity"],
        (air - sensor) / p["lag"],
    )


def _motor(p: Mapping[str, float], x: Rates, u: float, around: Around) -> Rates:
    (speed,) = x
    current = min(max((u - p["k"] * speed) / p["resistance"], -8.0), 8.0)
    rubbing = around.losses * (p["viscous"] * speed + p["dry"] * math.tanh(speed / 2.0))
    return ((p["k"] * current - rubbing + around.load) / p["inertia"],)


def _tanks(p: Mapping[str, float], x: Rates, u: float, around: Around) -> Rates:
    upper = max(x[0], 0.0)
    lower = max(x[1], 0.0)
    from_upper = p["upper_hole"] * math.sqrt(upper)
    from_lower = p["lower_hole"] * math.sqrt(lower)
    # what is above the rim leaves within a second; half of it falls below
    spilt = max(upper - p["rim"], 0.0)
    away = max(lower - p["rim"], 0.0)
    return (
        p["pump"] * u - from_upper - spilt,
        from_upper + 0.5 * spilt - around.losses * from_lower - away + around.load,
    )


@dataclass(frozen=True)
class AbroadKind:
    """How plants of one kind are made and run."""

    plant: type[Plant]
    rates: Callable[[Mapping[str, float], Rates, float, Around], Rates]
    """Time derivatives of the states, per second."""
    typical: Mapping[str, float]
    start: Callable[[float], Rates]
    """States at rest in a room."""
    show: Callable[[Rates], float]
    """The output."""
    period: float
    """Sample time, s."""
    step: float
    """Step of the integration, s."""
    gains: PidGains | None
    """None: a thermostat runs it, and its twin is driven."""
    levels: tuple[float, float]
    """Set-points."""
    inputs: tuple[float, float]
    """Steps in open loop."""
    rest: float
    """Input that does nothing."""
    kelvin: float
    """What counts as one kelvin, in the output's unit."""
    second: float = 1.0
    """What counts as a second of a thermal plant, s."""
    dead: tuple[float, float] = (3.0, 12.0)
    """Dead times, and lags, of closed loops, s; in open loop they may be longer."""
    load: float = 0.0
    """Constant load of the kind's usual size."""
    push: float = 0.0
    """A passing one."""
    dead_band: float = 0.0
    """Change of the input that has no effect."""
    resolution: float = 0.0
    """Step of a healthy display."""
    noise: float = 0.0
    """Standard deviation of the noise of a healthy reading."""
    known: bool = True
    """Whether a twin may know the controller."""
    always: tuple[str, ...] = ()
    """What every plant of the kind has that its file lacks."""


KINDS: Final[dict[str, AbroadKind]] = {
    "rig": AbroadKind(
        Peltier,
        _rig,
        {"supply": 12.0, "seebeck": 0.06, "conductance": 0.6, "convection": 5.0, "capacity": 28.0,
         "sink_capacity": 260.0},
        lambda room: (room + KELVIN, room + KELVIN),
        lambda x: x[0] - KELVIN,
        period=1.0, step=0.05, levels=(22.0, 75.0), inputs=(-40.0, 120.0), rest=0.0, kelvin=1.0,
        gains=PidGains(14.0, 0.4, 0.0, 1.0, -255.0, 255.0), dead=(2.0, 5.0), load=3.0, push=10.0,
        dead_band=6.0, resolution=0.01, noise=0.06,
    ),
    "kit": AbroadKind(
        TCLab,
        _kit,
        {"losses": 6.0, "heating": 0.0095, "capacity": 2.0, "lag": 15.0},
        lambda room: (room + KELVIN, room + KELVIN),
        lambda x: x[1] - KELVIN,
        period=1.0, step=0.2, levels=(30.0, 60.0), inputs=(0.0, 60.0), rest=0.0, kelvin=1.0,
        gains=TCLab.loop if isinstance(TCLab.loop, PidGains) else None, load=0.06, push=0.2, dead_band=3.0,
        resolution=RESOLUTION, noise=0.043,
    ),
    "incubator": AbroadKind(
        Incubator,
        _incubator,
        {"power": 127.0, "air_capacity": 178.0, "bed_capacity": 240.0, "box_capacity": 2e4,
         "bed_conductance": 2.0, "box_conductance": 0.9, "wall_conductance": 1.0, "lag": 3.0},
        lambda room: (room,) * 4,
        lambda x: x[3],
        period=3.0, step=0.2, levels=(28.0, 40.0), inputs=(0.0, 0.3), rest=0.0, kelvin=1.0,
        gains=None, load=4.0, push=15.0, dead_band=0.0, resolution=0.0625, noise=0.03,
    ),
    "motor": AbroadKind(
        SpunMotor,
        _motor,
        {"k": 0.05, "resistance": 1.2, "inertia": 4e-4, "viscous": 1e-4, "dry": 0.01},
        lambda room: (0.0,),  # noqa: ARG005
        lambda x: x[0],
        period=0.05, step=0.0025, levels=(30.0, 180.0), inputs=(-12.0, 12.0), rest=0.0, kelvin=3.0,
        gains=PidGains(0.1, 0.4, 0.0, 5.0, -24.0, 24.0, period=0.05), second=0.05, dead=(0.05, 0.15),
        load=0.008, push=0.03, dead_band=0.6, resolution=0.01, noise=0.2,
    ),
    "tanks": AbroadKind(
        Cascade,
        _tanks,
        {"pump": 0.04, "upper_hole": 0.08, "lower_hole": 0.08, "rim": 10.0},
        lambda room: (1.0, 1.0),  # noqa: ARG005
        lambda x: x[1],
        period=4.0, step=0.2, levels=(2.0, 6.5), inputs=(2.0, 4.5), rest=0.0, kelvin=0.1,
        gains=PidGains(1.2, 0.012, 0.0, 0.1, 0.0, 10.0, period=4.0), load=0.02, push=0.015, dead_band=0.25,
        resolution=0.003, noise=0.02,
    ),
}  # fmt: skip

# rows every 5 s that hold the input too early, and a controller that hurries
KINDS["slow kit"] = replace(
    KINDS["kit"], period=5.0, gains=PidGains(30.0, 0.2, 0.0, 0.2, 0.0, 100.0, period=5.0),
    known=False, always=("dead time",), dead=(5.0, 12.0), noise=0.3, levels=(35.0, 65.0),
)  # fmt: skip
KINDS["other box"] = replace(  # an incubator with a seventh of the heater
    KINDS["incubator"], typical={**KINDS["incubator"].typical, "power": 18.7}, levels=(24.0, 30.0),
    inputs=(0.0, 1.0), load=2.0,
)  # fmt: skip
LACKS: Final = (
    "dead time", "input lag", "sensor lag", "drift", "dead band", "display", "load", "scale", "noise",
)  # fmt: skip
"""What a plant can have that its file lacks."""
MISHAPS: Final = (
    "reading+1", "reading+2", "reading+3", "reading+5", "reading~6", "frozen", "spike", "drive*0",
    "drive*0 twice", "drive*0.78", "drive*0.7", "drive*0.62", "input late", "reading late", "losses*2.5",
    "pushed",
)  # fmt: skip
"""What can happen to one."""
_SLOWLY: Final = 300.0
"""Seconds in which a ramp has come."""
_LATE: Final = 5.0
_PUSHED: Final = 60.0
"""Seconds for which something else pushes the output."""
_SPIKE: Final = 30.0
"""Kelvin."""


@dataclass(frozen=True)
class Mishap:
    """What happens to a plant, from which sample to which."""

    kind: str
    start: int
    stop: int

    def on(self, k: int) -> bool:
        if self.kind == "drive*0 twice":
            third = (self.stop - self.start) // 3
            return (
                self.start <= k < self.start + third
                or self.stop - third <= k < self.stop
            )
        if self.kind == "spike":
            return k == self.start
        return self.start <= k < self.stop

    @property
    def number(self) -> float:
        """The number in its name: units or share."""
        return float(
            self.kind.split()[0].lstrip("abcdefghijklmnopqrstuvwxyz+~*") or 0.0
        )


NOTHING: Final = Mishap("nothing", 0, 0)


@dataclass
class AbroadPlant:
    """One plant with its controller; iterate over `run` once."""

    kind: AbroadKind
    seed: int
    lacks: tuple[str, ...] | None = None
    """None: one or two are drawn."""
    holds: tuple[float, float] = (300.0, 900.0)
    """Least and greatest time for which a level is held, in seconds of the kind."""
    closed: bool | None = None
    """Whether a controller runs it; None: drawn."""
    mishap: Mishap = NOTHING
    """What happens to it; may be set while it runs."""
    parameters: dict[str, float] = field(init=False)

    def __post_init__(self) -> None:
        self._draw = draw = np.random.default_rng(
            [self.seed, crc32(self.kind.plant.name.encode())]
        )
        self.parameters = {
            n: v * float(draw.uniform(0.72, 1.28)) for n, v in self.kind.typical.items()
        }
        for fixed in {"supply", "rim"} & set(self.parameters):
            self.parameters[fixed] = self.kind.typical[fixed]
        drawn_closed = bool(draw.random() < 0.65)
        self.closed = drawn_closed if self.closed is None else self.closed
        possible = [
            lack for lack in LACKS if lack != "dead band" or self.kind.dead_band
        ]
        drawn = draw.choice(possible, size=int(draw.integers(1, 3)), replace=False)
        if self.lacks is None:
            self.lacks = tuple(dict.fromkeys([*self.kind.always, *drawn.tolist()]))
        least, most = self.kind.dead
        longest = (least, most if self.closed else min(2.0 * most, 12.0))
        self._sizes = {
            "dead time": float(draw.uniform(*longest)),
            "input lag": float(draw.uniform(*longest)),
            "sensor lag": float(draw.uniform(*longest)),
            "drift": float(draw.uniform(1.0, 3.0)),
            "dead band": self.kind.dead_band * float(draw.uniform(0.6, 1.6)),
            "display": self.kind.kelvin * float(draw.choice([0.1, 0.2, 0.5])),
            "load": self.kind.load
            * float(draw.uniform(0.7, 1.5))
            * float(draw.choice([-1.0, 1.0])),
            "scale": 1.0
            + float(draw.uniform(0.2, 0.4)) * float(draw.choice([-1.0, 1.0])),
            "noise": float(draw.uniform(2.0, 3.0)),
        }
        self._room = float(draw.uniform(18.0, 25.0))
        self._phase = float(draw.uniform(0.0, 2 * math.pi))
        self._slow = float(draw.uniform(1200.0, 3600.0))
        self._wander = 0.0
        self._states = self.kind.start(self._room)
        self._now = Around(self._room, 0.0)
        self._acting = self.kind.rest  # the input behind a lag
        self._seen = self.output  # the output behind a lag
        self._held = self.kind.rest  # the input that a dead band lets through
        self._pipe = deque(
            [self.kind.rest] * round(self.has("dead time") / self.kind.step)
        )
        self._until = 0  # sample to which the level holds
        self._chosen = math.nan

    @property
    def output(self) -> float:
        """The true output now."""
        return self.kind.show(self._states)

    @property
    def states(self) -> Rates:
        return self._states

    @property
    def room(self) -> float:
        """Temperature of the room now, °C."""
        return self._now.room

    @property
    def gains(self) -> PidGains | None:
        """The controller's, if a twin may know them."""
        return self.kind.gains if self.closed and self.kind.known else None

    def has(self, lack: str, otherwise: float = 0.0) -> float:
        """Size of what the file lacks."""
        return self._sizes[lack] if lack in (self.lacks or ()) else otherwise

    def run(self, size: int) -> Iterator[Sample]:
        """So many samples."""
        kind = self.kind
        period = self.kind.period
        gains = kind.gains
        pid = Controller(gains) if gains is not None else None
        late = max(1, round(_LATE * kind.second / period))
        commands: deque[float] = deque([kind.rest] * (late + 1), maxlen=late + 1)
        shown: deque[float] = deque(maxlen=late + 1)
        heating = True
        last = math.nan
        for k in range(size):
            mishap = self.mishap
            level = self.level(k)
            reading = self._read(k)
            shown.append(reading)
            if mishap.kind == "frozen" and mishap.on(k):
                reading = last
            if mishap.kind == "reading late" and mishap.on(k):
                reading = shown[0]
            last = reading
            if not self.closed:
                u = level
            elif pid is not None:
                u = float(pid.step(level, reading)[0])
            else:
                heating = reading < level + (1.0 if heating else -1.0) * kind.kelvin
                u = float(heating and k % 8 < 3)
            commands.append(u)
            recorded = (
                commands[0] if mishap.kind == "input late" and mishap.on(k) else u
            )
            reference = level if self.gains is not None else reading
            disturbances = (
                (round(self._now.room / 0.0625) * 0.0625,)
                if kind.plant is Incubator
                else ()
            )
            yield Sample(
                k, round(k * period * 1e9), reference, reading, recorded, disturbances
            )
            self._advance(k, u)

    def level(self, k: int) -> float:
        """Set-point, or input in open loop."""
        if k >= self._until:
            low, high = self.kind.levels if self.closed else self.kind.inputs
            share = float(self._draw.random())
            self._chosen = round(low + (high - low) * share, 2)
            hold = float(self._draw.uniform(*self.holds)) * self.kind.second
            self._until = k + max(10, round(hold / self.kind.period))
        return self._chosen

    def _read(self, k: int) -> float:
        kind = self.kind
        mishap = self.mishap
        noise = (
            kind.noise * self.has("noise", 1.0) * float(self._draw.standard_normal())
        )
        value = self._seen + noise
        if mishap.on(k):
            since = (k - mishap.start) * kind.period / kind.second
            if mishap.kind.startswith("reading+"):
                value += mishap.number * kind.kelvin
            elif mishap.kind.startswith("reading~"):
                value += mishap.number * kind.kelvin * min(since / _SLOWLY, 1.0)
            elif mishap.kind == "spike":
                value += _SPIKE * kind.kelvin
        step = max(kind.resolution, self.has("display"))
        return round(round(value / step) * step, 6) if step else value

    def _advance(self, k: int, command: float) -> None:
        """One period."""
        kind = self.kind
        mishap = self.mishap
        on = self.mishap.on(k)
        band = self.has("dead band")
        if abs(command - self._held) > band or (band and abs(command) <= 1e-9):
            self._held = (
                command - math.copysign(band, command - self._held) if band else command
            )
        u = self._held * self.has("scale", 1.0)
        if on and mishap.kind.startswith("drive"):
            u *= mishap.number
        self._around(k, mishap if on else NOTHING)
        lag = self.has("input lag")
        behind = self.has("sensor lag")
        for _ in range(round(kind.period / kind.step)):
            self._pipe.append(u)
            arrived = self._pipe.popleft()
            self._acting = (
                arrived
                if not lag
                else self._acting + kind.step / lag * (arrived - self._acting)
            )
            self._states = self._moved(kind.step)
            output = self.output
            self._seen = (
                output
                if not behind
                else self._seen + kind.step / behind * (output - self._seen)
            )

    def _moved(self, step: float) -> Rates:
        """The states a step later, by the midpoint rule."""
        rates = self.kind.rates(self.parameters, self._states, self._acting, self._now)
        half = tuple(
            x + 0.5 * step * d for x, d in zip(self._states, rates, strict=True)
        )
        rates = self.kind.rates(self.parameters, half, self._acting, self._now)
        return tuple(x + step * d for x, d in zip(self._states, rates, strict=True))

    def _around(self, k: int, mishap: Mishap) -> None:
        kind = self.kind
        time = k * self.kind.period / self.kind.second
        self._wander += (
            0.015
            * math.sqrt(kind.period / kind.second)
            * float(self._draw.standard_normal())
        )
        drift = (
            self.has("drift") * math.sin(2 * math.pi * time / self._slow + self._phase)
            + self._wander
        )
        drift = drift if self.has("drift") else 0.0
        load = self.has("load")
        thermal = kind.plant in (Peltier, TCLab, Incubator)
        if not thermal:  # a load that drifts
            load += 0.3 * kind.load * drift
        if (
            mishap.kind == "pushed"
            and time - mishap.start * kind.period / kind.second < _PUSHED
        ):
            load += kind.push
        losses = mishap.number if mishap.kind.startswith("losses") else 1.0
        self._now = Around(self._room + (drift if thermal else 0.0), load, losses)
