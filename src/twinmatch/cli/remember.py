"""`twinmatch remember`: learn from recorded sessions."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from twinmatch.cli.shared import Progress, add_options, exit_code, say_missing
from twinmatch.errors import TwinmatchError
from twinmatch.importing import open_any
from twinmatch.memory import (
    Memory,
    MemoryFaultError,
    current_lessons,
    default_file,
    digest_of,
)
from twinmatch.offline.archive import find_sessions
from twinmatch.offline.judging import terms_from_files
from twinmatch.offline.processes import held_interrupts
from twinmatch.offline.remembering import learn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(
        parser, "sessions", "--memory", "--rig", "--plant", "--allow-fmu", "--config"
    )
    although = "learn also from sessions that are cut off, damaged, or were repaired after damage"
    parser.add_argument("--although", action="store_true", help=although)


def run(options: argparse.Namespace) -> int:
    """Add the lessons of the sessions; returns the exit code: 0 all, 3 some skipped, 2 none."""
    paths = find_sessions(options.sessions)
    skipped = 0
    with held_interrupts():
        for path in paths:
            try:
                print(_remember(path, options))
            except MemoryFaultError:
                raise
            except TwinmatchError as error:
                skipped += 1
                print(f"twinmatch: skipped {path}: {error}", file=sys.stderr)
    return exit_code(len(paths) - skipped, skipped)


def _remember(path: Path, options: argparse.Namespace) -> str:
    """Learn from one session, unless it is remembered already; returns what was done, in a sentence."""
    with Progress(f"learning from {path.name}") as progress:
        session = open_any(path, plant=options.plant)
        if session.missing and not options.although:
            raise TwinmatchError(
                f"it is not complete: {'; '.join(session.missing)}; look at it with `twinmatch replay`, and "
                "give --although to learn from what is there"
            )
        terms = terms_from_files(session, options.config)
        plant = terms.settings.plant
        memory = Memory(options.memory or default_file(plant.name, options.rig))
        current = current_lessons(memory.lessons(plant.name, options.rig), plant)
        if digest_of(session.samples) in {lesson.session for lesson in current}:
            return f"{session.name}: remembered already"
        lessons = learn(session, terms, options.rig, progress.advance)
    say_missing(session.name, session.missing)
    if not lessons:
        return f"{session.name}: teaches nothing: its healthy part is too short, or determines no parameters"
    memory.add(lessons)
    part = (
        ""
        if lessons[0].fault_at is None
        else f", up to its first fault at sample {lessons[0].fault_at}"
    )
    return f"{session.name}: {len(lessons)} structures{part} → {memory.path}"
