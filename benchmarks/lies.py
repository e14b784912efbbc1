"""How hot a plant gets when its sensor lies: the figures of docs/safety.md.

    python -m benchmarks.lies rig 8
    python -m benchmarks.lies kit 8
    python -m benchmarks.lies both 4
    python -m benchmarks.lies slow 20
    python -m benchmarks.lies healthy 1000

The numbers are those of plants for each lie and set-point, with parameters that differ by up to 25 %, or of
healthy hours. Slow lies are those that no reading contradicts for minutes.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from tests.support.faulty_rig import profile
from tests.support.liar import (
    BEGINS,
    KIT,
    LIES,
    RIG,
    SLOW_LIES,
    Bench,
    Ending,
    lie_to,
    lie_to_both,
    whole_kit,
)
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.safety import BudgetLimits, OutputGuard

LEVELS = {"rig": (RIG, (30.0, 60.0, 90.0)), "kit": (KIT, (30.0, 50.0, 65.0))}
LASTS = 900
"""Longest lie, s."""


def without(bench: Bench) -> OutputGuard:
    """A guard that knows neither budget nor observer."""
    return OutputGuard(replace(bench.bridge.LIMITS, budget=BudgetLimits(hold=255.0, least=1e6)))


def shown(endings: list[Ending]) -> str:
    after = [ending.after for ending in endings if ending.after is not None]
    never = len(endings) - len(after)
    times = f"{min(after):4d} to {max(after):4d}" if after else "           "
    kinds = sorted({ending.fault.kind.value for ending in endings if ending.fault is not None})
    missed = f", {never} not" if never else ""
    return f"{max(ending.highest for ending in endings):6.1f} {times} {', '.join(kinds)}{missed}"


def measure(name: str, plants: int) -> None:
    bench, levels = LEVELS[name]
    print(f"{name}: highest temperature of {plants} plants, °C; seconds to zero; by what\n")
    for level in levels:
        for lie, told in LIES.items():
            cases = [
                [
                    lie_to(bench, guard, bench.plant(seed), [level] * (BEGINS + LASTS), told, seed=seed)
                    for seed in range(plants)
                    for guard in [make(bench)]
                ]
                for make in (without, Bench.guard)
            ]
            before, after = map(shown, cases)
            print(f"{level:3.0f} {lie:26s} | {before:42s} | {after}", flush=True)


def both(plants: int) -> None:
    """Kits whose heaters are both driven: a lie of either sensor, and healthy hours of ten steps each."""
    print(
        f"{plants} kits, sensor 1 or 2 lies: highest temperature of each heater, °C; seconds to zero; by what"
    )
    for levels in ((30.0, 30.0), (50.0, 35.0), (60.0, 40.0)):
        references = np.tile(levels, (BEGINS + LASTS, 1))
        for lie, told in LIES.items():
            for channel in (0, 1):
                runs = [
                    lie_to_both(whole_kit(seed), references, told, channel, seed) for seed in range(plants)
                ]
                heaters = " | ".join(f"{shown(list(each)):42s}" for each in zip(*runs, strict=True))
                print(f"{levels} {lie:26s} of {channel + 1} | {heaters}", flush=True)
    latched = limited = 0
    for seed in range(10 * plants):
        kit, random = whole_kit(1000 + seed), np.random.default_rng(seed)
        tops = [simulate_driven(kit, np.tile(u, (1500, 1)), states=begin(kit, [25.0, 25.0])).outputs[-1, k]
                for k, u in enumerate(((90.0, 0.0), (0.0, 90.0)))]  # fmt: skip
        high = np.minimum(tops, 70.0)
        steps = np.repeat(random.uniform(25.0, high, (10, 2)), 360, axis=0)
        endings = lie_to_both(kit, steps, seed=seed)
        limited += max(int(ending.limited) for ending in endings)
        if endings[0].fault is not None:
            latched += 1
            print(f"hour {seed}: {endings[0].fault}", flush=True)
    print(f"{latched} of {10 * plants} healthy hours latched a fault; seconds limited: {limited}")


def slow(plants: int) -> None:
    """How hot the rig gets; how many plants pass max(set-point + 15, 60) °C, how many are limited."""
    print(f"{plants} plants: beyond the goal, limited; highest temperature, °C; seconds to zero; by what")
    for name, (told, lasts, begins) in SLOW_LIES.items():
        for level in LEVELS["rig"][1]:
            references = [level] * (begins + lasts)
            endings = [
                lie_to(RIG, RIG.guard(), RIG.plant(seed), references, told, seed=seed, begins=begins)
                for seed in range(plants)
            ]
            beyond = sum(ending.highest > max(level + 15.0, 60.0) for ending in endings)
            limited = sum(ending.limited > 0 for ending in endings)
            counts = f"{beyond} beyond, {limited:2d} limited"
            print(f"{level:3.0f} {name:28s} | {counts} | {shown(endings)}", flush=True)


def healthy(hours: int) -> None:
    """Rig and kit in turn; set-points that each of them reaches."""
    latched, limited = 0, {"rig": 0, "kit": 0}
    for seed in range(hours):
        name = ("rig", "kit")[seed % 2]
        bench, _ = LEVELS[name]
        references = np.clip(profile(seed, 3600), *((20.0, 100.0) if bench is RIG else (25.0, 60.0)))
        plant = bench.plant(10_000 + seed)
        plant = plant.replace(ambient=np.random.default_rng(seed).uniform(288.15, 303.15))
        ending = lie_to(bench, bench.guard(), plant, references.tolist(), seed=seed)
        limited[name] += int(ending.limited)
        if ending.fault is not None:
            latched += 1
            print(f"hour {seed}: {ending.fault}", flush=True)
        elif ending.limited:
            print(f"hour {seed}, {name}: limited for {ending.limited} s", flush=True)
    print(f"{latched} of {hours} healthy hours latched a fault; seconds limited: {limited}")


def main() -> None:
    what, number = sys.argv[1], int(sys.argv[2])
    if what == "healthy":
        healthy(number)
    elif what == "slow":
        slow(number)
    elif what == "both":
        both(number)
    else:
        measure(what, number)


if __name__ == "__main__":
    main()
