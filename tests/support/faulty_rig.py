"""A rig in closed loop that can be broken.

The plate stands on a sink with mass, seen through a camera whose readings jump and settle at a flat-field
correction, as the real one's do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tests.support.watched import Watched, watched
from twinmatch.dynamics import Controller, Parameters, advance, begin, read
from twinmatch.health import (
    Fault,
    Health,
    HealthSettings,
    HealthState,
    Monitor,
    Refusals,
)
from twinmatch.plants import Peltier
from twinmatch.signals import FloatArray, Sample
from twinmatch.twin import TwinSettings

RICH_RIG = Peltier.model("sink with mass").parameters(
    seebeck=0.06,
    conductance=0.5,
    heat_capacity=27.0,
    ambient=295.0,
    sink_heat_capacity=250.0,
    sink_convection=6.0,
)
"""The truth: a heat sink with mass, cooled by a fan."""
CAMERA = replace(Peltier.sensor, noise=0.06)
FLAT_FIELD_JUMP = 0.8
FLAT_FIELD_KEEPS = 0.93
"""Standard deviation of the jump, °C, and what is left of it after a second."""
FANS = {"fan-failed": 0.1, "draught": 3.0}
"""Convection from the sink, as a share of what it was."""
SLOWLY = 300.0
"""What comes slowly has come after this time, s."""


@dataclass(frozen=True)
class Break:
    kind: str
    """`heat±X` warms the plate by X °C in all, evenly, from elsewhere."""
    start: int
    length: int = 1_000_000

    def on(self, k: int) -> bool:
        return self.start <= k < self.start + self.length


def profile(seed: int, samples: int) -> FloatArray:
    """Set-points like those of the rig's recordings, °C."""
    random = np.random.default_rng(seed)
    levels: list[float] = []
    while len(levels) < samples:
        levels += [float(random.choice(np.arange(20, 100, 0.5)))] * int(
            random.integers(100, 400)
        )
    return np.array(levels[:samples])


def some_rig(seed: int) -> Parameters:
    """A rig within 15 % of the virtual one, in some room."""
    a, b, c = np.random.default_rng(seed).uniform(0.85, 1.15, 3)
    return RICH_RIG.replace(
        seebeck=0.06 * a,
        conductance=0.5 * b,
        heat_capacity=27.0 * c,
        ambient=np.random.default_rng(seed + 1).uniform(289, 299),
    )


def run(
    reference: FloatArray,
    broken: Break | None = None,
    *,
    rig: Parameters = RICH_RIG,
    seed: int = 0,
    period: float = 1.0,
) -> tuple[list[Sample], FloatArray]:
    """Samples, and the plate's true temperature, °C."""
    camera = CAMERA.realise(len(reference), period, seed)
    random = np.random.default_rng(seed)
    pid = Controller(replace(Peltier.loop, period=period, back_calculation=1 / period))
    room = rig["ambient"] - Peltier.output.absolute
    states = begin(rig, room)
    samples: list[Sample] = []
    truth = np.empty(len(reference))
    jump = 0.0
    last = None
    for k, wanted in enumerate(reference):
        kind = broken.kind if broken is not None and broken.on(k) else ""
        truth[k] = read(rig, states)
        if k and camera.frozen[k] and not camera.frozen[k - 1]:
            jump = FLAT_FIELD_JUMP * random.standard_normal()
        jump *= FLAT_FIELD_KEEPS**period
        reading = room if kind == "sensor-off" else truth[k] + jump
        reading += (
            _offset(kind, (k - broken.start) * period) if broken is not None else 0.0
        )
        reading = round(reading + float(camera.noise[k]), 2)
        if last is not None and (camera.frozen[k] or kind == "sensor-frozen"):
            reading = last
        last = reading
        pwm = pid.step(float(wanted), reading)[0]
        samples.append(Sample(k, k, float(wanted), reading, pwm))
        since = (
            (k - broken.start) * period if broken is not None and "~" in kind else 0.0
        )
        states = advance(
            _broken_rig(rig, kind, min(since, SLOWLY)), states, pwm, period
        )
        if broken is not None and kind.startswith("heat"):
            states[0] += float(kind[4:]) * period / broken.length
    return samples, truth


def _offset(kind: str, since: float) -> float:
    """By what the reading is off, so many seconds after the break, °C."""
    if kind.startswith("reading+"):
        return float(kind[8:])
    if kind.startswith("reading~"):
        return float(kind[8:]) * min(since / SLOWLY, 1.0)
    return 12.0 if kind == "reading-offset" else 0.0


@lru_cache(maxsize=64)
def _broken_rig(rig: Parameters, kind: str, since: float = 0.0) -> Parameters:
    """The rig while something is broken, so many seconds after it broke."""
    if kind == "drive-lost":
        return rig.replace(current_limit=1e-9)
    if kind.startswith("supply"):
        come = min(since / SLOWLY, 1.0) if kind[6] == "~" else 1.0
        return rig.replace(
            supply=(1.0 - (1.0 - float(kind[7:])) * come) * rig["supply"]
        )
    if kind.startswith("room"):
        return rig.replace(ambient=rig["ambient"] + float(kind[4:]))
    if kind in FANS:
        return rig.replace(sink_convection=FANS[kind] * rig["sink_convection"])
    return rig


def watch(
    samples: list[Sample],
    parameters: Parameters | None = None,
    settings: HealthSettings | None = None,
) -> tuple[Monitor, list[Health]]:
    def begin() -> Watched:
        monitor = Monitor(settings)
        return Watched(monitor, Refusals(monitor.settings, TwinSettings().schedule.gap))

    if parameters is None and settings is None:
        watched_rig = watched("rig", begin, samples)
        return watched_rig.monitor, watched_rig.healths
    begun = begin()
    monitor = begun.monitor
    refusals = begun.refusals
    assert refusals is not None
    return monitor, [monitor.push(refusals.settle(s), parameters) for s in samples]


def names_told(kind: str, seed: int) -> tuple[str, int | None]:
    """The first name that is reported for a lasting change, and how many samples after it.

    "early" is one reported before; "nothing" if none is, and "suspected" if only that.
    """
    start = int(np.random.default_rng(seed).integers(500, 900))
    samples, _ = run(
        profile(seed + 1000, 1900), Break(kind, start), rig=some_rig(seed), seed=seed
    )

    def named(monitor: Monitor) -> bool:
        return any(alarm.fault is not Fault.DRIFT for alarm in monitor.alarms)

    watched_rig = watched("rig as it reads", lambda: Watched(Monitor()), samples, named)
    monitor = watched_rig.monitor
    healths = watched_rig.healths
    if not monitor.alarms:
        doubted = any(
            h.state is HealthState.SUSPECT and h.index > start for h in healths
        )
        return ("suspected" if doubted else "nothing"), None
    reported = [a for a in monitor.alarms if a.fault is not Fault.DRIFT] or list(
        monitor.alarms
    )
    if monitor.alarms[0].flagged < start:
        return "early", None
    return reported[0].fault.value, reported[0].flagged - start
