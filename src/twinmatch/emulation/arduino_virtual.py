"""The real firmware image on a simulated ATmega32U4, in a separate process.

The process is `virtual_board` (folder `virtual_board/`, which has its own licence), controlled by lines of
text on its standard input and output. Every byte on the serial port comes from the firmware itself.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from twinmatch.emulation.arduino_pins import ArduinoError, PinDrive
from twinmatch.links.pwm_protocol import PWM_LIMIT

__all__ = ["VirtualArduino", "VirtualTools", "build_virtual_board"]

_log = logging.getLogger(__name__)

SIMAVR_HEADER = Path("/usr/include/simavr/sim_avr.h")
TOOLS = {"make": "make", "avr-g++": "gcc-avr, avr-libc and arduino-core-avr"}
"""Programs needed for the build, and their Debian packages."""

_MILLIVOLTS_PER_AMPERE = 525.0
_ENDING = 5.0  # s until a process that does not end is killed


class VirtualTools(NamedTuple):
    """The files of a virtual board."""

    program: Path
    """The simulator."""
    image: Path
    """The firmware, as an ELF file."""


def build_virtual_board(project: Path, build: Path) -> VirtualTools:
    """Compile firmware and simulator from the sources in `project` into the folder `build`.

    Raises:
        ArduinoError: a tool is missing, or something does not compile.
    """
    for tool, package in TOOLS.items():
        if shutil.which(tool) is None:
            raise ArduinoError(f"virtual board: {tool} is missing; install {package}")
    if not SIMAVR_HEADER.exists():
        raise ArduinoError("virtual board: libsimavr is missing; install libsimavr-dev and libelf-dev")
    for folder in ("firmware", "virtual_board"):
        command = ["make", "-s", "-C", str(project / folder), f"BUILD={(build / folder).resolve()}"]
        made = subprocess.run(command, capture_output=True, text=True, check=False)
        if made.returncode:
            raise ArduinoError(f"virtual board: {folder} does not compile:\n{made.stderr[-2000:]}")
    return VirtualTools(
        build / "virtual_board" / "virtual_board", build / "firmware" / "twinmatch_leonardo.elf"
    )


class _State(NamedTuple):
    time_us: int
    restarts: int
    high: int
    top: int
    direction: int
    enable: int
    port_is_there: int


class VirtualArduino:
    """A `Board` that runs the firmware. Its port appears at `port`, by default a temporary path.

    `heat_level` is the level of the direction pin for heating, as in the firmware's `config.h`.

    Raises:
        ArduinoError: the simulator does not start.
    """

    def __init__(
        self, tools: VirtualTools, port: str | Path | None = None, *, heat_level: bool = False
    ) -> None:
        self._folder = None if port else tempfile.TemporaryDirectory(prefix="twinmatch-arduino-")
        self.port = str(port or Path(self._folder.name if self._folder else "") / "ttyACM0")
        self._heat_level = heat_level
        self._lock = threading.Lock()
        self._remarks = tempfile.TemporaryFile()  # noqa: SIM115 (lives as long as the process)
        command = [str(tools.program), str(tools.image), self.port]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._remarks,
                start_new_session=True,  # Ctrl-C does not reach it; it ends with its input
            )
        except OSError as error:
            self._remarks.close()
            self._forget_folder()
            msg = f"virtual board: {tools.program} does not start ({error}); build it first"
            raise ArduinoError(msg) from error
        self._running = False
        try:
            self._hear()
        except ArduinoError:
            self.close()
            raise
        _log.info("%s is a simulated board that runs %s", self.port, tools.image.name)

    def __enter__(self) -> VirtualArduino:
        """Nothing to do: the board exists since construction."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the board."""
        self.close()

    @property
    def restarts(self) -> int:
        """Number of restarts of the firmware."""
        return self._ask("state").restarts

    def advance(self, seconds: float) -> PinDrive:
        """Advance by this time, rounded to ms, and return the drive at the end.

        Raises:
            ArduinoError: it is running, or its process has ended.
        """
        if self._running:
            raise ArduinoError(f"virtual board at {self.port}: it is running; pause() it before advance()")
        return self._drive(self._ask(f"step {round(seconds * 1000) * 1000}"))

    def run(self, speed: float = 1.0) -> None:
        """Run `speed` times as fast as the wall clock.

        Raises:
            ArduinoError: the speed is not positive, or the process has ended.
        """
        if not speed > 0:
            raise ArduinoError(f"virtual board at {self.port}: speed is {speed}; it must be positive")
        self._ask(f"run {speed:.6f}")
        self._running = True

    def pause(self) -> None:
        """Stop running."""
        self._ask("pause")
        self._running = False

    def drive(self) -> PinDrive:
        """The drive now."""
        return self._drive(self._ask("state"))

    def set_current(self, amperes: float) -> None:
        """Show a current on the feedback pin, A."""
        self._ask(f"feedback {round(max(0.0, amperes) * _MILLIVOLTS_PER_AMPERE)}")

    def set_fault(self, fault: bool) -> None:
        """Set or release the driver's fault flag."""
        self._ask(f"fault {int(fault)}")

    def unplug(self) -> None:
        """Unplug the USB cable; the port vanishes one millisecond of board time later."""
        self._ask("unplug")

    def plug(self) -> None:
        """Plug the USB cable in; the port returns when the board has been enumerated."""
        self._ask("plug")

    def hang(self) -> None:
        """Let the firmware hang with interrupts off."""
        self._ask("hang")

    def close(self) -> None:
        """End the process; its port disappears."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        try:
            self._process.wait(_ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._remarks.close()
        self._forget_folder()

    def _forget_folder(self) -> None:
        if self._folder is not None:
            self._folder.cleanup()

    def _ask(self, line: str) -> _State:
        with self._lock:
            try:
                assert self._process.stdin is not None  # noqa: S101  (opened as a pipe)
                self._process.stdin.write(line.encode() + b"\n")
                self._process.stdin.flush()
            except (OSError, ValueError) as error:
                raise ArduinoError(f"virtual board at {self.port}: its process has ended") from error
            return self._hear()

    def _hear(self) -> _State:
        assert self._process.stdout is not None  # noqa: S101  (opened as a pipe)
        words = self._process.stdout.readline().split()
        if not words:
            self._remarks.seek(0)
            said = self._remarks.read().decode(errors="replace").strip()[-500:]
            raise ArduinoError(f"virtual board at {self.port}: its process has ended: {said}")
        if words[0] != b"state":
            raise ArduinoError(
                f"virtual board at {self.port}: it refused a command; rebuild it from this version's sources"
            )
        return _State(*map(int, words[1:]))

    def _drive(self, state: _State) -> PinDrive:
        enabled = bool(state.enable)
        magnitude = PWM_LIMIT * state.high / state.top if enabled and state.top else 0.0
        cools = bool(state.direction) != self._heat_level and magnitude > 0
        return PinDrive(state.time_us / 1e6, -magnitude if cools else magnitude, enabled)
