"""`--memory` and `--rig` of the commands that judge: a start from the memory, and sessions that add to it."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from twinmatch.cli.shared import say_missing
from twinmatch.errors import TwinmatchError


@contextmanager
def started(options: argparse.Namespace) -> Iterator[None]:
    """Within it, `options.candidates` also holds what the memory gives, if `--memory` or `--rig` is given.

    A memory that cannot be used is reported, and the command runs without it.
    """
    if (
        not (getattr(options, "memory", None) or getattr(options, "rig", ""))
        or "candidates" not in options
    ):
        yield
        return
    from twinmatch.memory import MemoryFaultError  # noqa: PLC0415
    from twinmatch.offline.starting import memory_file, remembered_start  # noqa: PLC0415
    from twinmatch.parameters.candidates import candidates_text, read_candidates  # noqa: PLC0415

    plant = options.plant or ""
    single = [getattr(options, name, None) for name in ("session", "came")]
    paths = [*single, *getattr(options, "sessions", [])]
    judged = {
        name for path in paths if path is not None for name in (path.name, path.stem)
    }
    try:
        options.memory = memory_file(options.memory, options.rig, plant)
        start = remembered_start(options.memory, options.rig, plant, judged)
    except MemoryFaultError as error:
        print(f"twinmatch: {error}; this run starts without a memory", file=sys.stderr)
        yield
        return
    print(f"memory {start.sentence}", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="twinmatch-start-") as folder:
        if start.candidates:
            candidates = (
                read_candidates(options.candidates) if options.candidates else []
            )
            options.candidates = Path(folder) / "candidates.yaml"
            options.candidates.write_text(
                candidates_text([*candidates, *start.candidates]), "utf-8"
            )
        yield


def remember_recorded(options: argparse.Namespace, sessions: Sequence[Path]) -> None:
    """Add what a live run has recorded to the memory that it was given."""
    if not options.memory and not options.rig:
        return
    from twinmatch.memory import Memory  # noqa: PLC0415
    from twinmatch.offline.judging import terms_from_files  # noqa: PLC0415
    from twinmatch.offline.remembering import learn  # noqa: PLC0415
    from twinmatch.offline.starting import memory_file  # noqa: PLC0415
    from twinmatch.sessions import read_session  # noqa: PLC0415

    for path in filter(Path.exists, sessions):
        try:
            memory = Memory(
                memory_file(options.memory, options.rig, options.plant or "")
            )
            session = read_session(path)
            if session.missing:
                say_missing(session.name, session.missing)
                print(
                    f"twinmatch: {path} is not remembered; to learn from what is there: twinmatch remember "
                    f"{path} --although",
                    file=sys.stderr,
                )
                continue
            lessons = learn(
                session, terms_from_files(session, options.twin_config), options.rig
            )
            memory.add(lessons)
        except TwinmatchError as error:
            print(f"twinmatch: {path} is not remembered: {error}", file=sys.stderr)
        else:
            outcome = f"{len(lessons)} structures" if lessons else "it teaches nothing"
            print(f"remembered {path.name}: {outcome}", file=sys.stderr)
