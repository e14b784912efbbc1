"""Judges sessions on an existing Dask cluster."""

from __future__ import annotations

import contextlib
import logging
import pickle
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from twinmatch.offline.archive.files import ClusterError, software
from twinmatch.offline.archive.job import Job, JobResult, judge_job

if TYPE_CHECKING:
    from distributed import Client, Future

PATIENCE = 10.0
"""Timeout for the scheduler, and then for a first worker, s."""

_one_at_a_time = threading.Lock()


def judge_on_cluster(jobs: Sequence[Job], address: str) -> Iterator[JobResult]:
    """Judge sessions on the workers of a cluster; yields outcomes as they complete.

    Workers need the same version of this package and the sessions under the same paths; everything else, and
    all results, are sent by value.

    Args:
        jobs: the sessions.
        address: address of the scheduler, for example "tcp://10.0.0.1:8786".
    """
    with contextlib.closing(_connected(address)) as client:
        _check_workers(client, address, [job.path for job in jobs])
        futures = {_submit(client, job): job for job in jobs}
        try:
            yield from _outcomes(client, address, futures)
        finally:
            with contextlib.suppress(Exception):  # the scheduler may have failed
                client.cancel(list(futures), force=True)


def _connected(address: str) -> Client:
    try:
        from distributed import Client  # noqa: PLC0415 — rarely needed
        from distributed.comm import get_address_host_port  # noqa: PLC0415
    except ImportError as error:
        msg = f"--scheduler needs the package 'distributed' ({error}); pip install 'twinmatch[cluster]'"
        raise ClusterError(msg) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # no tracebacks; failures are reported here
    try:
        get_address_host_port(address)  # with an invalid address the client would block for 20 s
        return Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        msg = f"scheduler {address}: cannot be reached ({_line(error)}); give it as tcp://HOST:PORT"
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
            msg = f"worker {worker}: cannot read {missing[0]}; sessions must have the same path there as here"
            raise ClusterError(msg)


def _look(paths: list[Path]) -> tuple[str, list[Path]]:
    """On a worker: its software, and the sessions it cannot read."""
    return software(), [path for path in paths if not path.exists()]


def _submit(client: Client, job: Job) -> Future:
    """Submit a job in a form that the scheduler handles without this package."""

    def judge_there(packed: bytes) -> tuple[Any, ...]:  # local, so that it is sent by value
        from twinmatch.offline.archive.cluster import judge_packed  # noqa: PLC0415

        return judge_packed(packed)

    return client.submit(judge_there, pickle.dumps(job), key=f"twinmatch-{uuid4()}", pure=False)


def judge_packed(packed: bytes) -> tuple[Any, ...]:
    """On a worker: judge one session at a time, since the thread count of a BLAS is global."""
    from distributed import get_worker  # noqa: PLC0415

    with _one_at_a_time:
        job: Job = pickle.loads(packed)  # noqa: S301 — from the client whose code this worker runs anyway
        return tuple(judge_job(job, f" on worker {get_worker().address}"))


def _outcomes(client: Client, address: str, futures: dict[Future, Job]) -> Iterator[JobResult]:
    from distributed import as_completed  # noqa: PLC0415

    for done, future in enumerate(as_completed(futures, loop=client.loop)):
        job = futures[future]
        if future.status == "finished":
            yield JobResult(*future.result())
        elif future.status == "error":
            error = future.exception()
            reason = f"{job.path}: the cluster could not judge it ({_line(error)})"
            yield JobResult(job.number, None, reason)
        else:
            msg = f"scheduler {address}: connection lost after {done} of {len(futures)} sessions"
            raise ClusterError(msg)


def _line(error: BaseException) -> str:
    """The first line of an error's message, or its type."""
    return next(iter(str(error).splitlines()), "") or type(error).__name__
