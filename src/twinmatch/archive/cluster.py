"""Judges sessions on a Dask cluster that somebody else runs."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twinmatch.archive.errors import ClusterError
from twinmatch.archive.fingerprint import software
from twinmatch.archive.job import Job, Outcome, judge

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["judge_on_cluster"]

PATIENCE = 10.0
"""How long to wait for the scheduler, and then for a first worker, s."""

_one_at_a_time = threading.Lock()


def judge_on_cluster(jobs: Sequence[Job], address: str) -> Iterator[Outcome]:
    """Judge sessions on the workers of a cluster; outcomes come as they are ready.

    Workers need this package in the same version and the sessions under the same paths; the rest, and all
    results, travel by value.

    Args:
        jobs: the sessions.
        address: of the scheduler, for example "tcp://10.0.0.1:8786".

    Raises:
        ClusterError: `distributed` is not installed, there is no scheduler at the address, it has no
            workers, one has other software, none reaches the sessions, or the scheduler went away.
    """
    with contextlib.closing(_connected(address)) as client:
        _check_workers(client, address, [job.path for job in jobs])
        futures = {_submit(client, job): job for job in jobs}
        try:
            yield from _outcomes(address, futures)
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be what failed
                client.cancel(list(futures), force=True)


def _connected(address: str) -> Client:
    try:
        from distributed import Client  # noqa: PLC0415 — only who has a cluster needs it
    except ImportError as error:
        msg = f"--scheduler needs the package 'distributed' ({error}); pip install 'twinmatch[cluster]'"
        raise ClusterError(msg) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # its tracebacks; failures are named here
    try:
        return Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # TypeError: an address without a port
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        msg = f"scheduler {address}: cannot be reached ({reason}); give it as tcp://HOST:PORT"
        raise ClusterError(msg) from error


def _check_workers(client: Client, address: str, paths: list[Path]) -> None:
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError as error:
        msg = f"scheduler {address}: has no workers; start some with: dask worker {address} --nthreads 1"
        raise ClusterError(msg) from error
    try:
        found: dict[str, Any] = client.run(_look, paths)
    except ImportError as error:
        msg = f"scheduler {address}: a worker has no twinmatch ({error}); install it where the workers run"
        raise ClusterError(msg) from error
    for worker, (theirs, missing) in sorted(found.items()):
        if theirs != software():
            msg = f"worker {worker}: has {theirs}; here it is {software()}; install the same on both"
            raise ClusterError(msg)
        if len(missing) == len(paths):
            msg = f"worker {worker}: cannot see {missing[0]}; sessions must have the same path there as here"
            raise ClusterError(msg)


def _look(paths: list[Path]) -> tuple[str, list[Path]]:
    """On a worker: its software, and which of the sessions it cannot see."""
    return software(), [path for path in paths if not path.exists()]


def _submit(client: Client, job: Job) -> Future:
    return client.submit(
        _judge_there, job, key=f"twinmatch-{job.path.name}-{job.number}-{id(job)}", pure=False
    )


def _judge_there(job: Job) -> Outcome:
    """On a worker: one session at a time, since what sets the threads of a BLAS sets them for all."""
    from distributed import get_worker  # noqa: PLC0415

    with _one_at_a_time:
        return judge(job, f" on worker {get_worker().address}")


def _outcomes(address: str, futures: dict[Future, Job]) -> Iterator[Outcome]:
    from distributed import as_completed  # noqa: PLC0415

    for done, future in enumerate(as_completed(futures)):
        job = futures[future]
        if future.status == "finished":
            yield Outcome(*future.result())
        elif future.status == "error":
            reason = f"{job.path}: its workers died ({type(future.exception()).__name__})"
            yield Outcome(job.number, None, reason)
        else:
            msg = f"scheduler {address}: went away after {done} of {len(futures)} sessions"
            raise ClusterError(msg)
