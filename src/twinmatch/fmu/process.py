"""The process of an FMU, seen from its parent: started, sent messages, and killed on a timeout.

A message is a header in JSON, then numbers. Nothing that is read here can become code, since the other
process runs an untrusted program. The arguments of a kernel, and its results, are a tree in the header whose
arrays follow it. Each process has a mark in its environment, which everything it starts
inherits; so programs that outlive it or left its process group are found and ended. Build servers find the
remains of a build in the same way.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
import select
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.fmu.archive import FmuError
from twinmatch.linear_algebra import ONE_THREAD

MAX_HEADER: Final = 1 << 27
MAX_NUMBERS: Final = 1 << 27
"""Largest header, and largest block of numbers after it, bytes."""

_LENGTHS: Final = struct.Struct("<II")
_SIZES: Final = {"<f8": 8, "<i8": 8, "|b1": 1}
"""Bytes of a number of each kind."""
MARK: Final = "TWINMATCH_FMU"
"""Environment variable with the mark."""
_ROUNDS: Final = 20
"""Most searches: a process that is found may just have started another one."""
START: Final = 120.0
"""Time limit for the start on a busy machine, including the first compilation, s."""
_KEPT: Final = (
    "PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "PYTHONPATH", "VIRTUAL_ENV",
    "TWINMATCH_CACHE", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR",
)  # fmt: skip
"""Environment variables passed to the FMU's process."""


class FmuMessageError(Exception):
    """The received bytes are not a valid message."""


class ProcessMessage(NamedTuple):
    """A header, and arrays."""

    header: Mapping[str, Any]
    arrays: Sequence[NDArray[Any]]


