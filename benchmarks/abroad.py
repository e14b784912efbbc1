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
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from tests.support.abroad import KINDS, MISHAPS, AbroadPlant, Mishap
from twinmatch.comparing import TrustLevel
from twinmatch.health import Alarm, HealthSettings, Monitor, Refusals
from twinmatch.health.channels import ChannelMonitor
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
STARTS = 1500
LASTS = 900
AFTER = 600
"""When a mishap comes at the earliest, how long it lasts, what is watched after it: seconds of the kind."""
BLINK = 120
"""Seconds of the kind for which a sensor that lies may still be trusted."""


@dataclass
class Watched:
    """What was said of one run."""

    mishap: str
    lacks: tuple[str, ...]
    alarms: list[Alarm] = field(default_factory=list)
    standing: list[str] = field(default_factory=list)
    """What was known of the twin before each of them."""
    in_alarm: int = 0
    """Samples."""
    trusted: list[bool] = field(default_factory=list)
    """For every sample, whether the newest verdict trusts the leader."""
    verdicts: int = 0
    trusting: int = 0
    """Verdicts that trust the leader."""
    took: float = 0.0
    """Seconds."""
    broke: str = ""
    """The error that ended the run, if one did."""


class Watcher:
    """Judges samples as `replay` does with default settings, or by the monitor alone."""

    def __init__(self, plant: AbroadPlant, *, alone: bool) -> None:
        kind = plant.kind
        self.told = Watched("", plant.lacks or ())
        self._trusted = False
        if alone:
            settings = HealthSettings.of(kind.plant, kind.period)
            self._monitor: Monitor | ChannelMonitor = Monitor(settings)
            refusals = Refusals(
                settings, ScheduleSettings.of(kind.plant, kind.period).gap
            )
            self._twin = None
            self._settle = refusals.settle
        else:
            self._twin = Twin(
                TwinSettings.of(kind.plant, period=kind.period, law=plant.gains)
            )
            self._monitor = self._twin.discriminator.monitor

    def take(self, samples: Iterable[Sample]) -> Watched:
        """Judge these samples, too."""
        began = time.perf_counter()
        for sample in samples:
            try:
                self._push(sample)
            except Exception as error:  # what ends one run is counted
                self.told.broke = (
                    f"sample {sample.index}: {type(error).__name__}: {error}"
                )
                break
        self.told.took += time.perf_counter() - began
        return self.told

    @property
    def _standing(self) -> str:
        if self._twin is None:
            return "alone"
        unmatched = self._twin.discriminator.nominal is None
        return "trusted" if self._trusted else "no twin" if unmatched else "not trusted"

    def _push(self, sample: Sample) -> None:
        told = self.told
        standing = self._standing
        if self._twin is None:
            self._monitor.push(self._settle(sample))
        else:
            for verdict in self._twin.push(sample).verdicts:
                self._trusted = verdict.level is TrustLevel.TRUSTED
                told.verdicts += 1
                told.trusting += self._trusted
        alarms = self._monitor.alarms
        if alarms and (not told.alarms or alarms[-1].flagged > told.alarms[-1].flagged):
            told.alarms.append(alarms[-1])
            told.standing.append(standing)
        elif alarms:
            told.alarms[-1] = alarms[-1]
        told.in_alarm += bool(alarms) and alarms[-1].last is None
        told.trusted.append(self._trusted)


class Order(NamedTuple):
    """Runs of one plant to be made."""

    kind: str
    seed: int
    hours: float
    mishaps: tuple[str, ...]
    alone: bool

    @property
    def samples_per_second(self) -> float:
        """Samples in a second of the kind."""
        return KINDS[self.kind].second / KINDS[self.kind].period

    def onset(self, mishap: str) -> Mishap:
        """When it happens, in samples; the same for all mishaps of a plant."""
        start = STARTS + int(np.random.default_rng(self.seed).integers(0, 300))
        share = self.samples_per_second
        return Mishap(
            mishap, round(start * share), round(start * share) + round(LASTS * share)
        )


def _lines(told: Watched, kind: str) -> Iterator[str]:
    if told.broke:
        yield f"  {kind} ({', '.join(told.lacks) or 'nothing'}) ended by an error at {told.broke}"
    for alarm, standing in zip(told.alarms, told.standing, strict=True):
        last = "on" if alarm.last is None else str(alarm.last)
        yield (
            f"  {kind} ({', '.join(told.lacks) or 'nothing'}) {alarm.first} {alarm.flagged} {last} "
            f"[{standing}] {alarm.fault.value}: {alarm.reason}"
        )


