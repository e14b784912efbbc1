"""Programs forked from a process that has imported what they need.

Imports are most of a node's start: forked, it needs a fifth of the processor time and shares the memory of
what was imported. The fork server has one thread, knows no ROS context and keeps nothing of what it started:
a program is the child of the process that asked for it, and is signalled, waited for and ended with it like
any other child.
"""

from __future__ import annotations

import atexit
import ctypes
import errno
import gc
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Mapping
from enum import IntEnum
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Final

from twinmatch.launching.tracer import tell_tracer_of_forks
from twinmatch.linear_algebra import ONE_THREAD
from twinmatch.nodes import problem

IMPORTED: Final = (
    "twinmatch.nodes.camera_bridge",
    "twinmatch.nodes.keeper",
    "twinmatch.nodes.player",
    "twinmatch.nodes.plant_clock",
    "twinmatch.nodes.pwm_bridge",
    "twinmatch.nodes.recorder",
    "twinmatch.nodes.twin",
    "twinmatch.cli.virtual_rig",
    "email.parser",
    "numpy.ma",
    "rosidl_generator_py",
    "service_msgs.msg",
    "type_description_interfaces.msg",
)
"""What most programs of a graph import: `email.parser` when they ask for the version of the compiler, `numpy.ma`
when numba looks at an array, the last three when rclpy creates a node (a parser of message types). Others import
the rest themselves."""
_MAX_LINE: Final = 1 << 17
"""Longest request, bytes."""
_POLL: Final = 0.01
"""Interval between two looks at a child that is waited for, s."""
_MOMENT: Final = 0.0005
"""Interval between two looks at who the parent is, s."""
ENVIRONMENT: Final = {
    **ONE_THREAD,
    "PYTHONUNBUFFERED": "1",
}
"""Variables of a process that programs are forked from. The matrices are small, and a process with threads
cannot be forked safely. Unbuffered, a program's lines arrive when they are written."""
_LIBC: Final = ctypes.CDLL(None, use_errno=True)


class _Prctl(IntEnum):
    """What `prctl` sets of a process; the numbers are those of linux/prctl.h."""

    DEATH_SIGNAL_OF_PARENT = 1
    NAME = 15
    CHILD_SUBREAPER = 36


def name_process(name: str) -> None:
    """Name this process as `ps -o comm` shows it, by its first 15 bytes."""
    _LIBC.prctl(_Prctl.NAME, name.encode()[:15])


class Forked:
    """A child of this process that a fork server made, with what is used of `subprocess.Popen`."""

    def __init__(self, words: list[str], process: int) -> None:
        self.args = words
        self.pid = process
        self.returncode: int | None = None
        """Exit code; negative: the signal that ended it; None while it runs."""

    def poll(self) -> int | None:
        """The exit code, if it has ended."""
        if self.returncode is None:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
            if ended:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, once it has ended.

        Raises:
            TimeoutExpired: it runs longer than `timeout` (s).
        """
        until = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until is not None and time.monotonic() > until:
                raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
            time.sleep(_POLL)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill it."""
        self.send_signal(signal.SIGKILL)


