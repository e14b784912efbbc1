"""Sessions judged in other processes, on this machine or on the workers of a Dask cluster.

Everything is sent by value, so that a process on another machine needs only the session's files under the
same path.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from uuid import uuid4

from twinmatch.errors import TwinmatchError
from twinmatch.offline.archive.files import ClusterError, content_of, software
from twinmatch.offline.processes import pool

if TYPE_CHECKING:
    from distributed import Client, Future

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

    `place` is where this runs, for messages, such as " on worker tcp://10.0.0.7:41"; empty: on this machine.
    """
    try:
        content = content_of(job.path)
    except OSError as error:
        hint = "; workers read sessions under the same path as here" if place else ""
        return JobResult(
            job.number,
            None,
            f"{job.path}: cannot be read{place} ({error.strerror}){hint}",
        )
    if content != job.content:
        change = (
            f"differs{place} from the session here"
            if place
            else "has changed since the run started"
        )
        return JobResult(job.number, None, f"{job.path}: {change}")
    try:
        return JobResult(job.number, _record(job))
    except TwinmatchError as error:
        return JobResult(job.number, None, str(error))
    except Exception as error:  # a defect, which must not stop the other sessions
        where = traceback.extract_tb(error.__traceback__)[-1]
        description = f"{type(error).__name__}: {error}".splitlines()[0]
        msg = f"{job.path}: {description} (a defect in twinmatch, {where.filename} line {where.lineno})"
        return JobResult(job.number, None, msg)


def _record(job: Job) -> dict[str, Any]:
    """The judged session as a dictionary for JSON, with one row per candidate."""
    from twinmatch.importing import open_any  # noqa: PLC0415
    from twinmatch.offline.judging import judge_samples, terms_from_files  # noqa: PLC0415
    from twinmatch.parameters.twin import at_period  # noqa: PLC0415
    from twinmatch.plants import plant_named  # noqa: PLC0415
    from twinmatch.sessions import SessionError  # noqa: PLC0415

    terms = job.terms
    session = open_any(job.path)
    settings = terms.settings
    if (
        terms.fixed
        and session.plant
        and plant_named(session.plant) is not settings.plant
    ):
        raise SessionError(
            f"{job.path}: was recorded from plant {session.plant}, not {settings.plant.name}"
        )
    if terms.config is None:
        session = replace(session, plant=session.plant or settings.plant.name)
        settings = terms_from_files(session).settings
    settings = at_period(settings, session.period, terms.config)
    judgement = judge_samples(
        session.name,
        session.samples,
        settings,
        initial_candidates=terms.given,
        notes=session.notes,
    )
    document = terms.document(
        judgement.name, judgement.verdicts, judgement.summary, judgement.matches
    )
    return document | {"candidates": _rows(judgement, document)}


_CRITERIA = ("aic_difference", "weight")


def _rows(judgement: Judgement, document: dict[str, Any]) -> list[dict[str, Any]]:
    """The candidates of the last verdict, each with the fit of its twin over the session."""
    if not judgement.verdicts:
        return []
    from twinmatch.record import finite  # noqa: PLC0415
    from twinmatch.twin import window_fits  # noqa: PLC0415

    law = judgement.settings.law
    longest = max(judgement.stretches, key=len)
    rows = []
    for candidate, recorded_candidate in zip(
        judgement.verdicts[-1].family,
        document["verdicts"][-1]["candidates"],
        strict=False,
    ):
        chosen = next(
            (
                o
                for o in recorded_candidate["orders"]
                if o["order"] == candidate.chosen_order
            ),
            None,
        )
        fits = window_fits(candidate.parameters, longest, law)
        rows.append(
            {
                "session": judgement.name,
                "nominal": candidate.name == judgement.summary.nominal,
            }
            | {
                key: value
                for key, value in recorded_candidate.items()
                if key != "orders"
            }
            | {
                "criteria": chosen
                and chosen["total"] | {key: chosen[key] for key in _CRITERIA}
            }
            | {"fit": finite(fits.shown)}
        )
    return rows


def judge_in_processes(jobs: Sequence[Job], processes: int) -> Iterator[JobResult]:
    """Judge sessions in this many processes; yields outcomes as they complete.

    If a process dies (out of memory, for example), the sessions without an outcome are judged again one by
    one, which finds the one that caused it. Closing the iterator terminates the processes at once.
    """
    from concurrent.futures.process import BrokenProcessPool  # noqa: PLC0415

    jobs_left = {job.number: job for job in jobs}
    try:
        for outcome in _run_in_pool(jobs, min(processes, len(jobs))):
            del jobs_left[outcome.number]
            yield outcome
    except BrokenProcessPool:
        for job in jobs_left.values():
            try:
                yield from _run_in_pool([job], 1)
            except BrokenProcessPool:
                yield JobResult(
                    job.number, None, f"{job.path}: the process that judged it died"
                )


