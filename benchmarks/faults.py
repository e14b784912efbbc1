"""How soon a broken plant is reported, and as what: the figures of docs on health, the incubator and the kit.

    python -m benchmarks.faults rig 30 100
    python -m benchmarks.faults incubator 40
    python -m benchmarks.faults kit 20 100

The numbers are those of runs of each case, and of healthy hours.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tests.support import faulty_incubator as incubators
from tests.support import faulty_kit as kits
from tests.support import faulty_rig as rigs
from twinmatch.health import Alarm, Fault, HealthState
from twinmatch.signals import FloatArray, Sample

IN_TIME = 300
"""Samples within which a slow change is to be reported."""
SLOW_KINDS = (
    "fan-failed", "draught", "room+10", "room-10", "supply*0.8", "supply*0.6", "supply~0.6", "reading+3",
    "reading~6",
)  # fmt: skip
"""Changes that leave a plant that obeys; `~` comes slowly."""
RIGHT = {
    "fan": "losses-changed",
    "draught": "losses-changed",
    "room": "room-changed",
    "supply": "drive-weak",
    "reading": "sensor-drift",
}
"""The name of a change by how its kind begins."""


def visible_after(
    start: int,
    samples: list[Sample],
    whole: list[Sample],
    truth: FloatArray,
    other: FloatArray,
) -> int | None:
    """Samples from the break until plate or reading are 1 °C (15 times the noise) from what they would be."""
    away = np.abs(truth - other)
    away = np.maximum(
        away, [abs(a.output - b.output) for a, b in zip(samples, whole, strict=True)]
    )
    found = np.flatnonzero(away[start:] > 1.0)
    return int(found[0]) if found.size else None


def measure(kind: str, length: int, runs: int) -> str:
    names: Counter[str] = Counter()
    onset = []
    seen = []
    cleared = 0
    early = 0
    for seed in range(runs):
        start = int(np.random.default_rng(seed).integers(500, 900))
        reference = rigs.profile(
            seed + 1000, 1500 if kind[:4] in ("driv", "supp", "sens", "read") else 2700
        )
        rig = rigs.some_rig(seed)
        samples, truth = rigs.run(
            reference, rigs.Break(kind, start, length), rig=rig, seed=seed
        )
        whole, other = rigs.run(reference, rig=rig, seed=seed)
        monitor, healths = rigs.watch(samples)
        alarms = [a for a in monitor.alarms if a.flagged >= start]
        early += len(monitor.alarms) - len(alarms)
        after = visible_after(start, samples, whole, truth, other)
        if alarms:
            names[alarms[0].fault.value] += 1
            onset.append(alarms[0].flagged - start)
            if after is not None:
                seen.append(onset[-1] - after)
            cleared += alarms[-1].last is not None
        elif any(h.state is HealthState.SUSPECT and h.index > start for h in healths):
            names["only suspected"] += 1
        else:
            names["not seen" if after is not None else "never visible"] += 1
    delays = f"{np.median(onset):4.0f} {max(onset):4d}" if onset else "   –    –"
    since = f"{np.median(seen):4.0f} {max(seen):4d}" if seen else "   –    –"
    told = ", ".join(f"{n} {name}" for name, n in names.most_common())
    lasts = str(length) if length < 10_000 else "stays"
    return (
        f"{kind:15s} {lasts:>6s} | {delays} | {since} | {cleared:3d} | {early} | {told}"
    )


def confusion(runs: int, kinds: tuple[str, ...] = SLOW_KINDS) -> list[str]:
    """What is reported for every kind of change: rows are what is broken, columns what it was called."""
    lines = [
        f"{'changed':12s} right in {IN_TIME} s | median, worst | reported (of {runs} runs)"
    ]
    for kind in kinds:
        told = [rigs.names_told(kind, seed) for seed in range(runs)]
        names = Counter(name for name, _ in told)
        delays = sorted(d for _, d in told if d is not None)
        right = {RIGHT[part] for part in RIGHT if kind.startswith(part)}
        in_time = sum(
            name in right and d is not None and d <= IN_TIME for name, d in told
        )
        spread = (
            f"{np.median(delays):5.0f} {delays[-1]:7d}" if delays else "    –       –"
        )
        words = ", ".join(f"{n} {name}" for name, n in names.most_common())
        lines.append(f"{kind:12s} {in_time:14d} | {spread} | {words}")
    return lines


def false_alarms(hours: int) -> str:
    alarms = 0
    suspects = 0
    for seed in range(hours):
        samples, _ = rigs.run(
            rigs.profile(seed + 5000, 3600), rig=rigs.some_rig(seed + 5000), seed=seed
        )
        monitor, healths = rigs.watch(samples)
        alarms += len(monitor.alarms)
        suspects += sum(h.state is HealthState.SUSPECT for h in healths)
    return f"{hours} healthy hours: {alarms} alarms, {suspects} samples suspect"


def rig(runs: int = 40, hours: int = 100) -> None:
    """The Peltier rig, broken in many ways."""
    print(
        "broken          length | onset med max | visible med max | cleared | before | reported"
    )
    cases = [("drive-lost", n) for n in (10, 20, 60, 1_000_000)]
    cases += [
        (kind, n) for kind in ("supply*0.5", "supply*0.6") for n in (60, 1_000_000)
    ]
    cases += [("sensor-frozen", n) for n in (12, 30, 1_000_000)]
    cases += [
        (kind, n) for kind in ("sensor-off", "reading-offset") for n in (20, 1_000_000)
    ]
    for case in cases:
        print(measure(*case, runs), flush=True)
    print(*confusion(runs), sep="\n", flush=True)
    print(false_alarms(hours))


def _opened(seed: int, minutes: float) -> tuple[incubators.Lid, tuple[Alarm, ...]]:
    random = np.random.default_rng(seed + 100)
    opened = int(random.integers(250, 500))
    lid = incubators.Lid(
        opened,
        opened + round(60 * minutes / incubators.PERIOD),
        random.uniform(3.0, 10.0),
    )
    return lid, incubators.watch(
        incubators.run(incubators.some_incubator(seed), seed, 900, lid)
    )


def _measure(runs: int, minutes: float) -> str:
    told = []
    early = 0
    other = Counter[str]()
    closed: list[float] = []
    for seed in range(runs):
        lid, alarms = _opened(seed, minutes)
        early += any(a.flagged < lid.opened for a in alarms)
        found = [
            a
            for a in alarms
            if a.fault is Fault.LOSSES_CHANGED and a.flagged >= lid.opened
        ]
        other.update(a.fault.value for a in alarms if a not in found[:1])
        if not found:
            continue
        told.append((found[0].flagged - lid.opened) * incubators.PERIOD)
        if found[0].last is not None:
            closed.append((found[0].last + 1 - lid.closed) * incubators.PERIOD)
    delays = f"{np.median(told):.0f}, {max(told):.0f} s" if told else "–"
    ends = f"{np.median(closed):.0f}, {max(closed):.0f} s" if closed else "–"
    rest = ", ".join(f"{n} {name}" for name, n in other.most_common()) or "nothing"
    return (
        f"open for {minutes:g} min: {len(told)} of {runs} reported, {delays}; "
        f"over after {ends}; {early} before; else {rest}"
    )


def incubator(runs: int = 40) -> None:
    """Simulated incubators whose lid is opened."""
    for minutes in (1.0, 3.0):
        print(_measure(runs, minutes), flush=True)
    healthy = (
        incubators.watch(
            incubators.run(incubators.some_incubator(seed + 500), seed, 1200)
        )
        for seed in range(runs)
    )
    alarms = Counter(a.fault.value for found in healthy for a in found)
    print(f"{runs} healthy hours: {dict(alarms) or 'no alarm'}")


def _kits(
    runs: int,
) -> Iterator[tuple[int, kits.Simulated | kits.Published, FloatArray]]:
    """Kits of both kinds in turn, half of the published ones with a second heater that is switched."""
    for seed in range(runs):
        kit = kits.Published(seed) if seed % 2 else kits.Simulated(seed)
        second = (
            kits.some_levels(seed + 1, 3600, 0.0, 60.0, 900)
            if seed % 4 == 3
            else np.zeros(3600)
        )
        yield seed, kit, second


def _told(lost: int, alarms: tuple[Alarm, ...]) -> tuple[int | None, str]:
    """Time to `drive-lost`, s, and the first name."""
    after = [a for a in alarms if a.flagged >= lost]
    found = next((a.flagged - lost for a in after if a.fault is Fault.DRIVE_LOST), None)
    return found, after[0].fault.value if after else "nothing"


def _row(found: Sequence[tuple[int | None, str]]) -> str:
    times = [t for t, _ in found if t is not None]
    soon = sum(t <= 30 for t in times)
    seen = f"median {np.median(times):.0f}, worst {max(times)} s" if times else "–"
    first = dict(Counter(name for _, name in found))
    return f"{len(times)} of {len(found)} drive-lost, {seen}, {soon} within 30 s; first {first}"


def _by_power(runs: int) -> None:
    for power in (5, 10, 20, 30, 50, 80):
        found = []
        for seed in range(runs):
            lost = 1000 + 37 * seed
            alarms = kits.watch(
                kits.run(
                    kits.Simulated(seed),
                    kits.hold(power, lost + 240),
                    kits.Broken(lost=lost),
                )
            )
            found.append(_told(lost, alarms))
        print(f"at rest at {power} %: {_row(found)}", flush=True)


def _at_some_moment(
    runs: int, make: Callable[[int], kits.Simulated | kits.Published], name: str
) -> None:
    found = []
    early = 0
    for seed in range(runs):
        lost = int(np.random.default_rng(seed).integers(60, 2400))
        alarms = kits.watch(
            kits.run(make(seed), kits.levels(lost + 240), kits.Broken(lost=lost))
        )
        early += any(a.flagged < lost for a in alarms)
        found.append(_told(lost, alarms))
    print(f"{name}, at some moment: {_row(found)}; {early} before", flush=True)


def _draughts(runs: int) -> None:
    for factor in (1.5, 2.0, 3.0):
        names: Counter[str] = Counter()
        for seed in range(runs):
            kit: kits.Simulated | kits.Published = (
                kits.Published(seed) if seed % 2 else kits.Simulated(seed)
            )
            alarms = kits.watch(
                kits.run(
                    kit, kits.levels(1800), kits.Broken(draught=1250, losses=factor)
                )
            )
            names.update(
                [
                    ", ".join(a.fault.value for a in alarms if a.flagged >= 1250)
                    or "nothing"
                ]
            )
        print(
            f"losses times {factor:g} from one second to the next: {dict(names)}",
            flush=True,
        )


def _healthy(hours: int) -> None:
    told = Counter(
        a.fault.value
        for seed, kit, second in _kits(hours)
        for a in kits.watch(
            kits.run(kit, kits.some_levels(seed, 3600, 26.0, 65.0, 700), second=second)
        )
    )
    print(f"{hours} healthy hours: {dict(told) or 'no alarm'}", flush=True)


def kit(runs: int = 20, hours: int = 100) -> None:
    """Temperature Control Labs whose heater is lost, and healthy ones."""
    _by_power(runs)
    _at_some_moment(runs, kits.Simulated, "model of the package")
    _at_some_moment(runs, kits.Published, "published balance")
    _draughts(runs)
    _healthy(hours)


if __name__ == "__main__":
    {"rig": rig, "incubator": incubator, "kit": kit}[sys.argv[1]](
        *map(int, sys.argv[2:])
    )
