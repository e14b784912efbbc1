"""A start from the memory: the candidates that a session begins with."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from twinmatch.comparing import Candidate
from twinmatch.dynamics import PlantError
from twinmatch.memory import (
    Lesson,
    Memory,
    MemoryFaultError,
    default_file,
    default_files,
    start_from,
)
from twinmatch.plants import find_plant, plant_named


class RememberedStart(NamedTuple):
    """What a session starts with."""

    candidates: tuple[Candidate, ...]
    """Empty if the memory gives none."""
    sentence: str
    """What was taken, or why nothing was."""


def memory_file(memory: Path | None, rig: str, plant: str) -> Path:
    """The memory that `--memory` or `--rig` names; without a plant the only one of a rig of that name.

    Raises:
        MemoryFaultError: there are several, or none.
    """
    if memory is not None:
        return memory
    if plant:
        return default_file(find_plant(plant).name, rig)
    having = [path for path in default_files() if path.stem.endswith(f"@{rig}")]
    if len(having) != 1:
        rigs = f"rigs of this name: {', '.join(path.stem for path in having) or 'none'}"
        raise MemoryFaultError(
            f"memory of rig {rig!r}: {rigs}; name the plant with --plant, or give --memory"
        )
    return having[0]


def remembered_start(
    path: Path, rig: str, plant: str, excluded: Collection[str] = ()
) -> RememberedStart:
    """The start from a memory, without the sessions named in `excluded`: those that are judged.

    Raises:
        MemoryFaultError: the memory cannot be used, or holds several plants and none is named.
    """
    lessons = [
        remembered
        for remembered in Memory(path).lessons(rig=rig or None)
        if remembered.name not in excluded
    ]
    kinds = sorted({lesson.plant for lesson in lessons})
    if not lessons:
        return RememberedStart((), f"{path}: nothing is remembered yet")
    if not plant and len(kinds) > 1:
        raise MemoryFaultError(
            f"memory {path}: it is of {', '.join(kinds)}; name the plant with --plant"
        )
    try:
        kind = find_plant(plant) if plant else plant_named(kinds[0])
    except PlantError as error:
        raise MemoryFaultError(
            f"memory {path}: {error}; give its plant file with --plant"
        ) from error
    candidates = start_from(lessons, kind)
    if not candidates:
        return RememberedStart((), f"{path}: {_why_nothing(lessons, kind.name)}")
    sessions = len({lesson.session for lesson in lessons if lesson.plant == kind.name})
    structure = candidates[0].parameters.model.structure_name
    count = "1 session is" if sessions == 1 else f"{sessions} sessions are"
    content = f"{count} remembered, the twin is expected in the structure {structure!r}"
    return RememberedStart(tuple(candidates), f"{path}: {content}")


def _why_nothing(lessons: Collection[Lesson], plant: str) -> str:
    if plant not in {lesson.plant for lesson in lessons}:
        return f"nothing is remembered of plant {plant}"
    return (
        "no remembered session has led in a structure that the plant still has, with the same equations; a "
        "changed plant file begins with a new memory"
    )