def _run_in_pool(jobs: Sequence[Job], processes: int) -> Iterator[JobResult]:
    from concurrent.futures import as_completed  # noqa: PLC0415

    with pool(processes) as workers:
        for future in as_completed([workers.submit(judge_job, job) for job in jobs]):
            yield future.result()


PATIENCE = 10.0
"""Timeout for the scheduler, and then for a first worker, s."""

_one_at_a_time = threading.Lock()


def judge_on_cluster(jobs: Sequence[Job], address: str) -> Iterator[JobResult]:
    """Judge sessions on the workers of a cluster; yields outcomes as they complete.

    Workers need the same version of this package and the sessions under the same paths; everything else, and
    all results, are sent by value. `address` is the scheduler's, such as "tcp://10.0.0.1:8786".
    """
    with contextlib.closing(_connect(address)) as client:
        _check_workers(client, address, [job.path for job in jobs])
        futures = {_submit(client, job): job for job in jobs}
        try:
            yield from _outcomes(client, address, futures)
        finally:
            with contextlib.suppress(Exception):  # the scheduler may have failed
                client.cancel(list(futures), force=True)


def _connect(address: str) -> Client:
    """A client of the scheduler at this address.

    Raises:
        ClusterError: it cannot be reached, or the library is not installed.
    """
    try:
        from distributed import Client  # noqa: PLC0415
        from distributed.comm import get_address_host_port  # noqa: PLC0415
    except ImportError as error:
        msg = f"--scheduler needs the package 'distributed' ({error}); pip install 'twinmatch[cluster]'"
        raise ClusterError(msg) from error
    # no tracebacks; failures are reported here
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        # with an invalid address the client would block for 20 s
        get_address_host_port(address)
        return Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        msg = f"scheduler {address}: cannot be reached ({_first_line(error)}); give it as tcp://HOST:PORT"
        raise ClusterError(msg) from error


def _check_workers(client: Client, address: str, paths: list[Path]) -> None:
    """Check that there are workers, with the same software, that can read sessions.

    Raises:
        ClusterError: there is no worker, or one of them cannot judge.
    """
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError as error:
        msg = f"scheduler {address}: has no workers; start some with: dask worker {address} --nthreads 1"
        raise ClusterError(msg) from error
    try:
        reports: dict[str, Any] = client.run(_look, paths)
    except ImportError as error:
        msg = f"scheduler {address}: a worker has no twinmatch ({error}); install it where the workers run"
        raise ClusterError(msg) from error
    for worker, (theirs, missing) in sorted(reports.items()):
        if theirs != software():
            msg = f"worker {worker}: has {theirs}; here it is {software()}; install the same on both"
            raise ClusterError(msg)
        if len(missing) == len(paths):
            msg = f"worker {worker}: cannot read {missing[0]}; sessions must have the same path there as here"
            raise ClusterError(msg)


def _look(paths: list[Path]) -> tuple[str, list[Path]]:
    """On a worker: its software, and the sessions it cannot read."""
    return software(), [path for path in paths if not path.exists()]


def _submit(client: Client, job: Job) -> Future:
    """Submit a job in a form that the scheduler handles without this package."""

    def judge_there(packed: bytes) -> tuple[Any, ...]:
        # local, so that it is sent by value
        from twinmatch.offline.archive.job import judge_packed  # noqa: PLC0415

        return judge_packed(packed)

    return client.submit(
        judge_there, pickle.dumps(job), key=f"twinmatch-{uuid4()}", pure=False
    )


def judge_packed(packed: bytes) -> tuple[Any, ...]:
    """On a worker: judge one session at a time, since the thread count of a BLAS is global."""
    from distributed import get_worker  # noqa: PLC0415

    with _one_at_a_time:
        job: Job = pickle.loads(packed)  # noqa: S301
        return tuple(judge_job(job, f" on worker {get_worker().address}"))


def _outcomes(
    client: Client, address: str, futures: dict[Future, Job]
) -> Iterator[JobResult]:
    """The outcomes of submitted jobs as they complete.

    Raises:
        ClusterError: the scheduler was lost.
    """
    from distributed import as_completed  # noqa: PLC0415

    for count, future in enumerate(as_completed(futures, loop=client.loop)):
        job = futures[future]
        if future.status == "finished":
            yield JobResult(*future.result())
        elif future.status == "error":
            error = future.exception()
            reason = (
                f"{job.path}: the cluster could not judge it ({_first_line(error)})"
            )
            yield JobResult(job.number, None, reason)
        else:
            msg = f"scheduler {address}: connection lost after {count} of {len(futures)} sessions"
            raise ClusterError(msg)


def _first_line(error: BaseException) -> str:
    """The first line of an error's message, or its type."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__
