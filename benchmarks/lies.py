"""How hot a plant gets when its sensor lies: the figures of docs/safety.md.

    python -m benchmarks.lies rig 8
    python -m benchmarks.lies kit 8
    python -m benchmarks.lies both 4
    python -m benchmarks.lies slow 20
    python -m benchmarks.lies all 500 --seed 0 --spread 0.25 --json lies.json
    python -m benchmarks.lies healthy 99

The numbers are those of plants for each lie and set-point, with parameters that differ by up to 25 %, of lies
drawn from seeds, or of healthy hours. Slow lies are those that no reading contradicts for minutes. Drawn lies
come with every course of the set-point and in rooms that change; healthy hours likewise.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

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
from tests.support.lie_generator import (
    HEALTHY_LASTS,
    HOUR,
    LieOutcome,
    LieRun,
    draw_healthy,
    draw_lie,
    follow,
)
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.safety import BudgetLimits, OutputGuard

LEVELS = {"rig": (RIG, (30.0, 60.0, 90.0)), "kit": (KIT, (30.0, 50.0, 65.0))}
LASTS = 900
"""Longest lie, s."""


def without(bench: Bench) -> OutputGuard:
    """A guard that knows neither budget nor observer."""
    return OutputGuard(
        replace(bench.bridge.LIMITS, budget=BudgetLimits(hold=255.0, least=1e6))
    )


def shown(endings: list[Ending]) -> str:
    after = [ending.after for ending in endings if ending.after is not None]
    never = len(endings) - len(after)
    times = f"{min(after):4d} to {max(after):4d}" if after else "           "
    kinds = sorted(
        {ending.fault.kind.value for ending in endings if ending.fault is not None}
    )
    missed = f", {never} not" if never else ""
    return f"{max(ending.highest for ending in endings):6.1f} {times} {', '.join(kinds)}{missed}"


def measure(name: str, plants: int) -> None:
    bench, levels = LEVELS[name]
    print(
        f"{name}: highest temperature of {plants} plants, °C; seconds to zero; by what\n"
    )
    for level in levels:
        for lie, told in LIES.items():
            cases = [
                [
                    lie_to(
                        bench,
                        guard,
                        bench.plant(seed),
                        [level] * (BEGINS + LASTS),
                        told,
                        seed=seed,
                    )
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
                    lie_to_both(whole_kit(seed), references, told, channel, seed)
                    for seed in range(plants)
                ]
                heaters = " | ".join(
                    f"{shown(list(each)):42s}" for each in zip(*runs, strict=True)
                )
                print(f"{levels} {lie:26s} of {channel + 1} | {heaters}", flush=True)
    latched = limited = 0
    for seed in range(10 * plants):
        kit = whole_kit(1000 + seed)
        random = np.random.default_rng(seed)
        tops = [simulate_driven(kit, np.tile(u, (1500, 1)), states=begin(kit, [25.0, 25.0])).outputs[-1, k]
                for k, u in enumerate(((90.0, 0.0), (0.0, 90.0)))]  # fmt: skip
        high = np.minimum(tops, 70.0)
        steps = np.repeat(random.uniform(25.0, high, (10, 2)), 360, axis=0)
        endings = lie_to_both(kit, steps, seed=seed)
        limited += max(int(ending.limited) for ending in endings)
        if endings[0].fault is not None:
            latched += 1
            print(f"hour {seed}: {endings[0].fault}", flush=True)
    print(
        f"{latched} of {10 * plants} healthy hours latched a fault; seconds limited: {limited}"
    )


def slow(plants: int) -> None:
    """How hot the rig gets; how many plants pass max(set-point + 15, 60) °C, how many are limited."""
    print(
        f"{plants} plants: beyond the goal, limited; highest temperature, °C; seconds to zero; by what"
    )
    for name, (told, lasts, begins) in SLOW_LIES.items():
        for level in LEVELS["rig"][1]:
            references = [level] * (begins + lasts)
            endings = [
                lie_to(
                    RIG,
                    RIG.guard(),
                    RIG.plant(seed),
                    references,
                    told,
                    seed=seed,
                    begins=begins,
                )
                for seed in range(plants)
            ]
            beyond = sum(ending.highest > max(level + 15.0, 60.0) for ending in endings)
            limited = sum(ending.limited > 0 for ending in endings)
            counts = f"{beyond} beyond, {limited:2d} limited"
            print(f"{level:3.0f} {name:28s} | {counts} | {shown(endings)}", flush=True)


def row(run: LieRun, outcome: LieOutcome) -> dict[str, Any]:
    """One run as it is written."""
    return {
        "seed": run.seed,
        "kind": run.kind,
        "set_points": run.set_points,
        "room": run.surroundings.name,
        "lie": run.lie_name,
        "begins": run.begins,
        "channels": run.channels,
        "restarts": run.restarts,
        "apart": run.apart,
        **vars(outcome),
    }


def drawn(
    draw: Callable[[int, float], LieRun], seeds: Iterable[int], spread: float
) -> list[dict[str, Any]]:
    """The rows of the runs of these seeds."""
    rows = []
    for seed in seeds:
        run = draw(seed, spread)
        outcome = follow(run)
        rows.append(row(run, outcome))
        if outcome.beyond > 0.0 or (
            run.lie is None and (outcome.limited or outcome.fault)
        ):
            print(json.dumps(rows[-1], ensure_ascii=False), flush=True)
    return rows


def beyond(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """How many of these runs got hotter than is allowed, and by how much at the most, °C."""
    above = [row["beyond"] for row in rows if row["beyond"] > 0.0]
    return {"runs": len(rows), "beyond": len(above), "worst": max(above, default=0.0)}


def all_lies(number: int, seed: int, spread: float) -> Mapping[str, Any]:
    """Lies of every kind, with every course of the set-point."""
    rows = drawn(draw_lie, range(seed, seed + number), spread)
    summary = {
        "all": beyond(rows),
        "can be told from a room": beyond([row for row in rows if row["apart"]]),
        **{
            f"{key} {value}": beyond([row for row in rows if row[key] == value])
            for key in ("kind", "set_points", "room")
            for value in sorted({row[key] for row in rows})
        },
    }
    return {"spread": spread, "summary": summary, "runs": rows}


def healthy(hours: int, seed: int, spread: float) -> Mapping[str, Any]:
    """Healthy runs of three hours: seconds limited in an hour, and faults, for each kind of room."""
    rows = drawn(
        draw_healthy, range(seed, seed + max(1, hours * HOUR // HEALTHY_LASTS)), spread
    )
    summary = {}
    for room in ("", *sorted({row["room"] for row in rows})):
        chosen = [row for row in rows if room in {"", row["room"]}]
        lasted = sum(row["seconds"] for row in chosen) / HOUR
        limited = sum(row["limited"] for row in chosen)
        faults = sum(bool(row["fault"]) for row in chosen)
        summary[room or "all"] = {
            "hours": lasted,
            "limited per hour": limited / lasted,
            "faults": faults,
        }
    return {"spread": spread, "summary": summary, "runs": rows}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=(*LEVELS, "both", "slow", "all", "healthy"))
    parser.add_argument("number", type=int)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument(
        "--spread", type=float, default=0.25, help="by how much parameters differ"
    )
    parser.add_argument("--json", type=Path, help="where every run is written")
    asked = parser.parse_args()
    if asked.what == "slow":
        slow(asked.number)
    elif asked.what == "both":
        both(asked.number)
    elif asked.what in LEVELS:
        measure(asked.what, asked.number)
    else:
        draw = all_lies if asked.what == "all" else healthy
        result = draw(asked.number, asked.seed, asked.spread)
        print(json.dumps(result["summary"], indent=2, ensure_ascii=False))
        if asked.json is not None:
            asked.json.write_text(
                json.dumps(result, indent=1, ensure_ascii=False), encoding="utf-8"
            )


if __name__ == "__main__":
    main()
