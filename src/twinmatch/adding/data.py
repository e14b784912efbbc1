"""Checks of a plant against a recording of it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from twinmatch.adding.comparison import compare_structures
from twinmatch.adding.declared_loop import loop_findings
from twinmatch.adding.findings import CheckedPlant, Finding
from twinmatch.adding.noise import noise_of
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
"""If declared and measured noise differ by more than this factor, that is a finding."""
_TODO: Final = {
    Status.NO_EXCITATION: "record steps of the input (or the set-point) that move the output far "
    "above its noise",
    Status.NOT_EXPLAINED: "an effect is missing in the equations: see where the residuals are large "
    "(twinmatch replay --figure), add a part, or correct `noise` if it is far too small",
    Status.DID_NOT_CONVERGE: "start closer: give better defaults, or `starts` in the structure",
    Status.BOUNDS_HIT: "widen the bounds if such a value is possible, otherwise fix that parameter",
    Status.NOT_IDENTIFIABLE: "fix the parameter that the data do not determine (remove it from `free`), or "
    "record a richer experiment: more levels, longer than the slowest time constant",
    Status.NOT_BETTER: "nothing is wrong: the previous candidate predicts equally well",
}
_FAULTY: Final = (
    "leave that part of the recording out; if the plant was healthy, correct what is declared: `span` of the "
    "output (a sensor may stay at its ends), `noise`, or the parameters in `typical`"
)


def data_for(path: Path, plant: type[Plant], map_file: Path | None = None) -> Session:
    """Read a recording as a session of the plant; a table needs a map unless its columns have the names of
    the signals.

    Raises:
        TwinmatchError: the recording cannot be used.
    """
    if path.suffix.lower() in {".csv", ".txt", ".tsv"} or map_file is not None:
        given = read_map(map_file) if map_file is not None else ColumnMap()
        table = read_table(path)
        found = map_samples(table, with_plant_names(table, plant, given), plant)
        return session_of(path, found.samples, plant=plant.name, has_reference=found.has_reference)
    return open_any(path, plant=plant.name)


def check_data(session: Session, plant: type[Plant]) -> CheckedPlant:
    """Check the plant against a recording: noise, duration, and results of the matches.

    Raises:
        TwinmatchError: the recording cannot be judged.
    """
    terms = terms_from_files(session)
    judgement = judge(session, terms)
    y = np.array([sample.output for sample in session.samples])
    noise = noise_of(y)
    findings, notes = [], []
    declared = plant.output.noise
    notes.append(
        f"{session.name}: {y.size} samples, one every {session.period:g} s; measured noise {noise:g}"
    )
    if not declared / _FAR <= noise <= declared * _FAR:
        what = f"the noise of the output is declared as {declared:g}, but measured as {noise:g}"
        findings.append(Finding(what, "correct `noise`: every judgement of the fit depends on it"))
    lags = time_constants(terms.settings.start)
    if lags.size and y.size * session.period < 2 * lags[-1]:
        what = f"the recording lasts {y.size * session.period:g} s, less than twice the slowest time constant"
        findings.append(
            Finding(f"{what} ({lags[-1]:.3g} s)", "record longer, or check the default of that parameter")
        )
    findings += loop_findings(session, plant, terms.settings.gains)
    faults = [verdict.reason for verdict in judgement.verdicts if verdict.fault]
    findings += _of_matches(judgement.matches, faults)
    notes += _accepted(judgement.matches)
    preferred, remarks = compare_structures(session.samples, plant, terms.settings)
    notes += remarks
    if 2 * sum(report.match.accepted for report in judgement.matches) < len(judgement.matches):
        findings += preferred  # where matches are accepted anyway, it is a remark
    return CheckedPlant(f"{plant.title} on {session.name}", tuple(findings), tuple(notes))


def _of_matches(matches: tuple[MatchReport, ...], faults: Sequence[str]) -> list[Finding]:
    if not matches and faults:
        what = f"no window could be matched, because the plant seemed to be at fault: {faults[0]}"
        return [Finding(what, _FAULTY)]
    if not matches:
        what = "no window could be matched: the signals did not move far enough, or not for long enough"
        return [Finding(what, _TODO[Status.NO_EXCITATION])]
    accepted = sum(report.match.accepted for report in matches)
    if accepted:
        return []
    counted = Counter(report.match.status for report in matches)
    findings = []
    for status, number in counted.most_common(2):
        first = next(report.match for report in matches if report.match.status is status)
        what = f"{number} of {len(matches)} matches were refused as {status.value}: {first.reason}"
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
        f"{len(good)} of {len(matches)} matches were accepted; the last: {values}; fit {last.fit.y:.1%}",
        last.determined,
    ]
