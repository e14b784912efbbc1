"""Start nodes, run them, end them.

Three properties of rclpy determine this design. The events executor needs a fifth of the processor time of
the others, but its own `spin` never returns, so it is driven step by step; where rclpy lacks it, the
single-threaded executor is used. With rclpy's signal handlers a SIGTERM is occasionally lost, so the handlers
are ours and only set a flag. And closing Fast DDS can live-lock while holding the interpreter's lock, so that
none of our threads could end it; a kernel alarm does.
"""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from threading import Event
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from twinmatch.ending import end_in_order
from twinmatch.errors import TwinmatchError
from twinmatch.nodes import network
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.step import InStep, step_of
from twinmatch.parameters.declared import render
from twinmatch.printing import printable_output
from twinmatch.sessions.documents import DocumentError, read_yaml

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:
    # Jazzy before rclpy 7.1.4, or a release that moves what is experimental
    EventsExecutor = SingleThreadedExecutor

EXIT_DEFECT = 1
"""Exit code after a defect of the program; its traceback is printed."""

TEARDOWN = 5
"""Time the end may take before the kernel ends the process (exit by SIGALRM), s."""

STEP = 0.1
"""Longest wait of the executor between two checks of the flag, s."""


class RunnerError(TwinmatchError):
    """The command line of a node cannot be used."""


def run(
    kinds: Sequence[type[TwinmatchNode]], arguments: Sequence[str] | None = None
) -> int:
    """Run nodes in this process until one of them finishes or a signal arrives.

    SIGINT and SIGTERM are ignored from then on: a second one, while Python shuts down, would make a clean
    end look like a crash.

    Args:
        kinds: classes of the nodes, one node each.
        arguments: the command line with the program's name, `sys.argv` if not given.

    Returns:
        The exit code: 0 after a signal, that of the node that finished, `EXIT_USER_ERROR` after a
        `TwinmatchError` (its one line is on stderr), `EXIT_DEFECT` after any other error.
    """
    with printable_output():
        return _run(kinds, list(sys.argv if arguments is None else arguments))


def _run(kinds: Sequence[type[TwinmatchNode]], arguments: list[str]) -> int:
    # A client that cannot be answered has gone, or was not yet connected and asks again.
    warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)
    stop = Event()
    _on_signals(lambda *_: stop.set())
    nodes = Nodes()
    code: int | None = None
    try:
        _check_parameter_files(arguments)
        unknown = _unknown_arguments(arguments)
        if {"-h", "--help"} & set(unknown):
            print(_help(kinds))
            return 0
        if unknown:
            raise RunnerError(
                f"{_program(arguments)}: unknown argument {unknown[0]}; see --help"
            )
        nodes.start(kinds, arguments)
        while code is None and not stop.is_set():
            code = nodes.spin_once()
        nodes.linger()
    except TwinmatchError as error:
        print(error, file=sys.stderr, flush=True)
        code = error.NODE_EXIT
    except Exception:
        traceback.print_exc()
        code = EXIT_DEFECT
    _on_signals(signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(TEARDOWN + nodes.closing)
    try:
        all_ended = nodes.close()
    except Exception:
        traceback.print_exc()
        all_ended = False
        code = EXIT_DEFECT
    if not all_ended:  # a thread that continues would be torn down with the interpreter
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code or 0)
    signal.alarm(0)
    return code or 0


