"""The process of an FMU as the one that asks sees it: started, asked, and ended when it takes too long."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from twinmatch.fmu.errors import FmuError
from twinmatch.fmu.wire import Message, WireError, packed, unpacked
from twinmatch.signals import FloatArray

__all__ = ["FmuProcess", "ProcessLostError"]

START: Final = 120.0
"""Seconds in which Python and its libraries are there, compiled where it is the first time, on a machine that
is busy."""
_KEPT: Final = (
    "PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "PYTHONPATH", "VIRTUAL_ENV",
    "TWINMATCH_CACHE", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR",
)  # fmt: skip
"""What the FMU's process gets to know of the environment."""


class ProcessLostError(Exception):
    """The process gave no answer that can be used, and has been ended."""


class FmuProcess:
    """One process for one FMU; asked by one thread at a time."""

    def __init__(self) -> None:
        """Start it; it has a folder of its own, which goes when it does."""
        self._folder = tempfile.TemporaryDirectory(prefix="twinmatch-fmu-")
        self.folder = Path(self._folder.name)
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "twinmatch.fmu.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=self.folder,
            env=_environment(),
            close_fds=True,
            start_new_session=True,
        )
        self._ended = weakref.finalize(self, _end, self._process, self._folder)
        self._first = True

    def ask(
        self, header: Mapping[str, Any], arrays: Mapping[str, FloatArray] | None = None, *, limit: float
    ) -> Message:
        """Its answer, within `limit` seconds; the first one may take longer, since the process has to start.

        Raises:
            ProcessLostError: none came, or none that can be read; the process has been ended.
            FmuError: the FMU, or the process on its behalf, says what is wrong.
        """
        with self._lock:
            if not self._ended.alive:
                raise ProcessLostError("it was ended before")
            by = time.monotonic() + limit + (START if self._first else 0.0)
            self._first = False
            try:
                self._write(packed(header, arrays or {}), by)
                message = unpacked(lambda size: self._read(size, by))
            except TimeoutError:
                self.close()
                raise ProcessLostError(f"it gave no answer within {limit:g} s and was ended") from None
            except (WireError, OSError) as error:
                raise ProcessLostError(self._last_words(error)) from None
        if "error" in message.header:
            raise FmuError(str(message.header["error"]))
        return message

    def close(self) -> None:
        """End it, if it has not ended."""
        self._ended()

    def _last_words(self, error: Exception) -> str:
        """Why it ended, as far as that can be known."""
        code: int | None = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(0.5)
        self.close()
        if code is None:
            return f"it wrote what is no answer ({error}) and was ended"
        if code < 0:
            return f"its process crashed ({signal.Signals(-code).name})"
        return f"its process ended by itself, with exit code {code}"

    def _write(self, data: bytes, by: float) -> None:
        handle = self._process.stdin.fileno()  # type: ignore[union-attr]
        os.set_blocking(handle, False)
        left = memoryview(data)
        while left:
            _wait([], [handle], by)
            left = left[os.write(handle, left[: 1 << 16]) :]

    def _read(self, size: int, by: float) -> bytes:
        handle, found = self._process.stdout.fileno(), bytearray()  # type: ignore[union-attr]
        while len(found) < size:
            _wait([handle], [], by)
            part = os.read(handle, min(size - len(found), 1 << 20))
            if not part:
                raise WireError("its answer ended early")
            found += part
        return bytes(found)


def _wait(readable: list[int], writable: list[int], by: float) -> None:
    left = by - time.monotonic()
    poll = select.poll()  # a node may have more files open than select can count
    for handle in readable:
        poll.register(handle, select.POLLIN)
    for handle in writable:
        poll.register(handle, select.POLLOUT)
    if left <= 0 or not poll.poll(1000.0 * left):
        raise TimeoutError


def _environment() -> dict[str, str]:
    kept = {name: os.environ[name] for name in _KEPT if name in os.environ}
    # What this process can import, the other one can.
    kept["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    return {**kept, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}


def _end(process: subprocess.Popen[bytes], folder: tempfile.TemporaryDirectory[str]) -> None:
    """With everything that it started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    with contextlib.suppress(OSError):
        folder.cleanup()
