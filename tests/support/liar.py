"""A plant in its loop behind the guard, with a sensor that begins to lie."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from tests.support.faulty_rig import CAMERA, RICH_RIG
from tests.support.watched import copied
from twinmatch.dynamics import (
    Controller,
    Law,
    Parameters,
    Sensor,
    advance,
    begin,
    law_of,
    read,
    readings,
)
from twinmatch.nodes.gated import ClockTimes, GatedNode, OutputGate
from twinmatch.nodes.pwm_bridge import PwmBridge
from twinmatch.nodes.tclab_bridge import TCLabBridge
from twinmatch.plants import Peltier, TCLab, TCLabBoth
from twinmatch.safety import GuardFault, OutputGuard
from twinmatch.signals import KELVIN, NANOSECONDS, FloatArray

BEGINS = 600
"""Sample at which the sensor begins to lie."""
LIMITED = 900
"""Seconds with a limit after which a plate has settled: what a limited drive reads is not learned."""
ROOM = 22.0
"""What a sensor reads that has slipped off, °C."""


class Bench(NamedTuple):
    """A kind of plant with what stands between its command and its heater."""

    typical: Parameters
    spread: tuple[str, ...]
    """Parameters that differ from plant to plant."""
    loop: Law
    sensor: Sensor
    bridge: type[GatedNode]

    def guard(self) -> OutputGuard:
        """As its bridge makes it."""
        return OutputGuard(self.bridge.LIMITS, self.bridge.observer(self.bridge.LIMITS))

    def plant(self, seed: int, spread: float = 0.25) -> Parameters:
        """A plant with parameters that differ by up to `spread`, in some room."""
        random = np.random.default_rng(seed)
        moved = {
            name: self.typical[name] * random.uniform(1 - spread, 1 + spread)
            for name in self.spread
        }
        return self.typical.replace(**moved, ambient=random.uniform(288.0, 301.0))


RIG = Bench(
    RICH_RIG.replace(conductance=0.6, heat_capacity=28.0, sink_heat_capacity=300.0, sink_convection=4.5),
    ("seebeck", "conductance", "heat_capacity", "sink_heat_capacity", "sink_convection"),
    replace(Peltier.loop, back_calculation=1.0), CAMERA, PwmBridge,
)  # fmt: skip
KIT = Bench(
    TCLab.model("sensor lag").typical(), ("losses", "heating", "heat_capacity", "sensor_lag"),
    TCLab.loop, replace(TCLab.sensor, noise=0.12), TCLabBridge,
)  # fmt: skip

Lie = Callable[[int, Sequence[float]], float]
"""What the sensor reads, so many seconds after it began to lie, of a plant with these temperatures."""


def drifting(rate: float) -> Lie:
    return lambda t, y: y[-1] + rate * t


def sliding_off(seconds: float) -> Lie:
    return lambda t, y: ROOM + (y[-1] - ROOM) * math.exp(-t / seconds)


def late(seconds: int) -> Lie:
    return lambda t, y: y[-1 - min(t, seconds)]


def scaled(factor: float, within: float) -> Lie:
    return lambda t, y: (1.0 - (1.0 - factor) * min(t / within, 1.0)) * y[-1]


RATES = (0.05, 0.1, 0.2, 0.4, 0.8, 2.0)
DRIFTS = (*(-rate for rate in RATES), *RATES)
LIES: dict[str, Lie] = {
    **{f"drifts by {rate:+g} °C/s": drifting(rate) for rate in DRIFTS},
    **{
        f"slides off within {seconds:g} s": sliding_off(seconds)
        for seconds in (5.0, 20.0, 60.0)
    },
    "stuck at 20 °C": lambda _, __: 20.0,
    **{f"{seconds} s late": late(seconds) for seconds in (5, 10, 20, 60)},
    "scaled by 0.7": scaled(0.7, 1e-9),
    "scaled by 0.7 within 60 s": scaled(0.7, 60.0),
}


class SlowLie(NamedTuple):
    """A lie that no reading contradicts for minutes."""

    lie: Lie
    lasts: int
    """s."""
    begins: int = BEGINS


SLOW_LIES: dict[str, SlowLie] = {
    **{
        f"drifts by -{rate:g} °C/s": SlowLie(drifting(-rate), lasts)
        for rate, lasts in (
            (0.005, 5600),
            (0.01, 5600),
            (0.02, 3600),
            (0.05, 1800),
            (0.2, 900),
        )
    },
    **{
        f"scaled by {factor:g} within {minutes} min": SlowLie(
            scaled(factor, 60.0 * minutes), lasts
        )
        for minutes, lasts in ((10, 1800), (30, 3000), (60, 4800))
        for factor in (0.85, 0.7, 0.5)
    },
    "frozen from the beginning": SlowLie(lambda _, y: y[0], 900, begins=0),
}


@dataclass
class Ending:
    """How a run ended."""

    highest: float = -math.inf
    """Highest temperature of the plant since the lie began, °C."""
    after: int | None = None
    """Seconds from the lie to zero output; None: never."""
    fault: GuardFault | None = None
    limited: int = 0
    """Seconds in which less than the command passed."""


class GuardedLoop:
    """A plant in its loop behind a guard, which decides twice a second, with a sensor that may lie."""

    def __init__(  # noqa: PLR0917
        self,
        bench: Bench,
        guard: OutputGuard,
        plant: Parameters,
        size: int,
        seed: int,
        begins: int,
    ) -> None:
        """Begin cold; the sensor lies from the second `begins` on, of at most `size`."""
        self._guard = guard
        self._plant = plant
        self._begins = begins
        self._sensor = bench.sensor.realise(size, 1.0, seed)
        self._controller = Controller(bench.loop)
        self._states = begin(
            plant, plant["ambient"] - bench.typical.model.plant.output.absolute
        )
        self._true = list[float]()
        self._measured = 0.0
        self._applied = math.inf
        self.ending = Ending()

    def run(self, references: Sequence[float], lie: Lie | None) -> Ending:
        """Run on over set-points, a second each, to their end or the guard's word."""
        for reference in references:
            self._second(reference, lie)
            if self._is_over(lie):
                break
        return self.ending

    def _second(self, reference: float, lie: Lie | None) -> None:
        k = len(self._true)
        guard = self._guard
        ending = self.ending
        self._true.append(read(self._plant, self._states))
        is_true = lie is None or k < self._begins
        reported = (
            self._true[-1]
            if is_true or lie is None
            else lie(k - self._begins, self._true)
        )
        if not (self._sensor.frozen[k] and k):
            self._measured = reported + float(self._sensor.noise[k])
        measured = self._measured
        command = self._controller.step(float(reference), measured)[0]
        if lie is None or k >= self._begins:
            ending.highest = max(ending.highest, self._true[-1])
        for half in (0.0, 0.5):
            time = k + half
            guard.command(command, time)
            guard.temperature(measured, time)
            # As the controller's samples: they have what was applied.
            passed = command if guard.limited is None else min(command, self._applied)
            guard.loop(reference, measured, passed, time)
            self._applied = guard.output(time)
            self._states = advance(self._plant, self._states, self._applied, 0.5)
        ending.limited += guard.fault is None and self._applied < command
        if guard.fault is not None and ending.fault is None:
            ending.fault = guard.fault
            ending.after = k - self._begins

    def _is_over(self, lie: Lie | None) -> bool:
        k = len(self._true) - 1
        ending = self.ending
        ended = ending.fault is not None and k > self._begins + (ending.after or 0) + 30
        return ended or (lie is not None and ending.limited > LIMITED)


