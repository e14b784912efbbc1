"""Judging many sessions: those with a result of an earlier run, those judged now, and those skipped."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinmatch.offline.archive.files import Store, content_of, find_sessions, key_of
from twinmatch.offline.archive.job import (
    ArchiveTerms,
    Failure,
    Job,
    JobResult,
    judge_in_processes,
    judge_on_cluster,
)
from twinmatch.offline.processes import cores


@dataclass(frozen=True)
class Archive:
    """Results of many sessions."""

    sessions: tuple[dict[str, Any], ...]
    """Name, path and summary of each judged session, in the order given."""
    candidates: tuple[dict[str, Any], ...]
    """Candidates of all sessions, one row each: session, parameters, ν-gap sum, fit, …"""
    failed: tuple[Failure, ...]
    """The skipped sessions, and why."""
    reused: int
    """How many of the judged sessions have a result of an earlier run."""

    def document(self) -> dict[str, Any]:
        """The results as a dictionary for JSON."""
        failed = [
            {"path": str(failure.path), "reason": failure.reason}
            for failure in self.failed
        ]
        return {
            "sessions": list(self.sessions),
            "candidates": list(self.candidates),
            "failed": failed,
        }


def judge_archive(
    named: Sequence[Path | str],
    *,
    document: Callable[..., dict[str, Any]],
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    watch: Callable[[int, int], None] | None = None,
    on_skip: Callable[[Failure], None] | None = None,
) -> Archive:
    """Judge many sessions, each separately.

    Args:
        named: sessions, recordings, folders of them, patterns; see `find_sessions`.
        document: makes a session's document; see `ArchiveTerms`.
        config, candidates: files of parameters and initial candidates for every session.
        plant: name or file of the plant of every session that does not name it.
        out: folder for one JSON file per session with its document. A session is not judged again if its
            file there has the same content, parameters and version.
        jobs: number of processes on this machine; one per core if not given.
        scheduler: address of a Dask scheduler; its workers judge instead.
        watch: called with (sessions done, total) after each session.
        on_skip: called with each session that cannot be used.
    """
    paths = find_sessions(named)
    terms = _terms(config, candidates, plant, document)
    store = Store(out) if out else None
    report = watch or (lambda _done, _total: None)
    results = _Results(paths, on_skip or (lambda _failure: None))
    described = _describe(terms)
    todo: list[Job] = []
    keys: dict[int, str] = {}
    for number, path in enumerate(paths):
        try:
            content = content_of(path)
        except OSError as error:
            results.fail(number, f"{path}: {_why_not_read(error)}")
            continue
        keys[number] = key_of(content, described)
        stored = store.find(path, keys[number]) if store else None
        if stored is not None:
            results.take(number, stored)
        else:
            todo.append(Job(number, path.resolve(), content, terms))
    reused = results.judged
    decided = len(paths) - len(todo)
    report(decided, len(paths))
    with contextlib.closing(_outcomes(todo, jobs, scheduler)) as outcomes:
        for count, (number, record, why) in enumerate(outcomes, decided + 1):
            if record is None:
                results.fail(number, why)
            else:
                if store is not None:
                    store.keep(paths[number], keys[number], record)
                results.take(number, record)
            report(count, len(paths))
    return results.archive(reused)


def _why_not_read(error: OSError) -> str:
    """Why the content of a session could not be read."""
    if isinstance(error, FileNotFoundError):
        return "does not exist"
    return str(error.strerror)


class _Results:
    """The results of an archive's sessions so far, by their number in the order given."""

    def __init__(
        self, paths: Sequence[Path], on_skip: Callable[[Failure], None]
    ) -> None:
        """Begin without results; `on_skip` is called with each session that cannot be used."""
        self._paths = paths
        self._on_skip = on_skip
        self._records: dict[int, dict[str, Any]] = {}
        self._failed: dict[int, Failure] = {}

    @property
    def judged(self) -> int:
        """Number of sessions with a record."""
        return len(self._records)

    def take(self, number: int, record: dict[str, Any]) -> None:
        """Take a record without its verdicts, as those of a large archive do not fit into memory."""
        self._records[number] = {
            key: value for key, value in record.items() if key != "verdicts"
        }

    def fail(self, number: int, reason: str) -> None:
        """Skip a session."""
        self._failed[number] = Failure(self._paths[number], reason)
        self._on_skip(self._failed[number])

    def archive(self, reused: int) -> Archive:
        """All results; so many of the records are those of an earlier run."""
        count_of_name = Counter(record["session"] for record in self._records.values())
        sessions: list[dict[str, Any]] = []
        rows: list[dict[str, Any]] = []
        for number, record in sorted(self._records.items()):
            path = str(self._paths[number])
            name = record["session"] if count_of_name[record["session"]] == 1 else path
            sessions.append(
                {"session": name, "path": path, "summary": record["summary"]}
            )
            rows += [row | {"session": name} for row in record["candidates"]]
        failed = tuple(self._failed[number] for number in sorted(self._failed))
        return Archive(tuple(sessions), tuple(rows), failed, reused)


def _describe(terms: ArchiveTerms) -> str:
    """All that a result depends on besides the session and the software, as text."""
    from twinmatch.dynamics.store import source_hash  # noqa: PLC0415

    return repr(
        (terms.settings, terms.given, terms.fixed, source_hash(terms.settings.plant))
    )


def _terms(
    config: Path | None,
    candidates: Path | None,
    plant: str | None,
    document: Callable[..., dict[str, Any]],
) -> ArchiveTerms:
    from twinmatch.parameters.candidates import read_candidates  # noqa: PLC0415
    from twinmatch.parameters.twin import read_settings  # noqa: PLC0415
    from twinmatch.plants import find_plant  # noqa: PLC0415

    if plant:
        plant = find_plant(plant).name
    settings = read_settings(config, plant or "")
    initial_candidates = tuple(read_candidates(candidates)) if candidates else ()
    return ArchiveTerms(
        settings,
        initial_candidates,
        config,
        document,
        fixed=plant is not None or config is not None,
    )


def _outcomes(
    todo: list[Job], jobs: int | None, scheduler: str | None
) -> Generator[JobResult]:
    """The outcomes of all jobs as they complete, from this machine or from a cluster."""
    if not todo:
        return
    if scheduler is None:
        yield from judge_in_processes(todo, jobs or cores())
    else:
        yield from judge_on_cluster(todo, scheduler)
