"""Whether the ν-gap of a family ranks the differences between its twins, and their future errors.

    python benchmarks/twins_apart.py --recordings DIR

judges every recording of DIR (`.mat` or `.csv`, as `twinmatch import` does). The difference between two twins
of a family is that of their closed-loop responses to the hour's set-points: root mean square of the
differences of output and input in units of their noise. The error of a twin is that of its closed-loop
response over the 300 s after the verdict. The figures are rank correlations (Spearman) with these, of the
ν-gap between the plants and of that between identified models; over all pairs, and over all candidates of all
verdicts, then as the mean over the verdicts with four candidates or more.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.stats import spearmanr

from twinmatch.comparing import CandidateScore
from twinmatch.dynamics import Parameters, Response, simulate_window
from twinmatch.errors import TwinmatchError
from twinmatch.importing import open_any
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.plants import Peltier
from twinmatch.signals import FloatArray, Window

AHEAD = 300
"""Samples over which a twin's forecast is scored."""

Row = tuple[float, float, float]
"""ν-gap between plants, between models, and the quantity to rank."""


def size(y: FloatArray, u: FloatArray) -> float:
    """Root mean square of two signals in units of the rig's noise."""
    squares = np.square(y / Peltier.output.noise) + np.square(u / Peltier.drive.noise)
    return float(np.sqrt(np.mean(squares) / 2))


def judged(path: Path) -> tuple[dict[object, Row], list[list[Row]]]:
    """Every pair once, and the candidates of every verdict."""
    judgement = judge(session := open_any(path), terms_from_files(session))
    hour = Window.from_samples(judgement.samples, judgement.settings.period)
    runs: dict[Parameters, Response] = {}
    pairs: dict[object, Row] = {}
    verdicts = []
    for verdict in judgement.verdicts:
        if verdict.stands or not verdict.candidates:
            continue
        for c in verdict.candidates:
            runs[c.parameters] = runs.get(c.parameters) or simulate_window(
                c.parameters, hour
            )
        for (i, a), (j, b) in itertools.combinations(enumerate(verdict.candidates), 2):
            one = runs[a.parameters]
            other = runs[b.parameters]
            apart = size(one.output - other.output, one.input - other.input)
            # structures have no identified models
            matched = max(i, j) < len(verdict.identified_gap)
            models = verdict.identified_gap[i][j] if matched else float("nan")
            pairs[path.stem, a.parameters, b.parameters] = (
                verdict.nu_gap[i][j],
                models,
                apart,
            )
        if verdict.sample + AHEAD < hour.last:
            ahead = hour.part(verdict.sample - 1, verdict.sample + AHEAD)
            verdicts.append([wrong(c, ahead) for c in verdict.candidates])
    return pairs, verdicts


def wrong(candidate: CandidateScore, ahead: Window) -> Row:
    """A candidate's ν-gaps to the plant, and its error on the samples that follow."""
    run = simulate_window(candidate.parameters, ahead)
    error = size(ahead.output[2:] - run.output, ahead.input[2:] - run.input)
    gaps = candidate.nu_gap_to_plant, candidate.identified_gap_to_plant
    return (*(float("nan") if gap is None else gap for gap in gaps), error)  # type: ignore[return-value]


def ranks(rows: Sequence[Row]) -> FloatArray:
    """Rank correlation of either ν-gap with it, shape (2,)."""
    table = np.array(rows)
    found = np.full(2, np.nan)
    for k in (0, 1):
        known = table[np.isfinite(table[:, k])]
        if len(known) > 1 and np.ptp(known[:, k]) > 0:  # equal gaps rank nothing
            found[k] = spearmanr(known[:, k], known[:, 2]).statistic
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--recordings", type=Path, required=True, help="folder of recordings"
    )
    folder = parser.parse_args(arguments).recordings
    pairs: dict[object, Row] = {}
    verdicts: list[list[Row]] = []
    for path in sorted(p for p in folder.glob("*") if p.suffix in {".mat", ".csv"}):
        try:
            own, candidates = judged(path)
        except TwinmatchError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            continue
        print(
            f"{path.name}: {len(own)} pairs, {ranks(list(own.values())).round(2)} (plants, models)"
        )
        pairs |= own
        verdicts += candidates
    if not pairs:
        print(f"{folder}: no recording with a family of two", file=sys.stderr)
        return 1
    print(f"all {len(pairs)} pairs: {ranks(list(pairs.values())).round(2)}")
    every = [row for rows in verdicts for row in rows]
    within = np.nanmean([ranks(rows) for rows in verdicts if len(rows) >= 4], axis=0)
    print(
        f"{len(every)} future errors: {ranks(every).round(2)}, within a verdict {within.round(2)}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