def _healthy(order: Order) -> list[Watched]:
    plant = AbroadPlant(KINDS[order.kind], order.seed)
    size = round(order.hours * 3600.0 * order.samples_per_second)
    return [Watcher(plant, alone=order.alone).take(plant.run(size))]


def _row(name: str, found: Sequence[tuple[Order, Watched]]) -> str:
    watched = [w for _, w in found]
    hours = sum(order.hours for order, _ in found)
    samples = sum(len(w.trusted) for w in watched)
    names = Counter(a.fault.value for w in watched for a in w.alarms)
    alarms = (
        ", ".join(f"{100 * n / hours:.0f} {fault}" for fault, n in names.most_common())
        or "none"
    )
    verdicts = sum(w.verdicts for w in watched)
    trusting = (
        f"{sum(w.trusting for w in watched) / verdicts:5.0%}" if verdicts else "    –"
    )
    return (
        f"{name:10s} {hours:6.1f} {samples / 3600:6.1f} | {100 * sum(names.values()) / hours:5.0f} "
        f"{sum(bool(w.alarms) for w in watched):3d}/{len(found):<3d} "
        f"{sum(w.in_alarm for w in watched) / samples:5.0%} {trusting} "
        f"{sum(w.took for w in watched):5.0f} s | {alarms}"
    )


def healthy(
    kinds: Sequence[str], plants: int, hours: float, options: argparse.Namespace
) -> None:
    """Plants to which nothing happens."""
    orders = [
        Order(k, seed, hours, (), options.monitor)
        for k in kinds
        for seed in _seeds(plants, options)
    ]
    print(
        "kind        hours, of 3600 samples | alarms in 100 h, plants with one, time in alarm, verdicts "
        "trusted, took | in 100 h by name"
    )
    found = [(order, told) for order, [told] in _each(_healthy, orders, options)]
    for name in kinds:
        print(
            _row(name, [(order, told) for order, told in found if order.kind == name]),
            flush=True,
        )
    print(_row("all", found), flush=True)
    _print_broken(found)
    stood = Counter(standing for _, w in found for standing in w.standing)
    print(
        "alarms by what was known of the twin:",
        ", ".join(f"{n} {word}" for word, n in stood.most_common()),
    )
    lacks = Counter(lack for _, w in found for lack in w.lacks)
    blamed = Counter(lack for _, w in found for lack in w.lacks for _ in w.alarms)
    print("alarms a plant, by what its file lacks: ", end="")
    print(
        ", ".join(
            f"{lack} {blamed[lack] / n:.1f} ({n})" for lack, n in lacks.most_common()
        )
    )


def _seeds(plants: int, options: argparse.Namespace) -> range:
    return range(options.seed, options.seed + plants)


def _faulty(order: Order) -> list[Watched]:
    """One plant in two has something that its file lacks. Until something happens, all runs are the same."""
    plant = AbroadPlant(
        KINDS[order.kind],
        order.seed,
        None if order.seed % 2 else (),
        (150.0, 400.0),
        closed=True,
    )
    watcher = Watcher(plant, alone=order.alone)
    when = order.onset("nothing")
    samples = plant.run(when.stop + round(AFTER * order.samples_per_second))
    watcher.take(islice(samples, when.start))

    def on(sender: Connection, mishap: str) -> None:
        watcher.told.mishap, watcher.told.took, plant.mishap = (
            mishap,
            0.0,
            order.onset(mishap),
        )
        sender.send(watcher.take(samples))

    found = list[Watched]()
    forking = get_context("fork")
    for mishap in order.mishaps:
        receiver, sender = forking.Pipe(duplex=False)
        process = forking.Process(target=on, args=(sender, mishap))
        process.start()
        sender.close()
        found.append(receiver.recv())
        process.join()
    return found


def right_name(mishap: str) -> str:
    """What it is to be called."""
    return next(name for begin, name in RIGHT.items() if mishap.startswith(begin))