class Nodes:
    """Nodes that run together, and their executor."""

    def __init__(self, context: Context | None = None) -> None:
        """Nothing is created before `start`; without a `context` it is that of the process."""
        self._context = context
        self.nodes: list[TwinmatchNode] = []
        """Those that have been created, in their order."""
        self._executor: Any = None  # created once ROS has started
        self._step: InStep | None = None

    @property
    def closing(self) -> int:
        """Time that `close` may take besides `TEARDOWN`, s."""
        return max((node.CLOSING for node in self.nodes), default=0)

    @property
    def has_executor(self) -> bool:
        """Whether callbacks may still be run."""
        return self._executor is not None

    def start(
        self, kinds: Sequence[type[TwinmatchNode]], arguments: Sequence[str]
    ) -> None:
        """Start ROS with a command line, and create and open the nodes.

        Raises:
            TwinmatchError: the nodes cannot run like this.
        """
        reach = network.prepare()
        with _clear_errors(arguments):
            options = SignalHandlerOptions.NO
            words = [*arguments, *network.log_arguments()]
            rclpy.init(
                args=words, context=self._context, signal_handler_options=options
            )
        self._executor = executor_of(self._context)
        for kind in kinds:
            node = kind(self._context)
            self.nodes.append(node)
            self._step = self._step or step_of(node)
            node.step = self._step
            node.open()
            self._executor.add_node(node)
        if reach is network.Network.LOOPBACK:
            network.check_sockets()

    def spin_once(self) -> int | None:
        """Let the nodes work for a moment; returns the exit code once one of them has finished.

        Raises:
            Exception: what ended a node.
        """
        self._executor.spin_once(timeout_sec=STEP)
        for part in (*self.nodes, self._step):
            if part is not None and part.failure is not None:
                raise part.failure
        ended = [node.exit_code for node in self.nodes if node.exit_code is not None]
        return ended[0] if ended and not any(node.busy for node in self.nodes) else None

    def linger(self) -> None:
        """Let the nodes take what was sent before the end and has not reached their callbacks yet."""
        until = time.monotonic() + max(
            (node.LINGER for node in self.nodes), default=0.0
        )
        while time.monotonic() < until:
            self.spin_once()

    def close(self) -> bool:
        """End everything, in the order in which every process of nodes ends; nothing of ROS is left then.

        What calls ROS from other threads is ended and joined first, then the executor, whose queue refers to
        the nodes, then the nodes, whose parts belong to the context, which is the last.

        Returns:
            Whether all threads ended.

        Raises:
            Exception: a part failed to end; the others have been ended nonetheless.
        """
        return end_in_order(
            self._end_threads,
            self._stop_executor,
            self._destroy_nodes,
            self._shut_context_down,
        )

    def _end_threads(self) -> bool:
        """End sources, workers and connections, and join their threads."""
        steps = [] if self._step is None else [self._step.close]
        return end_in_order(*steps, *(node.close for node in self.nodes))

    def _stop_executor(self) -> None:
        if self.has_executor:
            for node in self.nodes:
                self._executor.remove_node(node)
            self._executor.shutdown(timeout_sec=1.0)
            self._executor = None

    def _destroy_nodes(self) -> None:
        end_in_order(*(node.destroy_node for node in self.nodes))
        self.nodes.clear()

    def _shut_context_down(self) -> None:
        rclpy.try_shutdown(context=self._context)
        gc.collect()  # remaining references to a node would hold shared memory


def executor_of(context: Context | None) -> Any:
    """The executor for the nodes of a context."""
    return EventsExecutor(context=context)


def _on_signals(handler: Any) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _unknown_arguments(arguments: list[str]) -> list[str]:
    with _clear_errors(arguments):
        return list(remove_ros_args(arguments)[1:])


def _check_parameter_files(arguments: list[str]) -> None:
    """Read the parameter files before ROS does, which blocks on pipes and gives poor error messages."""
    for option, path in pairwise(arguments):
        if option == "--params-file":
            try:
                read_yaml(Path(path))
            except DocumentError as error:
                raise RunnerError(f"{_program(arguments)}: {error}") from error


@contextmanager
def _clear_errors(arguments: Sequence[str]) -> Iterator[None]:
    """Turn rcl's argument errors into `RunnerError`, without positions in rcl's sources."""
    try:
        yield
    except Exception as error:  # rclpy gives these errors no public names
        cause = re.sub(r",? at /\S+", "", str(error))
        cause = re.sub(
            r"^(failed to initialize rcl|Failed to parse ROS arguments): ", "", cause
        )
        raise RunnerError(f"{_program(arguments)}: {cause}") from error


def _program(arguments: Sequence[str]) -> str:
    return Path(arguments[0]).stem if arguments else "twinmatch"


def _help(kinds: Sequence[type[TwinmatchNode]]) -> str:
    lines = [
        "usage: <node> [--ros-args --params-file FILE -p name:=value -r from:=to -r __ns:=/rig]",
        "Parameters and their defaults, as a parameter file:",
        "",
    ]
    lines += [render(kind.NAME, kind.table_for({})[0]) for kind in kinds]
    return "\n".join(lines)
