"""Judges sessions in processes on this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait

from twinmatch.offline.archive.job import Job, Outcome, judge, prepare

__all__ = ["cores", "judge_in_processes"]


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def judge_in_processes(jobs: Sequence[Job], processes: int) -> Iterator[Outcome]:
    """Judge sessions in this many processes; yields outcomes as they complete.

    Processes are spawned, not forked, since a fork would copy locked locks. If one dies (out of memory, for
    example), the sessions without an outcome are judged again one by one, which finds the one that caused it.
    Closing the iterator terminates the processes at once.
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
                yield Outcome(job.number, None, f"{job.path}: the process that judged it died")


def _pooled(jobs: Sequence[Job], processes: int) -> Iterator[Outcome]:
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_begin)
    finished = False
    try:
        with _interrupts_held():  # inherited by the new processes: Ctrl-C is handled by this process only
            futures: list[Future[Outcome]] = [pool.submit(judge, job) for job in jobs]
        for future in as_completed(futures):
            yield future.result()
        finished = True
    finally:
        if not finished:
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Block SIGINT within this context; processes started in it never receive it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Set up a process; it exits when its parent does."""
    prepare()
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
