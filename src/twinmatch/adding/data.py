"""What a recording says about a plant, and what the gate says about the recording."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from twinmatch.adding.findings import CheckedPlant, Finding
from twinmatch.adding.proposal import noise_of
from twinmatch.adding.trial import time_constants
from twinmatch.dynamics import Plant
from twinmatch.judging.judgement import judge
from twinmatch.judging.terms import terms_from_files
from twinmatch.matching.gate import Status
from twinmatch.sessions import Session, open_any
from twinmatch.sessions.column_map import ColumnMap, read_map
from twinmatch.sessions.mapped import map_samples, with_plant_names
from twinmatch.sessions.sources import session_of
from twinmatch.sessions.tables import read_table
from twinmatch.twin import MatchReport

__all__ = ["check_data", "data_for"]

_FAR: Final = 3.0
"""Factor between the noise that is declared and that of the readings from which on one of them is doubted."""
_TODO: Final = {
    Status.NO_EXCITATION: "record steps of the input (or the set-point) that move the output far "
    "above its noise",
    Status.NOT_EXPLAINED: "the equations lack something the plant does: look where the residuals are "
    "(twinmatch "
    "replay --figure), add a part, or correct `noise` if it is far too small",
    Status.DID_NOT_CONVERGE: "begin nearer: better defaults, or `starts` in the structure",
    Status.BOUNDS_HIT: "widen the bounds if such a value is possible, else fix that parameter",
    Status.NOT_IDENTIFIABLE: "fix what the data do not show (take it out of `free`), or record a "
    "richer experiment: "
    "more levels, longer than the slowest time constant",
    Status.NOT_BETTER: "nothing is wrong: what stood before predicts as well",
}


def data_for(path: Path, plant: type[Plant], map_file: Path | None = None) -> Session:
    """A recording as a session of the plant; a table needs a map unless its columns are called as the
    signals.

    Raises:
        TwinmatchError: it cannot be used.
    """
    if path.suffix.lower() in {".csv", ".txt", ".tsv"} or map_file is not None:
        given = read_map(map_file) if map_file is not None else ColumnMap()
        table = read_table(path)
        found = map_samples(table, with_plant_names(table, plant, given), plant)
        return session_of(path, found.samples, plant=plant.name, has_reference=found.has_reference)
    return open_any(path, plant=plant.name)


def check_data(session: Session, plant: type[Plant]) -> CheckedPlant:
    """What is told by a recording of the plant.

    Raises:
        TwinmatchError: it cannot be judged.
    """
    terms = terms_from_files(session)
    judgement = judge(session, terms)
    y = np.array([sample.output for sample in session.samples])
    noise = noise_of(y)
    findings, notes = [], []
    declared = plant.output.noise
    notes.append(
        f"{session.name}: {y.size} samples, one every {session.period:g} s; scatter of a reading {noise:g}"
    )
    if not declared / _FAR <= noise <= declared * _FAR:
        what = f"noise of the output is declared as {declared:g}; the readings scatter by {noise:g}"
        findings.append(Finding(what, "correct `noise`: it weighs everything that is said about the fit"))
    lags = time_constants(terms.settings.start)
    if lags.size and y.size * session.period < 2 * lags[-1]:
        what = (
            f"the recording lasts {y.size * session.period:g} s, less than two of the slowest time constant"
        )
        findings.append(
            Finding(f"{what} ({lags[-1]:.3g} s)", "record longer, or look at that parameter's default")
        )
    findings += _of_matches(judgement.matches)
    notes += _accepted(judgement.matches)
    return CheckedPlant(f"{plant.title} on {session.name}", tuple(findings), tuple(notes))


def _of_matches(matches: tuple[MatchReport, ...]) -> list[Finding]:
    if not matches:
        what = "no window could be matched: nothing moved far enough, or for long enough"
        return [Finding(what, _TODO[Status.NO_EXCITATION])]
    accepted = sum(report.match.accepted for report in matches)
    if accepted:
        return []
    counted = Counter(report.match.status for report in matches)
    findings = []
    for status, number in counted.most_common(2):
        first = next(report.match for report in matches if report.match.status is status)
        what = f"the gate refused {number} of {len(matches)} matches as {status.value}: {first.reason}"
        todo = f"{first.suggestion} " if first.suggestion else ""
        findings.append(Finding(what, f"{todo}{_TODO.get(status, '')}".strip()))
    return findings


def _accepted(matches: tuple[MatchReport, ...]) -> list[str]:
    good = [report.match for report in matches if report.match.accepted]
    if not good:
        return []
    last = good[-1]
    values = ", ".join(
        f"{name} = {last.parameters[name]:.4g} ± {error:.1g}"
        for name, error in zip(last.free, last.standard_errors, strict=True)
        if name in last.parameters and math.isfinite(error)
    )
    return [
        f"the gate accepted {len(good)} of {len(matches)} matches; the last: {values}; fit {last.fit.y:.1%}",
        last.determined,
    ]
