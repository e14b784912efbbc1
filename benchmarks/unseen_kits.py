"""What is said of kits with two heaters that differ from the plant file, before, during and after a mishap.

    python -m benchmarks.unseen_kits 14
    python -m benchmarks.unseen_kits 4 --seed 100 --only draught --law linear --verbose

The number is that of kits for each mishap. Kits with an even seed follow the equations of the plant file, and so do
all kits whose losses change; the others follow the equations of the package `tclab`, in which losses change the
short time constant, so that such a change looks like other heaters. Parameters differ by up to a quarter from the
usual ones, rooms by some degrees, and a fan blows at every third kit. Told is the right name, with its channel, as
the first one during the mishap; every other name is false. Unnamed ones (`drift`) are counted apart.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from benchmarks.bank.kits import typical
from benchmarks.two_heaters import by_law, by_pids, linear_law
from twinmatch.dynamics import advance, begin
from twinmatch.dynamics.simulation import readings
from twinmatch.health.channel_alarms import ChannelAlarm
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.faults import Fault
from twinmatch.plants.tclab import RESOLUTION
from twinmatch.signals import KELVIN, FloatArray, Sample

SIZE = 3300
"""Length of a run, s."""
BEGINS = 1500
"""When a mishap begins, s."""
NOISE = 0.043
"""Standard deviation of a reading before it is truncated to a step of its display, °C."""
APART = 0.25
"""By how much parameters differ at most, as a share."""
LAWS = ("pid", "linear")


class Mishap(NamedTuple):
    """What happens to a kit for a while; numbers are of one heater or sensor each."""

    fault: str
    signal: str
    """Name by which it is to be reported, and the signal in the plant file; empty: any."""
    lasts: int
    """How long it lasts, s."""
    offset: tuple[float, float] = (0.0, 0.0)
    """What is added to the readings, °C."""
    share: tuple[float, float] = (1.0, 1.0)
    """What arrives of the heaters' power."""
    losses: float = 1.0
    """Factor on what goes to the room."""
    lower: bool = False
    """Whether the set-point of loop 1 steps down by 10 °C a minute after it began."""


MISHAPS = {
    "draught": Mishap("losses-changed", "losses", 420, losses=2.5),
    "lid": Mishap("losses-changed", "losses", 600, losses=0.5),
    "weak supply": Mishap("drive-weak", "", 600, share=(0.7, 0.7)),
    "T1 +5 °C": Mishap("sensor-drift", "temperature", 500, offset=(5.0, 0.0)),
    "T2 -4 °C": Mishap("sensor-drift", "second_temperature", 400, offset=(0.0, -4.0)),
    "T1 +5 °C, step": Mishap(
        "sensor-drift", "temperature", 1800, offset=(5.0, 0.0), lower=True
    ),
}  # fmt: skip
NOTHING = Mishap("", "", 0)


class Kit(Protocol):
    """Two heaters and their sensors."""

    def read(self) -> FloatArray:
        """Temperatures of the sensors, °C."""

    def move(self, power: FloatArray, warmer: float, losses: float) -> None:
        """Move one second on, with these powers, %, a room that is `warmer` than usually, K, and a factor on the
        losses."""


class KitOfPlantFile:
    """The published balance, with other parameters."""

    def __init__(self, random: np.random.Generator, room: float, fan: float) -> None:
        base = typical()
        other = {
            name: base[name] * _apart(random)
            for name in base.model.structure.free
            if name != "ambient"
        }
        other["losses"] *= fan
        self._room = room + KELVIN
        self._parameters = base.replace(**other, ambient=self._room)
        self._states = begin(self._parameters, np.full(2, room))

    def read(self) -> FloatArray:
        return readings(self._parameters, self._states)

    def move(self, power: FloatArray, warmer: float, losses: float) -> None:
        now = self._parameters.replace(
            ambient=self._room + warmer, losses=losses * self._parameters["losses"]
        )
        self._states = advance(now, self._states, power, 1.0)


class KitOfPackage:
    """The equations of the package `tclab`, with other parameters."""

    _SLICES = 5
    """Steps of the equations in a second."""

    def __init__(self, random: np.random.Generator, room: float, fan: float) -> None:
        self._room = room
        self._heating = np.array(
            [200.0 / 5720.0 * _apart(random), 100.0 / 5720.0 * _apart(random)]
        )
        self._losses = fan * _apart(random) / 20.0
        self._exchange = _apart(random) / 100.0
        self._lag = 140.0 * _apart(random)
        self._heaters = np.full(2, room)
        self._sensors = np.full(2, room)

    def read(self) -> FloatArray:
        return self._sensors.copy()

    def move(self, power: FloatArray, warmer: float, losses: float) -> None:
        room = self._room + warmer
        for _ in range(self._SLICES):
            crossing = self._exchange * (self._heaters[::-1] - self._heaters)
            lost = losses * self._losses * (self._heaters - room)
            heaters = self._heaters + (self._heating * power - lost + crossing) / (
                self._SLICES
            )
            behind = self._heaters - self._sensors
            self._sensors = self._sensors + behind / (self._lag * self._SLICES)
            self._heaters = heaters


def _apart(random: np.random.Generator) -> float:
    """A factor by which a parameter differs."""
    return math.exp(random.uniform(-APART, APART))


