"""The virtual rig's camera: the real camera program as a child process, and its substitutes under faults."""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import socket
import subprocess
import sys
import time
from collections import deque
from enum import Enum
from typing import Final

import numpy as np

from twinmatch.emulation.clock import LineServer
from twinmatch.errors import TwinmatchError
from twinmatch.shipped import NotShippedError, shipped


class VirtualCameraError(TwinmatchError):
    """The camera program is missing, does not start, or has ended unexpectedly."""


class Serving(Enum):
    """The program at the camera's address."""

    CAMERA = "camera"
    NOBODY = "nobody"
    GARBAGE = "garbage"


class VirtualCamera:
    """A camera that takes nine images of the plate per second of plant time.

    Its program is controlled through its standard input, so it ends with this process, however that ends.

    Raises:
        VirtualCameraError: the program is missing or does not start.
    """

    _RATE: Final = 9.0
    """New images per second of plant time, as of a Lepton."""
    PATIENCE: Final = 30.0
    """Longest start of the camera program, s."""
    _REPEAT: Final = 0.05
    """Interval at which an image that nobody has taken is sent again, wall s."""

    def __init__(self, *, ambient: float, seed: int = 0) -> None:
        self.frozen = False
        """Whether the sensor repeats its last image."""
        self._ambient = ambient
        self._seed = seed
        self._starts = 0
        self._tick = -1
        self._line = b""
        self._shown_at = 0.0
        self.stamp = 0
        """Plant time of the newest image, ns."""
        self._serving = Serving.CAMERA
        self._process: subprocess.Popen[bytes] | None = None
        self._printed_lines: deque[str] = deque(maxlen=20)
        self._garbage: _Garbage | None = None
        self._environment = _environment()
        self.address = ("127.0.0.1", 0)
        """Host and port."""
        self._start()
        try:
            self.address = ("127.0.0.1", self._wait_for_port())
        except VirtualCameraError:
            self.close()
            raise

    def see(self, elapsed: float, plate: float, stamp: int) -> None:
        """Take an image if one is due.

        Args:
            elapsed: plant time since the start, s.
            plate: the plate's temperature, °C.
            stamp: plant time for the image's stamp, ns.
        """
        tick = math.floor(elapsed * self._RATE + 1e-6)
        if tick == self._tick:
            return
        self._tick = tick
        if not (self.frozen and self._line):
            self._line = b"%.9f %.6f" % (tick / self._RATE, plate)
        if self._garbage is not None:
            self._garbage.send()
        self.stamp = stamp
        self._show()

    @property
    def serves(self) -> bool:
        """Whether there is a camera that takes images."""
        return self._process is not None

    def repeat(self) -> None:
        """Send the newest image again, unless it was sent just now: it may get lost."""
        if time.monotonic() - self._shown_at >= self._REPEAT:
            self._show()

    def serve(self, program: Serving) -> None:
        """Change the program at the camera's address."""
        if program is self._serving:
            return
        self._serving = program
        self._end_program()
        if self._garbage is not None:
            self._garbage.close()
            self._garbage = None
        if program is Serving.CAMERA:
            self._start()
        elif program is Serving.GARBAGE:
            self._garbage = _Garbage(self.address, self._seed)

    def close(self) -> None:
        """End the program at the camera's address."""
        self.serve(Serving.NOBODY)

    def _start(self) -> None:
        host, port = self.address
        command = [sys.executable, "-m", "twinmatch_camera", "emulated", "--feed", "-"]
        command += ["--listen", f"{host}:{port}", "--ambient", f"{self._ambient:g}"]
        command += ["--seed", str(self._seed + self._starts)]
        self._starts += 1
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=self._environment,
            bufsize=0,
            start_new_session=True,  # Ctrl-C does not reach it; this process ends it
        )
        for pipe in (self._process.stdin, self._process.stderr):
            os.set_blocking(_pipe(pipe).fileno(), False)

    def _wait_for_port(self) -> int:
        deadline = time.monotonic() + self.PATIENCE
        while time.monotonic() < deadline:
            self._listen()
            for line in self._printed_lines:
                if port := re.search(r"serving .*:(\d+)$", line):
                    return int(port[1])
            time.sleep(0.01)
        raise VirtualCameraError(
            f"virtual camera: its program was not ready after {self.PATIENCE:g} s"
        )

    def _show(self) -> None:
        self._shown_at = time.monotonic()
        if self._process is not None and self._line:
            with contextlib.suppress(BlockingIOError, BrokenPipeError):
                # it is slow, or its end is noticed
                _pipe(self._process.stdin).write(b"%s %d\n" % (self._line, self.stamp))
            self._listen()

    def _listen(self) -> None:
        process = self._process
        if process is None:
            return
        output = _pipe(process.stderr).read()
        if output:
            self._printed_lines.extend(output.decode(errors="replace").splitlines())
        elif output == b"":
            last = " / ".join(list(self._printed_lines)[-3:])
            raise VirtualCameraError(
                f"virtual camera: its program has ended unexpectedly: {last}"
            )

    def _end_program(self) -> None:
        process = self._process
        self._process = None
        if process is None:
            return
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stderr):
            with contextlib.suppress(OSError):
                _pipe(pipe).close()


class _Garbage(LineServer):
    """Another program at the camera's address that sends noise."""

    _GARBAGE: Final = 512
    """Bytes of noise in place of an image."""

    def __init__(self, address: tuple[str, int], seed: int) -> None:
        super().__init__(socket.create_server(address))
        self._random = np.random.default_rng(seed)

    def send(self) -> None:
        self.accept()
        for client in list(self._clients):
            self.put(client, self._random.bytes(self._GARBAGE))


def _environment() -> dict[str, str]:
    """The environment of the camera program, which comes along with twinmatch and need not be installed."""
    try:
        sources = shipped("camera_server/src")
    except NotShippedError as error:
        raise VirtualCameraError(f"virtual camera: {error}") from error
    paths = [str(sources), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}


def _pipe(pipe: object) -> io.FileIO:
    if not isinstance(pipe, io.FileIO):  # always so with bufsize=0
        raise TypeError(f"{pipe!r} is not an unbuffered pipe")
    return pipe