def lie_to(  # noqa: PLR0917
    bench: Bench, guard: OutputGuard, plant: Parameters, references: Sequence[float], lie: Lie | None = None,
    seed: int = 0, begins: int = BEGINS,
) -> Ending:  # fmt: skip
    """Run a loop from its beginning over set-points, a second each."""
    return GuardedLoop(bench, guard, plant, len(references), seed, begins).run(
        references, lie
    )


@cache
def held_without_a_lie(bench: Bench, set_point: float) -> GuardedLoop:
    """A loop that has held a set-point until its sensor begins to lie, and may run on in a copy."""
    loop = GuardedLoop(bench, bench.guard(), bench.plant(3), 2 * BEGINS, 3, BEGINS)
    loop.run([set_point] * BEGINS, None)
    loop.ending = Ending(limited=loop.ending.limited)
    return loop


def lie_on(held_loop: GuardedLoop, lie: Lie, set_point: float, seconds: int) -> Ending:
    """Let the sensor of such a loop lie for so long."""
    loop: GuardedLoop = copied(held_loop)
    return loop.run([set_point] * seconds, lie)


def whole_kit(seed: int, spread: float = 0.25) -> Parameters:
    """A whole kit, its heater 2 with half to three quarters of the power of heater 1."""
    random = np.random.default_rng(seed)
    typical = TCLabBoth.model("sensor lags").typical()
    low = 1.0 - spread
    high = 1.0 + spread
    moved = {
        name: typical[name] * random.uniform(low, high)
        for name in ("losses", "heating", "exchange")
    }
    moved["second_heating"] = moved["heating"] * random.uniform(0.5, 0.75)
    return typical.replace(**moved, ambient=random.uniform(288.0, 301.0))