def _case(mishap: str, found: Sequence[tuple[Order, Watched]]) -> str:
    right = right_name(mishap)
    delays = list[float]()
    names = Counter[str]()
    held = list[float]()
    before = later = other = blind = seen = 0
    for order, told in found:
        when = order.onset(mishap)
        seconds = 1.0 / order.samples_per_second
        during = [a for a in told.alarms if when.start <= a.flagged < when.stop]
        first = next(
            (a for a in during if a.fault.value != VAGUE), during[0] if during else None
        )
        names[first.fault.value if first else "nothing"] += 1
        if first and first.fault.value == right:
            delays.append((first.flagged - when.start) * seconds)
        other += sum(a.fault.value not in {right, VAGUE} for a in during)
        held += [
            (a.last - when.stop) * seconds
            for a in told.alarms
            if a.flagged < when.stop and a.last is not None and a.last > when.stop
        ]
        before += sum(a.flagged < when.start for a in told.alarms)
        later += sum(
            a.flagged >= when.stop and a.fault.value != right for a in told.alarms
        )
        part = told.trusted[when.start + round(BLINK / seconds) : when.stop]
        blind = blind + sum(part)
        seen = seen + len(part)
    none = names["nothing"] + names[VAGUE]
    spread = (
        f"{np.median(delays):6.0f} {max(delays):5.0f}" if delays else "     –     –"
    )
    words = ", ".join(f"{n} {name}" for name, n in names.most_common())
    over = f"{max(held):4.0f}" if held else "   –"
    return (
        f"{mishap:13s} {names[right]:5d} {len(found) - names[right] - none:5d} {none:4d} {other:5d} | "
        f"{spread} | {blind / max(seen, 1):7.0%} | {over} | {before:6d} {later:5d} | {words}"
    )


def faults(kinds: Sequence[str], plants: int, options: argparse.Namespace) -> None:
    """Plants to which something happens, in the loop."""
    chosen = tuple(options.only or MISHAPS)
    for name in kinds:
        orders = [
            Order(name, seed, 0.0, chosen, options.monitor)
            for seed in _seeds(plants, options)
        ]
        found = [
            (order, told)
            for order, each in _each(_faulty, orders, options)
            for told in each
        ]
        print(f"\n{name}: {plants} plants each; times in seconds of the kind")
        print(
            "mishap        right wrong none other | median worst | trusted | held | before after | first"
        )
        for mishap in chosen:
            print(
                _case(mishap, [(o, w) for o, w in found if w.mishap == mishap]),
                flush=True,
            )
        _print_broken(found)


def _print_broken(found: Sequence[tuple[Order, Watched]]) -> None:
    for order, told in found:
        if told.broke:
            what = f"{order.kind} {order.seed} {told.mishap}".rstrip()
            print(f"{what}: ended by an error at {told.broke}", flush=True)


def _each(
    call: Callable[[Order], list[Watched]],
    orders: Sequence[Order],
    options: argparse.Namespace,
) -> Iterator[tuple[Order, list[Watched]]]:
    """Orders in sequence with their results; progress goes to standard error."""
    pool = (
        ProcessPoolExecutor(options.jobs, get_context("spawn"))
        if options.jobs > 1
        else None
    )
    with pool or nullcontext():
        results = map(call, orders) if pool is None else pool.map(call, orders)
        for done, (order, found) in enumerate(zip(orders, results, strict=True), 1):
            took = sum(told.took for told in found)
            alarms = sum(len(told.alarms) for told in found)
            print(
                f"[{done}/{len(orders)}] {order.kind} {order.seed}: {alarms} alarms, {took:.0f} s",
                file=sys.stderr,
            )
            for told in found if options.verbose else ():
                what = f"{order.kind} {order.seed} {told.mishap}".rstrip()
                for line in _lines(told, what):
                    print(line, flush=True)
            yield order, found


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.abroad", description=__doc__
    )
    parser.add_argument("what", choices=["healthy", "faults"])
    parser.add_argument("plants", type=int)
    parser.add_argument("hours", type=float, nargs="?", default=1.0)
    parser.add_argument(
        "--kind", choices=list(KINDS), action="append", help="default: all"
    )
    parser.add_argument(
        "--only", choices=MISHAPS, action="append", help="mishaps; default: all"
    )
    parser.add_argument(
        "--monitor",
        action="store_true",
        help="the health monitor alone, without a twin",
    )
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
