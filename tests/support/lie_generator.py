"""Runs of a plant behind its guard, drawn from a seed: lies of many kinds, and healthy hours in many rooms.

The same seed gives the same run. What is drawn does not depend on the guard.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from tests.support.liar import (
    KIT,
    RIG,
    Bench,
    Lie,
    RunTime,
    drifting,
    drive_for_a_second,
    scaled,
    sliding_off,
    whole_kit,
)
from twinmatch.dynamics import Controller, Parameters, begin, law_of, readings
from twinmatch.nodes.gated import OutputGate
from twinmatch.nodes.tclab_bridge import TCLabBridge
from twinmatch.plants import TCLabBoth
from twinmatch.safety import OutputGuard
from twinmatch.signals import KELVIN, FloatArray

HOUR: Final = 3600
LASTS: Final = HOUR
"""Longest lie, s."""
HEALTHY_LASTS: Final = 3 * HOUR
"""Of a healthy run, s: rooms change within hours."""
AFTER_A_FAULT: Final = 40
"""Time for which a run is followed after a fault, s."""
BACK: Final = 600
"""Set-points of this time count, s: a plate takes some minutes to cool."""
ABOVE = 15.0
WARM = 60.0
"""Beyond is what is this far above the highest set-point, and above this temperature, °C."""
UPDATED: Final = 10
"""Interval at which room and losses of a plant change, s."""
ROOMS: Final = ("constant", "cools", "warms", "draught", "fan")
ROOM_CHANGES: Final = 12.0
"""By how much a room cools or warms, °C."""


@dataclass(frozen=True)
class Surroundings:
    """What changes around the plant."""

    name: str = "constant"
    ambient: FloatArray = field(default_factory=lambda: np.zeros(1))
    """What is added to the temperature of the room, shape (N,), K."""
    losses: FloatArray = field(default_factory=lambda: np.ones(1))
    """By which factor the losses change, shape (N,)."""


@dataclass(frozen=True)
class LieRun:
    """One run; a healthy one has no lie."""

    seed: int
    kind: str
    """`rig`, `kit`, or `both` for a kit whose heaters are both driven."""
    plant: Parameters
    set_points: str
    references: FloatArray
    """Shape (N, o), °C."""
    surroundings: Surroundings
    lie_name: str = ""
    lie: Lie | None = None
    channels: tuple[int, ...] = (0,)
    """Sensors that lie."""
    begins: int = 0
    """Sample at which they begin."""
    restarts: int = -1
    """Sample at which the bridge restarts; −1: never."""

    @property
    def apart(self) -> bool:
        """Whether the lie can be told from a room: the room does not warm besides, and the bridge does not
        restart after the lie has begun."""
        return self.surroundings.name != "warms" and not self.restarts > self.begins


@dataclass
class LieOutcome:
    """How a run ended."""

    beyond: float = -math.inf
    """Highest temperature above what is allowed since the lie began, °C."""
    at: int = 0
    """When that was, s."""
    highest: float = -math.inf
    """Highest temperature since then, °C."""
    fault: str = ""
    fault_at: int = -1
    limited: int = 0
    """Seconds in which less than the command passed."""
    seconds: int = 0


def draw_lie(seed: int, spread: float = 0.25) -> LieRun:
    """A run in which the sensor begins to lie within the first hour, or after two."""
    random = np.random.default_rng([seed, 1])
    kind = str(random.choice(("rig", "kit", "both"), p=(0.55, 0.3, 0.15)))
    begins = _begin_of_lie(random)
    samples = begins + LASTS
    name, references = _draw_set_points(random, kind, samples)
    rooms = str(random.choice(ROOMS, p=(0.7, 0.1, 0.06, 0.07, 0.07)))
    restarts = begins + int(random.uniform(-300, 900)) if random.random() < 0.08 else -1
    lie_name, lie = _draw_lie(random)
    channels = ((0,), (1,), (0, 1))[random.integers(3)] if kind == "both" else (0,)
    return LieRun(
        seed, kind, _draw_plant(random, kind, spread), name, references,
        _draw_surroundings(random, kind, samples, rooms, begins + random.uniform(-600, 900)),
        lie_name, lie, channels, begins, restarts,
    )  # fmt: skip


def draw_healthy(seed: int, spread: float = 0.25) -> LieRun:
    """A healthy run of three hours."""
    random = np.random.default_rng([seed, 2])
    kind = str(random.choice(("rig", "kit", "both"), p=(0.55, 0.3, 0.15)))
    name, references = _draw_set_points(random, kind, HEALTHY_LASTS)
    rooms = str(random.choice(ROOMS, p=(0.2, 0.25, 0.1, 0.25, 0.2)))
    surroundings = _draw_surroundings(
        random, kind, HEALTHY_LASTS, rooms, random.uniform(0.0, 0.7 * HEALTHY_LASTS)
    )
    return LieRun(
        seed, kind, _draw_plant(random, kind, spread), name, references, surroundings
    )


def _begin_of_lie(random: np.random.Generator) -> int:
    """A fifth within the first minute, a third within ten, most others within the hour."""
    first, last = ((0, 60), (60, 600), (600, HOUR), (2 * HOUR, 2 * HOUR + 1))[
        random.choice(4, p=(0.2, 0.35, 0.38, 0.07))
    ]
    return int(random.uniform(first, last))


def _draw_plant(random: np.random.Generator, kind: str, spread: float) -> Parameters:
    seed = int(random.integers(1 << 30))
    if kind == "both":
        return whole_kit(seed, spread)
    return (RIG if kind == "rig" else KIT).plant(seed, spread)


def _draw_set_points(
    random: np.random.Generator, kind: str, samples: int
) -> tuple[str, FloatArray]:
    name = str(random.choice(tuple(SET_POINTS), p=(0.2, 0.2, 0.25, 0.25, 0.1)))
    low, high = SPANS[kind]
    course = np.resize(SET_POINTS[name](random, low, high), samples)
    if kind == "both":  # the weaker heater reaches less
        return name, np.column_stack([course, 25.0 + 0.5 * (course - 25.0)])
    return name, course[:, None]


def _constant(random: np.random.Generator, low: float, high: float) -> FloatArray:
    return np.array([random.uniform(low, high)])


def _default_profile(_: np.random.Generator, low: float, high: float) -> FloatArray:
    first, last = (20.0, 90.0) if high > 90.0 else (25.0, low + 42.0)
    return np.repeat(first + (last - first) * np.array([1.0, 3.0, 5.0, 3.0]) / 7.0, 300)


def _stairs(random: np.random.Generator, low: float, high: float) -> FloatArray:
    first = random.uniform(low, low + 10.0)
    up = np.arange(first, random.uniform(first + 15.0, high), random.uniform(4.0, 15.0))
    return np.repeat(np.concatenate([up, up[::-1]]), int(random.uniform(60, 600)))


def _ramps(random: np.random.Generator, low: float, high: float) -> FloatArray:
    """Up and down, at 0.3 to 6 °C/min."""
    first = random.uniform(low, low + 15.0)
    up = np.arange(
        first, random.uniform(first + 10.0, high), _between(random, 0.3, 6.0) / 60.0
    )
    return np.concatenate([up, np.full(int(random.uniform(0, 900)), up[-1]), up[::-1]])


def _steps(random: np.random.Generator, low: float, high: float) -> FloatArray:
    return np.repeat(random.uniform(low, high, 40), random.integers(60, 600, 40))


SPANS: Final = {"rig": (25.0, 95.0), "kit": (28.0, 68.0), "both": (28.0, 60.0)}
"""Between which set-points are drawn, °C; of both heaters of a kit, those of the stronger."""
SET_POINTS: Final[
    dict[str, Callable[[np.random.Generator, float, float], FloatArray]]
] = {
    "constant": _constant,
    "default profile": _default_profile,
    "stairs": _stairs,
    "ramps": _ramps,
    "steps": _steps,
}
"""Courses of a set-point between two temperatures, a value per second; they repeat."""


def _draw_surroundings(
    random: np.random.Generator, kind: str, samples: int, name: str, begins: float
) -> Surroundings:
    since = np.arange(samples) - begins
    ambient = np.zeros(samples)
    losses = np.ones(samples)
    if name in {"cools", "warms"}:
        within = float(random.choice((120.0, 1200.0, 7200.0)))
        change = ROOM_CHANGES if name == "warms" else -ROOM_CHANGES
        ambient = change * np.clip(since / within, 0.0, 1.0)
    elif name == "fan" and kind == "rig":
        losses = np.where(since < 0.0, 1.0, 0.1)
    elif name in {"draught", "fan"}:
        name = "draught"
        losses = np.where(since < 0.0, 1.0, 2.0 if kind == "rig" else 1.5)
    return Surroundings(name, ambient, losses)


def _between(random: np.random.Generator, low: float, high: float) -> float:
    """A value of which each decade is equally likely."""
    return float(math.exp(random.uniform(math.log(low), math.log(high))))


def _draw_lie(random: np.random.Generator) -> tuple[str, Lie]:
    name = str(
        random.choice(
            ("drift", "scale", "sine", "slide", "stuck"),
            p=(0.44, 0.14, 0.14, 0.14, 0.14),
        )
    )
    if name == "drift":
        rate = _between(random, 0.005, 1.0) * (-1.0 if random.random() < 0.85 else 1.0)
        return f"drifts by {rate:+.3f} °C/s", drifting(rate)
    if name == "scale":
        factor = random.uniform(0.5, 0.95)
        within = _between(random, 1.0, HOUR)
        return f"scaled by {factor:.2f} within {within:.0f} s", scaled(factor, within)
    if name == "sine":
        amplitude = random.uniform(5.0, 40.0)
        lasts = _between(random, 300.0, 2.0 * HOUR)
        return f"swings by {amplitude:.0f} °C in {lasts:.0f} s", _swinging(
            amplitude, lasts
        )
    if name == "slide":
        within = _between(random, 5.0, HOUR)
        return f"slides off within {within:.0f} s", sliding_off(within)
    return "stuck", lambda t, y: y[-1 - t]


def _swinging(amplitude: float, lasts: float) -> Lie:
    return lambda t, y: y[-1] - amplitude * math.sin(2.0 * math.pi * t / lasts)


def _bench(kind: str) -> Bench:
    return RIG if kind == "rig" else KIT


def _guards(kind: str) -> list[OutputGuard]:
    if kind == "both":
        return TCLabBridge.guards_of_both(TCLabBridge.LIMITS)
    return [_bench(kind).guard()]


def _changed(run: LieRun, k: int) -> Parameters:
    """The plant in what surrounds it at a sample."""
    losses = "sink_convection" if run.kind == "rig" else "losses"
    return run.plant.replace(
        **{
            "ambient": run.plant["ambient"] + run.surroundings.ambient[k],
            losses: run.plant[losses] * run.surroundings.losses[k],
        }
    )


def follow(run: LieRun) -> LieOutcome:
    """Run the loop behind its gate, which decides twice a second, until its end or a fault."""
    outputs = run.references.shape[1]
    law = law_of(TCLabBoth, 1.0) if run.kind == "both" else _bench(run.kind).loop
    noisy = 0.06 if run.kind == "rig" else 0.12
    noise = np.random.default_rng(run.seed).normal(0.0, noisy, run.references.shape)
    clocks = RunTime()
    controller = Controller(law)
    gate = OutputGate(clocks, _guards(run.kind))
    states = begin(run.plant, np.full(outputs, run.plant["ambient"] - KELVIN))
    histories: list[list[float]] = [[] for _ in range(outputs)]
    outcome = LieOutcome()
    plant = run.plant
    for k, reference in enumerate(run.references):
        if k % UPDATED == 0:
            plant = _changed(run, k)
        if k == run.restarts:
            gate = OutputGate(clocks, _guards(run.kind))
        true = readings(plant, states)
        measured = true + noise[k]
        for channel, history in enumerate(histories):
            history.append(float(true[channel]))
            if run.lie is not None and k >= run.begins and channel in run.channels:
                measured[channel] += run.lie(k - run.begins, history) - history[-1]
        command = np.atleast_1d(controller.step(reference, measured))
        states, applied = drive_for_a_second(
            gate, clocks, k, plant, states, measured, command
        )
        gate.sample(
            tuple(reference),
            tuple(measured),
            tuple(applied if gate.fault is not None else command),
        )
        outcome.limited += int(gate.armed and bool((applied < command).any()))
        _judge(run, k, true, outcome)
        if gate.fault is not None and not gate.armed and k > 1 and not outcome.fault:
            outcome.fault = gate.fault.kind.value
            outcome.fault_at = k
        outcome.seconds = k + 1
        if outcome.fault and k > outcome.fault_at + AFTER_A_FAULT:
            break
    return outcome


def _judge(run: LieRun, k: int, true: FloatArray, outcome: LieOutcome) -> None:
    """How far a plate is above what is allowed."""
    if k < run.begins:
        return
    allowed = np.maximum(
        run.references[max(0, k - BACK) : k + 1].max(axis=0) + ABOVE, WARM
    )
    beyond = float((true - allowed).max())
    outcome.highest = max(outcome.highest, float(true.max()))
    if beyond > outcome.beyond:
        outcome.beyond = beyond
        outcome.at = k
