"""One session to judge and its outcome: the data sent to another process and back.

Everything is sent by value, so that a process on another machine needs only the session's files under the
same path.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from twinmatch.errors import TwinmatchError
from twinmatch.offline.archive.files import content_of
from twinmatch.offline.processes import pool

if TYPE_CHECKING:
    from twinmatch.comparing import Candidate
    from twinmatch.offline.judging import Judgement
    from twinmatch.twin import TwinSettings


@dataclass(frozen=True)
class ArchiveTerms:
    """Parameters and candidates with which every session of an archive is judged."""

    settings: TwinSettings
    given: tuple[Candidate, ...]
    """Initial candidates."""
    config: Path | None
    """File of the settings, for messages; it is not read again."""
    document: Callable[..., dict[str, Any]]
    """Makes the JSON of a session from its name, verdicts, summary and matches, such as
    `twinmatch.showing.summary.document`; sent to other processes by its name."""
    fixed: bool = False
    """Whether the user gave the plant of all sessions; otherwise each session names its own."""


@dataclass(frozen=True)
class Job:
    """One session to judge."""

    number: int
    path: Path
    """Absolute."""
    content: str
    """Hash of the session's content."""
    terms: ArchiveTerms


class JobResult(NamedTuple):
    """Outcome of a job: a record, or the reason why there is none."""

    number: int
    record: dict[str, Any] | None
    error: str = ""


class Failure(NamedTuple):
    """A session that was skipped."""

    path: Path
    reason: str


def judge_job(job: Job, place: str = "") -> JobResult:
    """Judge one session; any error becomes the outcome's error.

    Args:
        job: the session.
        place: where this runs, for messages, such as " on worker tcp://10.0.0.7:41"; empty: on this machine.
    """
    try:
        content = content_of(job.path)
    except OSError as error:
        hint = "; workers read sessions under the same path as here" if place else ""
        return JobResult(job.number, None, f"{job.path}: cannot be read{place} ({error.strerror}){hint}")
    if content != job.content:
        change = f"differs{place} from the session here" if place else "has changed since the run started"
        return JobResult(job.number, None, f"{job.path}: {change}")
    try:
        return JobResult(job.number, _record(job))
    except TwinmatchError as error:
        return JobResult(job.number, None, str(error))
    except Exception as error:  # a defect, which must not stop the other sessions
        where = traceback.extract_tb(error.__traceback__)[-1]
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        msg = f"{job.path}: {what} (a defect in twinmatch, {where.filename} line {where.lineno})"
        return JobResult(job.number, None, msg)


def _record(job: Job) -> dict[str, Any]:
    """The judged session as a dictionary for JSON, with one row per candidate."""
    from twinmatch.offline.judging import judge_samples  # noqa: PLC0415 — numpy: not before the process is set up
    from twinmatch.parameters.twin import at_period, read_settings  # noqa: PLC0415
    from twinmatch.plants import plant_named  # noqa: PLC0415
    from twinmatch.sessions import SessionError, open_any  # noqa: PLC0415

    terms, session = job.terms, open_any(job.path)
    settings = terms.settings
    if terms.fixed and session.plant and plant_named(session.plant) is not settings.plant:
        raise SessionError(f"{job.path}: was recorded from plant {session.plant}, not {settings.plant.name}")
    if terms.config is None:
        plant = session.plant or settings.plant.name
        settings = read_settings(None, plant, driven=not session.has_reference)
    settings = at_period(settings, session.period, terms.config)
    judgement = judge_samples(session.name, session.samples, settings, given=terms.given, notes=session.notes)
    entry = terms.document(judgement.name, judgement.verdicts, judgement.summary, judgement.matches)
    return entry | {"candidates": _rows(judgement, entry)}


def _rows(judgement: Judgement, entry: dict[str, Any]) -> list[dict[str, Any]]:
    """The candidates of the last verdict, each with the fit of its twin over the session."""
    if not judgement.verdicts:
        return []
    from twinmatch.record import finite  # noqa: PLC0415
    from twinmatch.signals import Window, unbroken  # noqa: PLC0415
    from twinmatch.twin import window_fit  # noqa: PLC0415

    gains, period = judgement.settings.gains, judgement.settings.period
    longest = Window.from_samples(max(unbroken(judgement.samples), key=len), period)
    rows = []
    for candidate, known in zip(
        judgement.verdicts[-1].modelled, entry["verdicts"][-1]["candidates"], strict=False
    ):
        chosen = next(order for order in known["orders"] if order["order"] == candidate.chosen_order)
        fit = window_fit(candidate.parameters, longest, gains)
        rows.append(
            {"session": judgement.name, "nominal": candidate.name == judgement.summary.nominal}
            | {key: value for key, value in known.items() if key != "orders"}
            | {"criteria": chosen["total"] | {key: chosen[key] for key in ("aic_difference", "weight")}}
            | {"fit": finite(dict(zip("yu", fit, strict=True)))}
        )
    return rows


def judge_in_processes(jobs: Sequence[Job], processes: int) -> Iterator[JobResult]:
    """Judge sessions in this many processes; yields outcomes as they complete.

    If a process dies (out of memory, for example), the sessions without an outcome are judged again one by
    one, which finds the one that caused it. Closing the iterator terminates the processes at once.
    """
    left = {job.number: job for job in jobs}
    try:
        for outcome in _pooled(jobs, min(processes, len(jobs))):
            del left[outcome.number]
            yield outcome
    except BrokenProcessPool:
        for job in left.values():
            try:
                yield from _pooled([job], 1)
            except BrokenProcessPool:
                yield JobResult(job.number, None, f"{job.path}: the process that judged it died")


def _pooled(jobs: Sequence[Job], processes: int) -> Iterator[JobResult]:
    with pool(processes) as workers:
        for future in as_completed([workers.submit(judge_job, job) for job in jobs]):
            yield future.result()