@dataclass
class SetPoints:
    """Set-points that step every few minutes."""

    random: np.random.Generator
    wanted: FloatArray
    steps_at: int = 0
    """Next second at which they step."""

    def at(self, second: int) -> FloatArray:
        if second >= self.steps_at:
            which = int(self.random.integers(0, 3))
            level = self.random.uniform(30.0, 55.0, 2).round(1)
            steps = (np.arange(2) == which) | (which == 2)
            self.wanted = np.where(steps, level, self.wanted)
            self.steps_at = second + int(self.random.uniform(200.0, 500.0))
        return self.wanted


def run(seed: int, mishap: Mishap, law: str) -> Iterator[Sample]:
    """The samples of one kit, which is the same until something happens to it."""
    random = np.random.default_rng([seed, 77])
    room = random.uniform(17.0, 27.0)
    fan = 1.6 if seed % 3 == 2 else 1.0
    # With other losses, the equations of the package are those of other heaters.
    is_of_package = seed % 2 == 1 and mishap.losses == 1.0
    kit: Kit = (KitOfPackage if is_of_package else KitOfPlantFile)(random, room, fan)
    phase = random.uniform(0.0, 2.0 * math.pi)
    set_points = SetPoints(random, np.full(2, 35.0))
    noise = np.random.default_rng([seed, 78])
    tick: Callable[..., Sample] = by_pids() if law == "pid" else by_law(linear_law())
    for second in range(SIZE):
        is_on = BEGINS <= second < BEGINS + mishap.lasts
        on = mishap if is_on else NOTHING
        true = kit.read() + NOISE * noise.standard_normal(2)
        read = true - np.mod(true, RESOLUTION) + np.array(on.offset)
        wanted = set_points.at(second)
        if on.lower and second >= BEGINS + 60:
            wanted = np.maximum(wanted - np.array([10.0, 0.0]), 25.0)
        outputs = tuple(read.round(2).tolist())
        sample = tick(second, tuple(wanted.tolist()), outputs)
        yield sample
        warmer = 0.4 * math.sin(2.0 * math.pi * second / 3600.0 + phase)
        kit.move(np.array(sample.inputs) * np.array(on.share), warmer, on.losses)


class Said(NamedTuple):
    """What was said of one kit."""

    delay: int | None
    """After how long the mishap got its name, s; None if it got none."""
    false: list[ChannelAlarm]
    unnamed: list[ChannelAlarm]


def said_of(alarms: list[ChannelAlarm], mishap: Mishap) -> Said:
    """Sort the alarms of a run."""
    delay: int | None = None
    false = []
    unnamed = []
    is_first = True
    for alarm in alarms:
        during = BEGINS <= alarm.flagged < BEGINS + mishap.lasts
        is_right = alarm.fault.value == mishap.fault and (
            not mishap.signal or alarm.signal == mishap.signal
        )
        if alarm.fault is Fault.DRIFT:
            unnamed.append(alarm)
        elif not (during and is_right):
            false.append(alarm)
        elif is_first:
            delay = alarm.flagged - BEGINS
        if during and alarm.fault is not Fault.DRIFT:
            is_first = False
    return Said(delay, false, unnamed)


def alarms_of(seed: int, mishap: Mishap, law: str) -> list[ChannelAlarm]:
    """What the monitor says of one kit."""
    monitor = ChannelMonitor(typical(), 1.0)
    for sample in run(seed, mishap, law):
        monitor.push(sample)
    return list(monitor.alarms)


def in_words(alarm: ChannelAlarm) -> str:
    """An alarm with what competed."""
    near = ", ".join(
        f"{suspect.cause[0].value} {suspect.cause[1]} {suspect.evidence:.1f}"
        f" ({suspect.shift:.2g} ± {suspect.error:.2g} since {suspect.born})"
        for suspect in alarm.suspects[:6]
    )
    return (
        f"{alarm.flagged} {alarm.fault.value} {alarm.signal} {alarm.size:.2f} since {alarm.first},"
        f" over {alarm.last}: {near}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.unseen_kits", description=__doc__
    )
    parser.add_argument("kits", type=int)
    parser.add_argument("--seed", type=int, default=0, help="that of the first kit")
    parser.add_argument(
        "--only", choices=MISHAPS, action="append", help="mishaps; default: all"
    )
    parser.add_argument("--law", choices=LAWS, default="pid")
    parser.add_argument("--verbose", action="store_true", help="a line for each alarm")
    options = parser.parse_args()
    print("mishap          told  median worst  unnamed  false names", flush=True)
    all_false = all_told = all_unnamed = 0
    titles = options.only or list(MISHAPS)
    for title in titles:
        delays = []
        names = []
        unnamed = 0
        for seed in range(options.seed, options.seed + options.kits):
            alarms = alarms_of(seed, MISHAPS[title], options.law)
            said = said_of(alarms, MISHAPS[title])
            if said.delay is not None:
                delays.append(said.delay)
            names += [f"{seed}:{a.fault.value}@{a.flagged}" for a in said.false]
            unnamed += len(said.unnamed)
            for alarm in alarms if options.verbose else ():
                mark = "FALSE " if alarm in said.false else ""
                print(f"  {seed} {mark}{in_words(alarm)}", flush=True)
        times = (
            f"{np.median(delays):6.0f} {max(delays):5d}" if delays else "     –     –"
        )
        print(
            f"{title:15s} {len(delays):4d}  {times}  {unnamed:7d}  {' '.join(names)}",
            flush=True,
        )
        all_told += len(delays)
        all_false += len(names)
        all_unnamed += unnamed
    cases = len(titles) * options.kits
    print(f"told {all_told} of {cases}, false {all_false}, unnamed {all_unnamed}")


if __name__ == "__main__":
    main()
