"""False names on plants that nobody tuned anything on, and what faults made in the loop are called.

    python -m benchmarks.abroad healthy 12 1.5
    python -m benchmarks.abroad faults 3 --kind motor

The numbers are those of plants of each kind and of hours for each; a motor's hour has 3600 samples.
`--monitor`: the health monitor alone, without a twin. `--verbose`: a line for each alarm. Progress goes to
standard error.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from tests.support.abroad import KINDS, MISHAPS, AbroadPlant, Mishap
from twinmatch.comparing import TrustLevel
from twinmatch.health import Alarm, HealthSettings, Monitor, Refusals
from twinmatch.signals import Sample
from twinmatch.twin import ScheduleSettings, Twin, TwinSettings

RIGHT = {
    "reading+": "sensor-drift",
    "reading~": "sensor-drift",
    "reading late": "sensor-late",
    "input late": "sensor-late",
    "frozen": "sensor-frozen",
    "spike": "sensor-implausible",
    "drive*0.": "drive-weak",
    "drive*0": "drive-lost",
    "losses": "losses-changed",
    "pushed": "disturbance",
}
"""The name of a mishap by how its kind begins; the first that fits counts."""
VAGUE = "drift"
"""Says that something has changed, and accuses nobody."""
STARTS, LASTS, AFTER = 1500, 900, 600
"""When a mishap comes at the earliest, how long it lasts, what is watched after it: seconds of the kind."""
BLINK = 120
"""Seconds of the kind for which a sensor that lies may still be trusted."""


@dataclass
class Watched:
    """What was said of one run."""

    seed: int
    lacks: tuple[str, ...]
    samples: int = 0
    hours: float = 0.0
    alarms: list[Alarm] = field(default_factory=list)
    in_alarm: int = 0
    """Samples."""
    trusted: list[bool] = field(default_factory=list)
    """Whether the newest verdict of a sample trusts the leader."""
    verdicts: int = 0
    trusting: int = 0
    took: float = 0.0


def watch(plant: AbroadPlant, samples: Iterable[Sample], *, alone: bool) -> Watched:
    """Judge samples as `replay` does with default settings, or by the monitor alone."""
    kind, told = plant.kind, Watched(plant.seed, plant.lacks or ())
    began, push, monitor_of = time.perf_counter(), *_judge(plant, alone=alone)
    trusted, newest = False, None
    for sample in samples:
        for level in push(sample):
            told.verdicts += 1
            trusted = level is TrustLevel.TRUSTED
            told.trusting += trusted
        alarms = monitor_of().alarms
        if alarms and (newest is None or alarms[-1].flagged > newest):
            newest = alarms[-1].flagged
            told.alarms.append(alarms[-1])
        elif alarms:
            told.alarms[-1] = alarms[-1]
        told.in_alarm += bool(alarms) and alarms[-1].last is None
        told.trusted.append(trusted)
        told.samples += 1
    told.took = time.perf_counter() - began
    told.hours = told.samples * kind.period / kind.second / 3600.0
    return told


def _judge(
    plant: AbroadPlant, *, alone: bool
) -> tuple[Callable[[Sample], Iterator[TrustLevel]], Callable[[], Monitor]]:
    kind = plant.kind
    if not alone:
        twin = Twin(TwinSettings.of(kind.plant, period=kind.period, law=plant.gains))

        def judged(sample: Sample) -> Iterator[TrustLevel]:
            for verdict in twin.push(sample).verdicts:
                yield verdict.level

        return judged, lambda: twin.discriminator.monitor
    monitor = Monitor(HealthSettings.of(kind.plant, kind.period))
    refusals = Refusals(monitor.settings, ScheduleSettings.of(kind.plant, kind.period).gap)

    def watched(sample: Sample) -> Iterator[TrustLevel]:
        monitor.push(refusals.settle(sample))
        yield from ()

    return watched, lambda: monitor


class Order(NamedTuple):
    """One run to be made."""

    kind: str
    seed: int
    hours: float
    mishap: str
    alone: bool


def _lines(told: Watched, kind: str) -> Iterator[str]:
    for alarm in told.alarms:
        last = "on" if alarm.last is None else str(alarm.last)
        yield (
            f"  {kind} ({', '.join(told.lacks) or 'nothing'}) {alarm.first} {alarm.flagged} {last} "
            f"{alarm.fault.value}: {alarm.reason}"
        )


def _healthy(order: Order) -> Watched:
    kind = KINDS[order.kind]
    plant = AbroadPlant(kind, order.seed)
    size = round(order.hours * 3600.0 * kind.second / kind.period)
    return watch(plant, plant.run(size), alone=order.alone)


def _row(name: str, found: Sequence[Watched]) -> str:
    hours, samples = sum(w.hours for w in found), sum(w.samples for w in found)
    names = Counter(a.fault.value for w in found for a in w.alarms)
    alarms = ", ".join(f"{100 * n / hours:.0f} {name}" for name, n in names.most_common()) or "none"
    verdicts = sum(w.verdicts for w in found)
    trusting = f"{sum(w.trusting for w in found) / verdicts:5.0%}" if verdicts else "    –"
    return (
        f"{name:9s} {hours:6.1f} {samples / 3600:6.1f} | {100 * sum(names.values()) / hours:5.0f} "
        f"{sum(bool(w.alarms) for w in found):3d}/{len(found):<3d} "
        f"{sum(w.in_alarm for w in found) / samples:5.0%} {trusting} {sum(w.took for w in found):5.0f} s | "
        f"{alarms}"
    )


def healthy(kinds: Sequence[str], plants: int, hours: float, options: argparse.Namespace) -> None:
    """Plants to which nothing happens."""
    orders = [Order(k, seed, hours, "", options.monitor) for k in kinds for seed in _seeds(plants, options)]
    print(
        "kind       hours, of 3600 samples | alarms in 100 h, plants with one, time in alarm, verdicts "
        "trusted, took | in 100 h by name"
    )
    found = dict(_each(_healthy, orders, options))
    for name in kinds:
        print(_row(name, [found[order] for order in orders if order.kind == name]), flush=True)
    whole = list(found.values())
    print(_row("all", whole), flush=True)
    lacks = Counter(lack for w in whole for lack in w.lacks)
    blamed = Counter(lack for w in whole for lack in w.lacks for _ in w.alarms)
    print("alarms a plant, by what its file lacks: ", end="")
    print(", ".join(f"{lack} {blamed[lack] / n:.1f} ({n})" for lack, n in lacks.most_common()))


def _seeds(plants: int, options: argparse.Namespace) -> range:
    return range(options.seed, options.seed + plants)


def _onset(order: Order) -> Mishap:
    """When it happens, in samples."""
    kind = KINDS[order.kind]
    a_second = kind.second / kind.period
    start = round((STARTS + int(np.random.default_rng(order.seed).integers(0, 300))) * a_second)
    return Mishap(order.mishap, start, start + round(LASTS * a_second))


def _faulty(order: Order) -> Watched:
    """One plant in two has something that its file lacks."""
    kind, mishap = KINDS[order.kind], _onset(order)
    plant = AbroadPlant(kind, order.seed, None if order.seed % 2 else (), (150.0, 400.0), closed=True)
    size = mishap.stop + round(AFTER * kind.second / kind.period)
    return watch(plant, plant.run(size, mishap), alone=order.alone)


def right_name(mishap: str) -> str:
    """What it is to be called."""
    return next(name for begin, name in RIGHT.items() if mishap.startswith(begin))


def _case(mishap: str, found: Sequence[tuple[Order, Watched]]) -> str:
    right, delays, names, later, before, held = right_name(mishap), [], Counter[str](), 0, 0, list[float]()
    blind = seen = other = 0
    for order, told in found:
        kind, when = KINDS[order.kind], _onset(order)
        a_sample = kind.period / kind.second
        during = [a for a in told.alarms if when.start <= a.flagged < when.stop]
        before += sum(a.flagged < when.start for a in told.alarms)
        sharp = [a for a in during if a.fault.value != VAGUE] or during
        name = sharp[0].fault.value if sharp else "nothing"
        names[name] += 1
        if name == right:
            delays.append((sharp[0].flagged - when.start) * a_sample)
        other += sum(a.fault.value not in {right, VAGUE} for a in during)
        held += [
            (a.last - when.stop) * a_sample
            for a in told.alarms
            if a.flagged < when.stop and a.last is not None and a.last > when.stop
        ]
        later += sum(a.flagged >= when.stop and a.fault.value != right for a in told.alarms)
        part = told.trusted[when.start + round(BLINK / a_sample) : when.stop]
        blind, seen = blind + sum(part), seen + len(part)
    number = len(found)
    told_right, none = names[right], names["nothing"] + names[VAGUE]
    spread = f"{np.median(delays):6.0f} {max(delays):5.0f}" if delays else "     –     –"
    trusted = f"{blind / seen:4.0%}" if seen else "   –"
    over = f"{max(held):5.0f}" if held else "    –"
    words = ", ".join(f"{n} {name}" for name, n in names.most_common())
    return (
        f"{mishap:13s} {told_right:5d} {number - told_right - none:5d} {none:4d} {other:5d} | {spread} | "
        f"{trusted:>7s} | {over} | {before:6d} {later:5d} | {words}"
    )


def faults(kinds: Sequence[str], plants: int, options: argparse.Namespace) -> None:
    """Plants to which something happens, in the loop."""
    chosen = options.only or MISHAPS
    for name in kinds:
        orders = [
            Order(name, seed, 0.0, mishap, options.monitor)
            for mishap in chosen
            for seed in _seeds(plants, options)
        ]
        found = list(_each(_faulty, orders, options))
        print(f"\n{name}: {plants} plants each; times in seconds of the kind")
        print("mishap        right wrong none other | median worst | trusted | held | before after | first")
        for mishap in chosen:
            print(_case(mishap, [(o, w) for o, w in found if o.mishap == mishap]), flush=True)


def _each(
    call: Callable[[Order], Watched], orders: Sequence[Order], options: argparse.Namespace
) -> Iterator[tuple[Order, Watched]]:
    """Orders in sequence with their results; progress goes to standard error."""
    with get_context("spawn").Pool(options.jobs) if options.jobs > 1 else _Here() as pool:
        for done, (order, told) in enumerate(zip(orders, pool.imap(call, orders), strict=True), 1):
            what = f"{order.kind} {order.seed} {order.mishap}".rstrip()
            news = f"[{done}/{len(orders)}] {what}: {len(told.alarms)} alarms, {told.took:.0f} s"
            print(news, file=sys.stderr)
            if options.verbose:
                print(*_lines(told, what), sep="\n", end="\n" if told.alarms else "", flush=True)
            yield order, told


class _Here:
    """The same in this process."""

    def __enter__(self) -> _Here:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to end."""

    def imap(self, call: Callable[[Order], Watched], orders: Sequence[Order]) -> Iterator[Watched]:
        return map(call, orders)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.abroad", description=__doc__)
    parser.add_argument("what", choices=["healthy", "faults"])
    parser.add_argument("plants", type=int)
    parser.add_argument("hours", type=float, nargs="?", default=1.0)
    parser.add_argument("--kind", choices=list(KINDS), action="append", help="default: all")
    parser.add_argument("--only", choices=MISHAPS, action="append", help="mishaps; default: all")
    parser.add_argument("--monitor", action="store_true", help="the health monitor alone, without a twin")
    parser.add_argument("--seed", type=int, default=0, help="that of the first plant")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--verbose", action="store_true", help="a line for each alarm")
    options = parser.parse_args()
    kinds = options.kind or list(KINDS)
    if options.what == "healthy":
        healthy(kinds, options.plants, options.hours, options)
    else:
        faults(kinds, options.plants, options)


if __name__ == "__main__":
    main()