def tree_of(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Numbers, arrays, and tuples of them as a tree for JSON; the arrays are added to the list."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, tuple):
        kind = (
            ""
            if type(value) is tuple
            else f"{type(value).__module__}:{type(value).__name__}"
        )
        return [kind, *(tree_of(member, arrays) for member in value)]
    return value.item() if isinstance(value, np.generic) else value


def value_of(
    tree: Any, arrays: Sequence[NDArray[Any]], kind_of: Callable[[str], Any]
) -> Any:
    """The value of such a tree; `kind_of` gives the class of a named tuple.

    Raises:
        FmuMessageError: the tree cannot be read.
    """
    try:
        if isinstance(tree, dict):
            return arrays[tree["array"]]
        if isinstance(tree, list):
            values = [value_of(member, arrays, kind_of) for member in tree[1:]]
            return kind_of(tree[0])._make(values) if tree[0] else tuple(values)
    except (IndexError, KeyError, TypeError) as error:
        raise FmuMessageError(f"values that cannot be read: {error}") from error
    return tree


def packed(header: Mapping[str, Any], arrays: Sequence[NDArray[Any]] = ()) -> bytes:
    """Encode a message."""
    shapes = [[array.dtype.str, list(array.shape)] for array in arrays]
    head = json.dumps({**header, "arrays": shapes}).encode()
    body = b"".join(array.tobytes() for array in arrays)
    return _LENGTHS.pack(len(head), len(body)) + head + body


def unpacked(read: Callable[[int], bytes]) -> ProcessMessage:
    """Decode a message; `read` returns the requested number of bytes.

    Raises:
        FmuMessageError: the bytes are not a valid message.
    """
    size, numbers = _LENGTHS.unpack(read(_LENGTHS.size))
    if size > MAX_HEADER or numbers > MAX_NUMBERS:
        raise FmuMessageError(f"a message of {size} and {numbers} bytes")
    try:
        header = json.loads(read(size))
        shapes = [
            (_SIZES[kind], kind, tuple(map(int, shape)))
            for kind, shape in header.pop("arrays")
        ]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FmuMessageError(f"a header that cannot be read: {error}") from error
    body = read(numbers)
    arrays = []
    place = 0
    for size, kind, shape in shapes:
        count = math.prod(shape)
        if min(shape, default=0) < 0 or place + size * count > len(body):
            raise FmuMessageError(f"an array of shape {shape} in {len(body)} bytes")
        arrays.append(np.frombuffer(body, kind, count, place).reshape(shape).copy())
        place += size * count
    return ProcessMessage(header, arrays)


def end_marked(mark: str) -> None:
    """Kill all other processes with this mark in their environment."""
    wanted = f"{MARK}={mark}".encode()
    for _ in range(_ROUNDS):
        processes = _processes_with(wanted)
        if not processes:
            return
        for process in processes:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(process, signal.SIGKILL)


def _processes_with(wanted: bytes) -> list[int]:
    processes = []
    for folder in Path("/proc").glob("[0-9]*"):
        if int(folder.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # it has ended, or belongs to another user
            if wanted in (folder / "environ").read_bytes().split(b"\0"):
                processes.append(int(folder.name))
    return processes


def started(folder: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """The program of `worker.py`, started in a folder."""
    return subprocess.Popen(
        [sys.executable, "-m", "twinmatch.fmu.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=folder,
        env=environment,
        start_new_session=True,
    )


class ProcessLostError(Exception):
    """The process gave no valid answer, and has been killed."""


class FmuProcess:
    """One process for one FMU; requests from several threads are serialised."""

    def __init__(self) -> None:
        """Start the process, with its own folder, which is deleted when the process ends.

        Raises:
            FmuError: the package that reads FMUs is not installed.
        """
        if find_spec("fmpy") is None:
            raise FmuError(
                "FMUs need fmpy, which is not installed; pip install 'twinmatch[fmu]'"
            )
        self._folder = tempfile.TemporaryDirectory(prefix="twinmatch-fmu-")
        self.folder = Path(self._folder.name)
        self._lock = threading.Lock()
        mark = secrets.token_hex(16)
        self._process = started(self.folder, {**_environment(), MARK: mark})
        self._ended = weakref.finalize(self, _end, self._process, self._folder, mark)
        self._first = True

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def ask(
        self,
        header: Mapping[str, Any],
        arrays: Sequence[NDArray[Any]] = (),
        *,
        limit: float,
    ) -> ProcessMessage:
        """Send a request and return the answer, within `limit` seconds, plus `START` for the first one and
        where a kernel is compiled or loaded first.

        Raises:
            ProcessLostError: there was no answer, or an unreadable one; the process has been killed.
            FmuError: the FMU or its process reports an error.
        """
        with self._lock:
            if not self._ended.alive:
                raise ProcessLostError("its process was killed earlier")
            whole = limit + (START if self._first else 0.0)
            deadline = time.monotonic() + whole
            self._first = False
            try:
                self._write(packed({**header, "limit": whole}, arrays), deadline)
                message = unpacked(lambda size: self._read(size, deadline))
                if "loading" in message.header:  # a kernel, before it runs
                    unpacked(lambda size: self._read(size, deadline + START))
                    deadline = time.monotonic() + limit
                    message = unpacked(lambda size: self._read(size, deadline))
            except TimeoutError:
                self.close()
                raise ProcessLostError(
                    f"it gave no answer within {limit:g} s and was killed"
                ) from None
            except (FmuMessageError, OSError) as error:
                raise ProcessLostError(self._cause(error)) from None
        if "error" in message.header:
            raise FmuError(str(message.header["error"]))
        return message

    def close(self) -> None:
        """Kill the process, if it is still running."""
        self._ended()

    def _cause(self, error: Exception) -> str:
        """Why the process was lost, as far as it can be determined."""
        code: int | None = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(0.5)
        self.close()
        if code is None:
            return f"it wrote an invalid answer ({error}) and was killed"
        if code < 0:
            return f"its process crashed ({signal.Signals(-code).name})"
        return f"its process exited with code {code}"

    def _write(self, data: bytes, deadline: float) -> None:
        handle = self._process.stdin.fileno()  # type: ignore[union-attr]
        os.set_blocking(handle, False)
        unwritten = memoryview(data)
        while unwritten:
            _wait(handle, select.POLLOUT, deadline)
            unwritten = unwritten[os.write(handle, unwritten[: 1 << 16]) :]

    def _read(self, size: int, deadline: float) -> bytes:
        handle, data = self._process.stdout.fileno(), bytearray()  # type: ignore[union-attr]
        while len(data) < size:
            _wait(handle, select.POLLIN, deadline)
            part = os.read(handle, min(size - len(data), 1 << 20))
            if not part:
                raise FmuMessageError("its answer ended early")
            data += part
        return bytes(data)


def _wait(handle: int, event: int, deadline: float) -> None:
    time_left = deadline - time.monotonic()
    poll = select.poll()  # a node may have more open files than select supports
    poll.register(handle, event)
    if time_left <= 0 or not poll.poll(min(1000.0 * time_left, 1e9)):
        # beyond, poll overflows
        raise TimeoutError


def _environment() -> dict[str, str]:
    environment = {name: os.environ[name] for name in _KEPT if name in os.environ}
    # The other process can import whatever this one can.
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    return {
        **environment,
        **ONE_THREAD,
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def _end(
    process: subprocess.Popen[bytes],
    folder: tempfile.TemporaryDirectory[str],
    mark: str,
) -> None:
    """Kill the process and all that it started, and delete its folder."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    end_marked(mark)
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    with contextlib.suppress(OSError):
        folder.cleanup()
