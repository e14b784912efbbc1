"""A process that waits for its child and ends as it does; the child has the memory of a process between them.

What a process imports from a library's file stays mapped into it, page by page, as long as it lives: of LLVM
more than all that a launcher needs itself. A fork has the memory that was written, and not these pages. So
what imports ends, and its child continues.
"""

from __future__ import annotations

import errno
import os
import signal
from collections.abc import Callable
from contextlib import suppress
from typing import Final, NoReturn

from twinmatch.launching.forking import (
    adopt_no_orphans,
    adopt_orphans,
    become_child_of,
)

_PASSED_ON: Final = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGQUIT,
    signal.SIGUSR1,
    signal.SIGUSR2,
)
"""Signals that the child receives if they are sent to this process."""
_LONGEST: Final = 32
"""Longest number of a process, with room, characters."""


def continue_in_child(prepare: Callable[[], None]) -> None:
    """Return in a child that has the memory of what `prepare` has done.

    This process does not return: it passes signals on, and ends as its child does. It keeps its number, and all
    have one terminal. If `prepare` ends its process, this one ends so, too.

    Raises:
        PermissionError: the kernel gives this process no children of others.
    """
    waiting = os.getpid()
    blocked_before = signal.pthread_sigmask(
        signal.SIG_BLOCK, {signal.SIGCHLD, *_PASSED_ON}
    )
    adopt_orphans()
    reading, writing = os.pipe()
    preparing = os.fork()
    if preparing:
        os.close(writing)
        _wait_for_both(preparing, reading)
    os.close(reading)
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked_before)
    prepare()
    if os.fork():
        os._exit(0)  # its child becomes one of the process that waits
    is_adopted = become_child_of(waiting)
    os.write(writing, str(os.getpid() if is_adopted else 0).encode())
    os.close(writing)
    if not is_adopted:
        os._exit(1)


def _wait_for_both(preparing: int, reading: int) -> NoReturn:
    """Wait for the process that prepares, then for its child, and end as they do.

    What did not end the process that prepares reached it too late, as it was ending already: that is for its child.
    """
    status, passed_on = _status_of(preparing)
    if status:
        _end_with(status)
    child = int(os.read(reading, _LONGEST) or 0)
    os.close(reading)
    adopt_no_orphans()
    if not child:
        raise PermissionError(
            errno.EPERM, "the kernel gives this process no children of others"
        )
    for number in passed_on:
        _pass_on(child, number)
    status, _ = _status_of(child)
    _end_with(status)


def _status_of(child: int) -> tuple[int, list[int]]:
    """How a child has ended, once it has, and the signals that were passed on to it until then."""
    passed_on: list[int] = []
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return status, passed_on
        received = signal.sigwaitinfo({signal.SIGCHLD, *_PASSED_ON})
        # what comes from the terminal, and not from a process, comes to the child as well
        is_sent = received.si_code <= 0
        if received.si_signo != signal.SIGCHLD and is_sent:
            passed_on.append(received.si_signo)
            _pass_on(child, received.si_signo)


def _pass_on(child: int, number: int) -> None:
    """Send a signal to a child; one that has ended needs none."""
    with suppress(ProcessLookupError):
        os.kill(child, number)


def _end_with(status: int) -> NoReturn:
    """End this process with an exit code, or by a signal."""
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        with suppress(OSError):  # SIGKILL has no handler
            signal.signal(-code, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, set())
        os.kill(os.getpid(), -code)
    os._exit(code)
