"""A memory for people: a table of its sessions, what has changed in words, and both as a document."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from twinmatch.dynamics import Plant
from twinmatch.memory import (
    Lesson,
    Memory,
    MemoryFaultError,
    MemoryReport,
    current_lessons,
    default_file,
    report_on,
    shared_structure,
)
from twinmatch.sessions.recording import EPOCH
from twinmatch.showing.quantities import parameter_format

if TYPE_CHECKING:
    from rich.table import Table


class RememberedRig(NamedTuple):
    """What a memory holds of one plant and rig."""

    plant: type[Plant]
    rig: str
    structure: str
    """Structure in which the sessions are compared; empty if there is no session with today's equations."""
    lessons: list[Lesson]
    """All of this plant and rig, oldest first."""
    report: MemoryReport

    @property
    def outdated(self) -> int:
        """Number of sessions that were remembered only with other equations than today's."""
        current = current_lessons(self.lessons, self.plant)
        return len(
            {lesson.session for lesson in self.lessons}
            - {lesson.session for lesson in current}
        )

    @property
    def title(self) -> str:
        """Plant and rig."""
        return f"{self.plant.title}{f', {self.rig}' if self.rig else ''}"

    @property
    def sentences(self) -> list[str]:
        """What there is to say about it."""
        sentences = []
        if self.structure:
            text = self.report.sentence
            sentences.append(f"{text[0].upper()}{text[1:]}.")
        if self.outdated:
            some = (
                f"{self.outdated} session{'s' if self.outdated > 1 else ''} remembered"
            )
            sentences.append(
                f"Not compared: {some} with other equations of this plant; remember them again."
            )
        return sentences

    def table(self) -> Table:
        """One row for each session, with the parameters of the structure and their standard deviations."""
        from rich.table import Table  # noqa: PLC0415

        shown = Table(title=f"{self.title}: {self.structure}", box=None, pad_edge=False)
        free = self.report.lessons[0].free if self.report.lessons else ()
        formats = [parameter_format(self.plant, name) for name in free]
        for name in ("session", "began", "hours", "level", *(q.label for q in formats)):
            side: Any = "left" if name in {"session", "began", "level"} else "right"
            shown.add_column(name, justify=side, no_wrap=True)
        for lesson in self.report.lessons:
            cells = (
                f"{q.text(lesson.parameters[q.name])} ± {q.error_text(float(deviation))}"
                for q, deviation in zip(formats, lesson.deviations, strict=True)
            )
            faulty = (
                "" if lesson.fault_at is None else f", faulty from {lesson.fault_at}"
            )
            shown.add_row(
                lesson.name,
                began_text(lesson),
                f"{lesson.duration / 3600:.2f}",
                lesson.level + faulty,
                *cells,
            )
        return shown

    def document(self) -> dict[str, Any]:
        """All of it as a dictionary for JSON."""
        changes = [
            asdict(change) | {"sentence": change.sentence}
            for change in self.report.changes
        ]
        return {
            "plant": self.plant.name,
            "rig": self.rig,
            "structure": self.structure,
            "sentences": self.sentences,
            "changes": _finite(changes),
            "lessons": _finite([asdict(lesson) for lesson in self.lessons]),
        }


def remembered(
    lessons: Sequence[Lesson], plant: type[Plant], rig: str
) -> RememberedRig:
    """What these lessons on a plant and rig say, in the structure that its sessions share."""
    current = current_lessons(lessons, plant)
    structure = shared_structure(current)
    compared = [lesson for lesson in current if lesson.structure == structure]
    report = (
        report_on(compared, plant.model(structure))
        if structure
        else MemoryReport([], [], [], [])
    )
    return RememberedRig(plant, rig, structure, list(lessons), report)


def memory_words(plant: type[Plant], file: Path | None, rig: str) -> list[str]:
    """What a memory says about a plant and rig, in sentences, or why it cannot be used; empty without one."""
    if file is None and not rig:
        return []
    try:
        lessons = Memory(file or default_file(plant.name, rig)).lessons(plant.name, rig)
    except MemoryFaultError as error:
        return [f"Nothing is known of earlier sessions: {error}."]
    return remembered(lessons, plant, rig).sentences


def began_text(lesson: Lesson) -> str:
    """When a session began, in UTC; a dash for a recording without a date."""
    if lesson.began == EPOCH:
        return "–"
    return datetime.fromtimestamp(lesson.began / 1e9, timezone.utc).strftime(
        "%Y-%m-%d %H:%M"
    )


def _finite(value: Any) -> Any:
    """For strict JSON: numbers that are not finite become null."""
    if isinstance(value, dict):
        return {name: _finite(member) for name, member in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(member) for member in value]
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
