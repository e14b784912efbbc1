"""Ctrl-C while compiled code runs, and processes beside this one."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Final, ParamSpec, TypeVar

from twinmatch.linear_algebra import ONE_THREAD

if TYPE_CHECKING:
    from concurrent.futures import Executor, ProcessPoolExecutor

P = ParamSpec("P")
R = TypeVar("R")

GARBAGE: Final = 500_000
"""Objects between two collections in a command that ends: imports, fits and figures make many objects, nearly
all of them still used or freed without a collection."""
LASTING_GARBAGE: Final = 50_000
"""Objects between two collections in a command that runs for days."""


class _DeferredInterrupt:
    """A handler of SIGINT that keeps the signal until somebody checks for it."""

    def __init__(self) -> None:
        self._interrupted = threading.Event()

    def __call__(self, *_: object) -> None:
        self._interrupted.set()

    def check(self) -> None:
        """Raise the deferred `KeyboardInterrupt`, if any."""
        if self._interrupted.is_set():
            raise KeyboardInterrupt


@contextlib.contextmanager
def held_interrupts() -> Iterator[Callable[[], None]]:
    """Defer Ctrl-C; the yielded function raises the deferred `KeyboardInterrupt`, if any.

    Python may raise it while a compiled loop converts its arguments or its result, where it is not handled:
    the loop then fails with another error, or the process crashes. A block inside another one defers for
    both, so the function of the inner one also raises a Ctrl-C from before it began.
    """
    if threading.current_thread() is not threading.main_thread():
        # only the main thread receives signals
        yield _DeferredInterrupt().check
        return
    before = signal.getsignal(signal.SIGINT)
    if isinstance(before, _DeferredInterrupt):
        yield before.check
        return
    deferred = _DeferredInterrupt()
    signal.signal(signal.SIGINT, deferred)
    try:
        yield deferred.check
    finally:
        signal.signal(signal.SIGINT, before)
    deferred.check()


def cores() -> int:
    """How many cores this process may use."""
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )


def can_be_copied() -> bool:
    """Whether this process can be forked: no other thread may hold a lock that the copy would wait for."""
    return sys.platform == "linux" and threading.active_count() == 1


@contextlib.contextmanager
def pool(processes: int, *, forked: bool = False) -> Iterator[ProcessPoolExecutor]:
    """This many processes; they are terminated at once if the block is left by an exception.

    They are spawned unless `forked`: a fork needs no imports, but copies the locks that other threads hold.
    Ctrl-C is handled by this process only.
    """
    import multiprocessing  # noqa: PLC0415
    from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415

    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("fork" if forked else "spawn")
    executor = ProcessPoolExecutor(processes, mp_context=context, initializer=_begin)
    finished = False
    try:
        # inherited by the new processes
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            executor.submit(os.getpid)  # the first task starts them
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        yield executor
        finished = True
    finally:
        if not finished:
            for process in set(multiprocessing.active_children()) - before:
                process.terminate()
        executor.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Set up a process: one thread of linear algebra, before numpy is imported; it ends with its parent."""
    os.environ.update(ONE_THREAD)
    gc.set_threshold(GARBAGE)
    end_with_parent()


def end_with_parent() -> None:
    """From now on this process ends when the one that started it does, however that ends."""
    from multiprocessing import parent_process  # noqa: PLC0415

    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    from multiprocessing.connection import wait  # noqa: PLC0415

    wait([sentinel])
    os._exit(1)


class Beside:
    """Work that this process does not wait for, done in turn by a second process, if there is one."""

    def __init__(self, second: Executor | None = None) -> None:
        self._second = second

    def give(
        self, task: Callable[P, R], *args: P.args, **kwargs: P.kwargs
    ) -> Callable[[], R]:
        """Give a task; the function returned gives its result.

        A task that the second process has not begun by then, or has died of, is done by the caller. So both
        processes have work if results are asked for from last to first.
        """
        in_this_process = partial(task, *args, **kwargs)
        if self._second is None:
            return in_this_process
        from concurrent.futures.process import BrokenProcessPool  # noqa: PLC0415

        try:
            future = self._second.submit(task, *args, **kwargs)
        except BrokenProcessPool:
            return in_this_process

        def result() -> R:
            try:
                return in_this_process() if future.cancel() else future.result()
            except BrokenProcessPool:
                return in_this_process()

        return result


@contextlib.contextmanager
def beside(*, possible: bool = True) -> Iterator[Beside]:
    """A second process, a copy of this one; none on a single core, where it is not `possible`, or if another
    thread may hold a lock that the copy would wait for."""
    if not (possible and cores() > 1 and can_be_copied()):
        yield Beside()
        return
    with pool(1, forked=True) as second:
        yield Beside(second)