class RunTime:
    """The clocks of a gate: the time of a simulated run, s."""

    now = 0.0

    def __call__(self) -> ClockTimes:
        return ClockTimes(*[round(self.now * NANOSECONDS) + NANOSECONDS] * 3)


def drive_for_a_second(  # noqa: PLR0917
    gate: OutputGate, clocks: RunTime, k: int, plant: Parameters, states: FloatArray, measured: FloatArray,
    command: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """The states after second k behind a gate, which decides twice, and what it let pass last."""
    applied = np.zeros(command.size)
    for half in (0.0, 0.5):
        clocks.now = k + half
        gate.command(command, k, clocks().stamps)
        gate.temperature(measured, clocks().stamps)
        applied = np.array(gate.decide().inputs)
        states = advance(plant, states, applied, 0.5)
    return states, applied


def lie_to_both(
    plant: Parameters,
    references: FloatArray,
    lie: Lie | None = None,
    channel: int = 0,
    seed: int = 0,
) -> list[Ending]:
    """The same of a kit whose heaters are both driven, behind their gate: the sensor of one channel lies.
    Set-points have shape (N, 2)."""
    clocks = RunTime()
    random = np.random.default_rng(seed)
    gate = OutputGate(clocks, TCLabBridge.guards_of_both(TCLabBridge.LIMITS))
    controller = Controller(law_of(TCLabBoth, 1.0))
    states = begin(plant, [plant["ambient"] - KELVIN] * 2)
    true = list[FloatArray]()
    endings = [Ending(), Ending()]
    for k in range(len(references)):
        true.append(readings(plant, states))
        measured = true[-1] + 0.12 * random.standard_normal(2)
        if lie is not None and k >= BEGINS:
            measured[channel] += (
                lie(k - BEGINS, [row[channel] for row in true[-80:]])
                - true[-1][channel]
            )
        command = controller.step(references[k], measured)
        states, applied = drive_for_a_second(
            gate, clocks, k, plant, states, measured, command
        )
        gate.sample(tuple(references[k]), tuple(measured), tuple(applied))
        for number, ending in enumerate(endings):
            if lie is None or k >= BEGINS:
                ending.highest = max(ending.highest, float(true[-1][number]))
            ending.limited += gate.armed and applied[number] < command[number]
            if (
                ending.fault is None
                and gate.fault is not None
                and not gate.armed
                and k > 1
            ):
                ending.fault = gate.fault
                ending.after = k - BEGINS
        if endings[0].fault is not None and k > BEGINS + (endings[0].after or 0) + 60:
            assert not applied.any()
            break
    return endings
