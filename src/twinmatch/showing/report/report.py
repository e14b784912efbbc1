"""The report: the content for its template, and the file."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from twinmatch.errors import TwinmatchError
from twinmatch.offline.backtest import sentences
from twinmatch.offline.judgement import Watch
from twinmatch.sessions.files import ProgressCallback
from twinmatch.showing import sentence
from twinmatch.showing.family import Member, family
from twinmatch.showing.report.forecast_tables import forecast_tables
from twinmatch.showing.report.judging import Judged, judge
from twinmatch.showing.report.leader_forecasts import fans_of, leader_forecast_table
from twinmatch.showing.report.match_tables import (
    event_table,
    family_table,
    match_table,
    nominal_table,
    structure_table,
)
from twinmatch.showing.report.model_tables import (
    coefficient_table,
    criterion_tables,
    gap_table,
    identified_table,
    order_table,
)
from twinmatch.showing.report.page import render
from twinmatch.showing.report.pictures import Picture, pictures
from twinmatch.showing.report.provenance import Provenance, provenance
from twinmatch.showing.report.words import plain_words, session_facts
from twinmatch.showing.standing import last_verdict
from twinmatch.showing.style import LEVEL_WORDS, LEVELS
from twinmatch.showing.words import words_of

__all__ = ["Report", "build_report", "make_report"]


@dataclass(frozen=True, eq=False)
class Report:
    """The content of a report, ready for layout."""

    judged: Judged
    members: tuple[Member, ...]
    pictures: dict[str, Picture]
    provenance: Provenance

    @property
    def name(self) -> str:
        """Name of the session."""
        return self.judged.judgement.name

    @property
    def sentence(self) -> str:
        """The summary in one line."""
        return sentence(self.judged.judgement.summary)

    @property
    def nominal(self) -> Member | None:
        """The nominal candidate; None without one, or if its window is not in the session."""
        return next((m for m in self.members if m.nominal), None)

    def html(self) -> str:
        """The report as one HTML document that loads nothing else."""
        return render(self._content())

    def write(self, path: Path) -> None:
        """Write the document.

        Raises:
            TwinmatchError: the file cannot be written.
        """
        try:
            path.write_text(self.html(), encoding="utf-8")
        except OSError as error:
            msg = f"{path}: the report cannot be written: {error.strerror}"
            raise TwinmatchError(msg) from error

    def _content(self) -> dict[str, object]:
        judged, judgement = self.judged, self.judged.judgement
        last, nominal = last_verdict(judgement.verdicts), self.nominal
        period, level = judgement.settings.period, judgement.summary.level
        closed = judgement.settings.gains is not None
        plant, matched = judgement.settings.plant, judgement.settings.start.model.structure_name
        return {
            "name": self.name,
            "sentence": self.sentence,
            "level": level.value,
            "level_colour": LEVELS[level],
            "level_words": LEVEL_WORDS[level],
            "words": [*plain_words(judgement), *sentences(judged.tested)[-1:]],
            "forecasts": forecast_tables(judged.tested),
            "forecast_sentences": sentences(judged.tested),
            "fans": leader_forecast_table(fans_of(judged.tested, judgement), plant),
            "horizons": ", ".join(f"{h:g}" for h in judged.tested.horizons),
            "confidence": f"{100 * judged.tested.confidence:.0f}",
            "forecast_notes": [
                *judged.tested.notes,
                *(f"{a.name}: {a.reason}" for a in judged.tested.absent),
            ],
            "facts": session_facts(judgement),
            "notes": judgement.summary.notes,
            "pictures": self.pictures,
            "events": event_table(judgement.verdicts, period),
            "match": nominal.match if nominal else None,
            "nominal_parameters": nominal_table(nominal.score, nominal.match) if nominal else None,
            "family": family_table(self.members) if self.members else None,
            "matches": match_table(judgement.matches, judgement.verdicts, period, closed=closed)
            if judgement.matches
            else None,
            "verdict": last,
            "criteria": criterion_tables(last) if last else [],
            "weights": order_table(last) if last else None,
            "structure": structure_table(last) if last else None,
            "gaps": gap_table(last) if last else None,
            "identified": identified_table(last) if last else None,
            "coefficients": coefficient_table(nominal) if nominal else None,
            "other_coefficients": [coefficient_table(m) for m in self.members if not m.nominal],
            "limits": judgement.settings.limits,
            "schedule": judgement.settings.schedule,
            "judged": self.judged,
            "plant": plant,
            "called": words_of(plant),
            "closed": closed,
            "asked": "set-point" if closed else "input",
            "others": ", ".join(n for n in plant.structures if n != matched),
            "provenance": self.provenance,
        }


def build_report(
    judged: Judged, path: Path, *, command: str = "from Python", made: datetime | None = None
) -> Report:
    """Build the report of a judged session; `path` is where the session was read from."""
    judgement = judged.judgement
    members = family(
        judgement.samples, judgement.matches, last_verdict(judgement.verdicts), judgement.settings
    )
    made = made or datetime.now().astimezone()
    return Report(
        judged=judged,
        members=members,
        pictures=pictures(judgement, members, judged.tested),
        provenance=provenance(path, judgement.settings, command, made),
    )


def make_report(
    path: Path,
    *,
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    watch: Watch | None = None,
    progress: ProgressCallback | None = None,
    command: str = "from Python",
) -> Report:
    """Judge a session, an `.mcap` file or a recording and build a report on it.

    Args:
        path: the session or recording.
        config: parameter file; without one the parameters recorded with the session, or the defaults.
        candidates: file of initial candidates.
        plant: name or file of the plant, if the session does not name it or it is in a file.
        watch: called with the progress.
        progress: called with the amount of the file read and the total.
        command: command line shown in the report.

    Raises:
        TwinmatchError: one of the files cannot be used.
    """
    judged = judge(path, config=config, candidates=candidates, plant=plant, watch=watch, progress=progress)
    return build_report(judged, path, command=command)