def begun_server() -> tuple[socket.socket, Forked | subprocess.Popen[bytes]]:
    """Start a process that imports and then serves; returns our end of its connection, and the process."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            env={**os.environ, **ENVIRONMENT},
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
    return ours, process


class ForkServer:
    """A process that forks programs for this one."""

    def __init__(
        self,
        begun: tuple[socket.socket, Forked | subprocess.Popen[bytes]] | None = None,
    ) -> None:
        """Start it; it imports while this process continues, and ends with it.

        Args:
            begun: our end of the connection with one that was started already, and its process.
        """
        self._asking = threading.Lock()
        self._socket, self._process = begun or begun_server()

    @property
    def pid(self) -> int:
        """Number of its process."""
        return self._process.pid

    def start(
        self,
        *words: str,
        output: int,
        environment: Mapping[str, str],
        folder: Path | None = None,
    ) -> Forked:
        """Start a program; a server that was killed is replaced.

        Args:
            words: `-m`, a module and its arguments, or a script and its arguments.
            output: file descriptor for what it prints, errors included.
            environment: all of its environment.
            folder: where it works; by default, where this process does.

        Raises:
            OSError: no process can be made.
        """
        asked = [os.getpid(), words, dict(environment), str(folder or Path.cwd())]
        with self._asking:
            if self._process.poll() is not None:
                self._socket.close()
                self._socket, self._process = begun_server()
            # so that the new process becomes a child of this one
            adopt_orphans()
            try:
                socket.send_fds(self._socket, [json.dumps(asked).encode()], [output])
                answer = self._socket.recv(_MAX_LINE)
            finally:
                adopt_no_orphans()
        if not answer:
            raise BrokenPipeError(errno.EPIPE, "the fork server has ended")
        if not int(answer):
            raise PermissionError(
                errno.EPERM, "the kernel gives this process no children of others"
            )
        return Forked(list(words), int(answer))

    def close(self) -> None:
        """End it, at once; the programs continue."""
        self._socket.close()
        self._process.kill()
        self._process.wait()


_servers: Final[list[ForkServer]] = []
"""The fork server of this process, once it has one."""


def fork_server() -> ForkServer:
    """The fork server of this process; it starts to import when this is first called."""
    if not _servers:
        use_fork_server(ForkServer())
    return _servers[0]


def has_fork_server() -> bool:
    """Whether this process has a fork server already."""
    return bool(_servers)


def use_fork_server(server: ForkServer) -> None:
    """Let this be the fork server of this process, until it ends."""
    _servers.append(server)
    atexit.register(server.close)


def serve(connection: socket.socket) -> list[str]:
    """Fork for the process at the other end, until it is closed or no process can be made.

    Returns:
        In a new process, the words of its program; in the server none, at the end.
    """
    while True:
        request, outputs, *_ = socket.recv_fds(connection, _MAX_LINE, 1)
        if not request:
            return []
        between = os.fork()
        if between == 0:
            if os.fork():
                os._exit(0)  # its child becomes one of the process that asks
            parent, *asked = json.loads(request)
            adopted = become_child_of(parent)
            connection.send(str(os.getpid() if adopted else 0).encode())
            connection.close()
            if not adopted:
                os._exit(1)
            return _prepare(outputs[0], *asked)
        if os.waitpid(between, 0)[1]:
            return []
        os.close(outputs[0])


def adopt_orphans() -> None:
    """Become the parent of all descendants whose parents end, from now on."""
    _LIBC.prctl(_Prctl.CHILD_SUBREAPER, 1)


def adopt_no_orphans() -> None:
    """Leave descendants whose parents end to the first process again, from now on; those adopted stay."""
    _LIBC.prctl(_Prctl.CHILD_SUBREAPER, 0)


def become_child_of(parent: int) -> bool:
    """Wait until the parent of this process has ended; returns whether `parent` has taken it over.

    The kernel sends this process SIGTERM when that one ends.
    """
    between = os.getppid()
    while os.getppid() == between != parent:
        time.sleep(_MOMENT)
    _LIBC.prctl(_Prctl.DEATH_SIGNAL_OF_PARENT, signal.SIGTERM)
    return os.getppid() == parent  # unless it died before the line above


def _prepare(
    output: int, words: list[str], environment: dict[str, str], folder: str
) -> list[str]:
    """Make this process what a new program finds."""
    os.setsid()
    for place in (1, 2):
        os.dup2(output, place)
    os.close(output)
    os.environ.clear()
    os.environ.update(environment)
    # the interpreter reads it when it starts, which here was long ago
    sys.dont_write_bytecode = bool(environment.get("PYTHONDONTWRITEBYTECODE"))
    os.chdir(folder)
    name = words[2] if words[0] == "-m" and len(words) > 2 else words[0]
    name_process(Path(name).name)
    return words


def _show(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Show what has ended a program, but for Ctrl-C while it still imported."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)


def import_for_programs() -> None:
    """Import what programs need, and do what each of them would do first."""
    for name in IMPORTED:
        import_module(name)
    from twinmatch.compiled import start_runtime  # noqa: PLC0415

    start_runtime()
    tell_tracer_of_forks()
    # Python counts the threads of the tracer, too.
    warnings.filterwarnings(
        "ignore", ".*multi-threaded, use of fork", DeprecationWarning
    )
    gc.collect()
    gc.freeze()  # what is shared stays shared


def main() -> None:
    """The fork server, and each program that it forks."""
    if problem():  # which the launcher tells
        return
    import_for_programs()
    serve_and_run(socket.socket(fileno=int(sys.argv[1])))


def serve_and_run(connection: socket.socket) -> None:
    """Fork for the process at the other end of a connection, and in each new process run its program."""
    sys.excepthook = _show
    words = serve(connection)
    if words:
        run_program(words)


def run_program(words: list[str]) -> None:
    """Run what `python WORDS` would: `-m`, a module and its arguments, or a script and its arguments."""
    if words[0] == "-m":
        sys.argv = words[1:]
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv = words
        runpy.run_path(words[0], run_name="__main__")


if __name__ == "__main__":
    main()
