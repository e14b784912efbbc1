"""What is said of two loops at constant set-points, to which something happens every ten minutes.

    python -m benchmarks.disturbed_loops 8
    python -m benchmarks.disturbed_loops 4 --seed 20 --verbose

Each run takes 85 minutes of a kit that differs from the plant file by up to a quarter: those with an even seed follow
its equations, the others those of the package `tclab`. Readings are means of ten, each in steps of the converter. The
law is a linear one, as hard as its seed has it. From the fifth minute on, something happens for five minutes, and
nothing for the next five: a sensor is off, the other one is, both are by the same, both are by the opposite; then a
heater lacks or exceeds a fifth of its range, the other one does, both do, and one lacks what the other exceeds.
Signs and order of the heaters and sensors are those of the seed.

Told are a sensor by its name within ten seconds, and a heater by its name within 200 s. Of both sensors a report
without a name that reads through neither is right, and of both heaters every name of a heater. All else is false. A
name that begins more than a minute after what it may mean is over is late.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.bank.kits import typical
from benchmarks.two_heaters import by_law, linear_law
from benchmarks.unseen_kits import (
    NOISE,
    Kit,
    KitOfPackage,
    KitOfPlantFile,
    in_words,
)
from twinmatch.dynamics import LinearLaw
from twinmatch.health.channel_alarms import ChannelAlarm
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.faults import Fault
from twinmatch.plants.tclab import RESOLUTION
from twinmatch.signals import FloatArray, Sample

SIZE = 5100
"""Length of a run, s."""
EVERY = 600
"""Time from one event to the next, s; the first one begins after half of it."""
LASTS = 300
"""How long an event lasts, s."""
IN_TIME = 200
"""Time within which a heater is to be named, s."""
AT_ONCE = 10
"""Time within which a sensor is to be named, s."""
MEANS = 10
"""Readings of which a mean is one sample."""
OFF = 5.0
"""What is added to the readings, °C."""
LACKS = 20.0
"""What is added to the heaters, %."""
REST = 50.0
"""Power of both heaters at the set-points, %."""
SENSORS = ("temperature", "second_temperature")
DRIVES = ("power", "second")


class Event(NamedTuple):
    """What is added to the readings, °C, and to the heaters, %, for a while."""

    begins: int
    offset: tuple[float, float] = (0.0, 0.0)
    power: tuple[float, float] = (0.0, 0.0)

    @property
    def ends(self) -> int:
        return self.begins + LASTS

    @property
    def is_of_heaters(self) -> bool:
        return any(self.power)

    @property
    def is_single(self) -> bool:
        return sum(map(bool, (*self.offset, *self.power))) == 1


def events_of(seed: int) -> list[Event]:
    """What happens in one run."""
    random = np.random.default_rng([seed, 91])
    begins = EVERY // 2
    events = []
    for size, is_of_heaters in ((OFF, False), (LACKS, True)):
        first = int(random.integers(0, 2))
        signs = random.choice((-1.0, 1.0), 4)
        pairs = [
            signs[0] * (np.arange(2) == first),
            signs[1] * (np.arange(2) != first),
            signs[2] * np.ones(2),
            signs[3] * np.array([1.0, -1.0]),
        ]
        for pair in pairs:
            added = (float(size * pair[0]), float(size * pair[1]))
            key = "power" if is_of_heaters else "offset"
            events.append(Event(begins, **{key: added}))
            begins += EVERY
    return events


def kit_of(seed: int, room: float) -> Kit:
    """One kit."""
    random = np.random.default_rng([seed, 92])
    return (KitOfPackage if seed % 2 else KitOfPlantFile)(random, room, 1.0)


def set_points_of(seed: int, room: float) -> FloatArray:
    """Where the kit rests with both heaters at their usual power."""
    kit = kit_of(seed, room)
    for _ in range(3000):
        kit.move(np.full(2, REST), 0.0, 1.0)
    return kit.read()


def law_of(hardness: float) -> LinearLaw:
    """A law for both heaters, which begins at rest; its gains are so many times the usual ones."""
    law = linear_law()
    untie = law.G / hardness
    rest = np.full(2, REST)
    return replace(
        law,
        C=hardness * law.C,
        D=hardness * law.D,
        E=hardness * law.E,
        G=untie,
        offset=rest,
        shift=-untie @ rest,
    )


def run(seed: int) -> Iterator[Sample]:
    """The samples of one run."""
    random = np.random.default_rng([seed, 93])
    room = random.uniform(19.0, 26.0)
    wanted = set_points_of(seed, room)
    kit = kit_of(seed, room)
    hardness = float(np.exp(random.uniform(np.log(0.25), np.log(1.5))))
    law = law_of(hardness)
    events = events_of(seed)
    for _ in range(1500):  # it begins at rest, nearly
        kit.move(np.full(2, REST), 0.0, 1.0)
    tick = by_law(law)
    for second in range(SIZE):
        on = next(
            (event for event in events if event.begins <= second < event.ends),
            Event(0),
        )
        true = kit.read() + NOISE * random.standard_normal((MEANS, 2))
        read = (true - np.mod(true, RESOLUTION)).mean(axis=0) + np.array(on.offset)
        sample = tick(second, tuple(wanted.tolist()), tuple(read.round(3).tolist()))
        yield sample
        arrives = np.clip(np.array(sample.inputs) + np.array(on.power), 0.0, 100.0)
        kit.move(arrives, 0.0, 1.0)


class Said(NamedTuple):
    """What was said of one run."""

    sensors: int
    """Single sensors that were named in time, of two."""
    both_sensors: int
    """Pairs of sensors that were reported without a name at once, of two."""
    delays: list[int]
    """After how long single heaters were named, s."""
    both_heaters: int
    """Pairs of heaters of which one or both were named, of two."""
    false: list[ChannelAlarm]
    unnamed: list[ChannelAlarm]


def said_of(alarms: list[ChannelAlarm], events: list[Event]) -> Said:
    """Sort the alarms of a run."""
    said = Said(0, 0, [], 0, [], [])
    sensors = both_sensors = both_heaters = 0
    told: set[int] = set()
    for alarm in alarms:
        number = next(
            (k for k, e in enumerate(events) if e.begins <= alarm.flagged < e.ends), -1
        )
        if number < 0:
            (said.unnamed if alarm.fault is Fault.DRIFT else said.false).append(alarm)
            continue
        event = events[number]
        delay = alarm.flagged - event.begins
        is_news = number not in told
        if not event.is_single and not event.is_of_heaters:
            if alarm.fault is Fault.DRIFT and delay <= AT_ONCE:
                both_sensors += is_news
                told.add(number)
            else:
                said.false.append(alarm)
        elif alarm.fault is Fault.DRIFT:
            said.unnamed.append(alarm)
        elif not _is_right(alarm, event):
            said.false.append(alarm)
        elif is_news:
            told.add(number)
            if not event.is_single:
                both_heaters += 1
            elif event.is_of_heaters:
                said.delays.append(delay)
            elif delay <= AT_ONCE:
                sensors += 1
    return said._replace(
        sensors=sensors, both_sensors=both_sensors, both_heaters=both_heaters
    )


def _is_right(alarm: ChannelAlarm, event: Event) -> bool:
    """Whether it names what happens, and says of a heater whether it does more or less."""
    if not event.is_of_heaters:
        concerned = [
            name for name, off in zip(SENSORS, event.offset, strict=True) if off
        ]
        return alarm.fault is Fault.SENSOR_DRIFT and alarm.signal in concerned
    signs = {
        name: added > 0.0
        for name, added in zip(DRIVES, event.power, strict=True)
        if added
    }
    if len(set(signs.values())) == 1 and len(signs) == 2:
        signs[""] = signs[DRIVES[0]]
    return (
        alarm.fault is Fault.DRIVE_WEAK
        and alarm.signal in signs
        and (alarm.size > 1.0) == signs[alarm.signal]
    )


def alarms_of(seed: int) -> list[ChannelAlarm]:
    """What the monitor says of one run."""
    monitor = ChannelMonitor(typical(), 1.0)
    for sample in run(seed):
        monitor.push(sample)
    return list(monitor.alarms)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.disturbed_loops", description=__doc__
    )
    parser.add_argument("runs", type=int)
    parser.add_argument("--seed", type=int, default=0, help="that of the first run")
    parser.add_argument("--verbose", action="store_true", help="a line for each alarm")
    options = parser.parse_args()
    print("run  sensors  both  heaters, s  both  unnamed  false", flush=True)
    totals = np.zeros(6, dtype=int)
    for seed in range(options.seed, options.seed + options.runs):
        events = events_of(seed)
        alarms = alarms_of(seed)
        said = said_of(alarms, events)
        in_time = sum(delay <= IN_TIME for delay in said.delays)
        false = " ".join(f"{a.fault.value}@{a.flagged}" for a in said.false)
        print(
            f"{seed:3d}  {said.sensors} of 2   {said.both_sensors} of 2  "
            f"{said.delays!s:12s} {said.both_heaters} of 2  {len(said.unnamed)}  {false}",
            flush=True,
        )
        for alarm in alarms if options.verbose else ():
            mark = "FALSE " if alarm in said.false else ""
            print(f"    {mark}{in_words(alarm)}", flush=True)
        totals += [
            said.sensors,
            said.both_sensors,
            in_time,
            said.both_heaters,
            len(said.unnamed),
            len(said.false),
        ]
    pairs = 2 * options.runs
    print(
        f"sensors {totals[0]} of {pairs}, both {totals[1]} of {pairs}; heaters within {IN_TIME} s "
        f"{totals[2]} of {pairs}, both {totals[3]} of {pairs}; unnamed {totals[4]}, false {totals[5]}"
    )


if __name__ == "__main__":
    main()
