"""What has changed on simulated rigs, and a memory of a thousand sessions.

python -m benchmarks.memory
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.common import Row, main, measure_side_by_side, rows_of
from tests.support.lessons import KINDS, lesson, lived_rig, told_of
from twinmatch.memory import Memory


def run(quick: bool) -> list[Row]:
    """One hundred rigs of each kind, twelve sessions each."""
    rigs, sessions = (3, 20) if quick else (100, 1000)
    with tempfile.TemporaryDirectory() as folder:
        memory = Memory(Path(folder) / "rig.sqlite")
        memory.add(
            [
                lesson(n, name)
                for n in range(sessions)
                for name in ("paper", "rich", "other")
            ]
        )
        timings = measure_side_by_side({"twinmatch": memory.lessons})
        rows = rows_of(
            "memory", f"load {sessions} sessions", timings, targets={"twinmatch": 0.2}
        )
    return [*rows, *(_told(kind, rigs) for kind in KINDS)]


def _told(kind: str, rigs: int) -> Row:
    """How soon the changes of such rigs are named, and how often something that has not changed."""
    start = time.perf_counter()
    lived = [lived_rig(seed, kind) for seed in range(rigs)]
    told = [told_of(rig) for rig in lived]
    looks = sum(one.looks for one in told)
    seconds = (time.perf_counter() - start) / looks
    said = f"false names after {sum(one.false for one in told)} of {looks} sessions"
    named = [
        (rig, one)
        for rig, one in zip(lived, told, strict=True)
        if one.first is not None
    ]
    if kind == "step":
        soon = sum((one.first or 0) - rig.since <= 2 for rig, one in named)
        size = np.median([abs(abs(one.size) - 0.1) for _, one in named])
        said = f"{len(named)} named, {soon} within two sessions, size off by {100 * size:.1f} %; {said}"
    if kind == "drift":
        soon, called = (
            sum(of)
            for of in zip(
                *(((one.first or 0) <= 6, one.kind == "trend") for _, one in named),
                strict=True,
            )
        )
        said = f"{len(named)} named, {soon} by the sixth session, {called} as a trend at last; {said}"
    return Row("memory", f"{rigs} rigs, {kind}", "twinmatch", seconds, note=said)


if __name__ == "__main__":
    main(run, __doc__)
