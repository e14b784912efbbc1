"""The real firmware image on a simulated ATmega32U4, in a separate process.

The process is `virtual_board` (folder `virtual_board/`, which has its own licence), controlled by lines of
text on its standard input and output. Every byte on the serial port comes from the firmware itself.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import logging
import os
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import Final, NamedTuple

from twinmatch.emulation.arduino import (
    ArduinoError,
    EmulatedBoard,
    PinDrive,
    StandInArduino,
)
from twinmatch.links.pwm_protocol import PWM_LIMIT

_log = logging.getLogger(__name__)

SIMAVR_HEADER = Path("/usr/include/simavr/sim_avr.h")
TOOLS = {"make": "make", "avr-g++": "gcc-avr, avr-libc and arduino-core-avr"}
"""Programs needed for the build, and their Debian packages."""

_MILLIVOLTS_PER_AMPERE = 525.0
_ENDING = 5.0  # s until a process that does not end is killed
_BOOT = 0.5  # s of board time until it is on the bus
_PROJECT = Path(__file__).resolve().parents[3]
BOARDS: Final = ("auto", "simavr", "python")


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
        raise ArduinoError(
            "virtual board: libsimavr is missing; install libsimavr-dev and libelf-dev"
        )
    for folder in ("firmware", "virtual_board"):
        command = [
            "make",
            "-s",
            "-C",
            str(project / folder),
            f"BUILD={(build / folder).resolve()}",
        ]
        make = subprocess.run(command, capture_output=True, text=True, check=False)
        if make.returncode:
            raise ArduinoError(
                f"virtual board: {folder} does not compile:\n{make.stderr[-2000:]}"
            )
    return VirtualTools(
        build / "virtual_board" / "virtual_board",
        build / "firmware" / "twinmatch_leonardo.elf",
    )


class _State(NamedTuple):
    time_us: int
    restarts: int
    high: int
    top: int
    direction: int
    enable: int
    port_is_there: int


class VirtualArduino(EmulatedBoard):
    """A board that runs the firmware, whose direction pin is low for heating.

    Raises:
        ArduinoError: the simulator does not start; of all methods: it has ended.
    """

    def __init__(self, tools: VirtualTools, port: str | Path | None = None) -> None:
        super().__init__(port)
        self._lock = threading.Lock()
        self._remarks = tempfile.TemporaryFile()  # noqa: SIM115
        command = [str(tools.program), str(tools.image), self.port]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._remarks,
                # Ctrl-C does not reach it; it ends with its input
                start_new_session=True,
            )
        except OSError as error:
            self._remarks.close()
            super().close()
            msg = f"virtual board: {tools.program} does not start ({error}); build it first"
            raise ArduinoError(msg) from error
        try:
            self._hear()
        except ArduinoError:
            self.close()
            raise
        _log.info("%s is a simulated board that runs %s", self.port, tools.image.name)

    def advance(self, seconds: float) -> PinDrive:
        """Advance by this time, rounded to ms, and return the drive at the end."""
        return self._drive(self._ask(f"step {round(seconds * 1000) * 1000}"))

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
        super().close()

    def _error(self, why: str) -> ArduinoError:
        return ArduinoError(f"virtual board at {self.port}: {why}")

    def _ask(self, line: str) -> _State:
        with self._lock:
            try:
                assert self._process.stdin is not None  # noqa: S101
                self._process.stdin.write(line.encode() + b"\n")
                self._process.stdin.flush()
            except (OSError, ValueError) as error:
                raise self._error("its process has ended") from error
            return self._hear()

    def _hear(self) -> _State:
        assert self._process.stdout is not None  # noqa: S101
        words = self._process.stdout.readline().split()
        if not words:
            self._remarks.seek(0)
            remarks = self._remarks.read().decode(errors="replace").strip()[-500:]
            raise self._error(f"its process has ended: {remarks}")
        if words[0] != b"state":
            raise self._error(
                "it refused a command; rebuild it from this version's sources"
            )
        return _State(*map(int, words[1:]))

    def _drive(self, state: _State) -> PinDrive:
        enabled = bool(state.enable)
        magnitude = PWM_LIMIT * state.high / state.top if enabled and state.top else 0.0
        cools = state.direction and magnitude > 0
        return PinDrive(
            state.time_us / 1e6, -magnitude if cools else magnitude, enabled
        )


Board = StandInArduino | VirtualArduino
"""Either board."""


class VirtualBoard(NamedTuple):
    """A board and its description."""

    board: Board
    kind: str
    """`simavr` or `python`."""
    remark: str


def make_board(wanted: str, port: Path) -> VirtualBoard:
    """A board on the bus, with its serial port at `port`.

    `simavr` runs the firmware image on a simulated processor, `python` is a stand-in, `auto` is simavr if
    available.

    Raises:
        ArduinoError: there is no such kind, or it cannot be created.
    """
    if wanted not in BOARDS:
        raise ArduinoError(
            f"virtual rig: board {wanted!r} does not exist; choose one of {', '.join(BOARDS)}"
        )
    why = "as requested"
    if wanted != "python":
        try:
            board = VirtualArduino(virtual_tools(), port)
        except ArduinoError as error:
            if wanted == "simavr":
                raise
            why = str(error).splitlines()[0]
        else:
            return VirtualBoard(
                _on_the_bus(board),
                "simavr",
                "the firmware image on a simulated ATmega32U4",
            )
    return VirtualBoard(
        _on_the_bus(StandInArduino(port)),
        "python",
        f"a stand-in, no firmware runs: {why}",
    )


def virtual_tools() -> VirtualTools:
    """Simulator and firmware, compiled from the sources into the user's cache if necessary.

    Raises:
        ArduinoError: there are no sources, a tool is missing, or something does not compile.
    """
    if not (_PROJECT / "virtual_board" / "Makefile").exists():
        raise ArduinoError(
            "virtual board: its sources are not installed; use a checkout of the project"
        )
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    checkout = hashlib.sha256(str(_PROJECT).encode()).hexdigest()[:12]
    build = home / "twinmatch" / f"virtual_board-{checkout}"
    try:
        build.mkdir(parents=True, exist_ok=True)
        with (build / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # two rigs may start at once
            return build_virtual_board(_PROJECT, build)
    except OSError as error:
        raise ArduinoError(
            f"virtual board: it cannot be built in {build} ({error})"
        ) from error


def _on_the_bus(board: Board) -> Board:
    board.advance(_BOOT)
    if not Path(board.port).exists():
        board.close()
        raise ArduinoError(
            f"virtual board at {board.port}: not on the bus after {_BOOT} s"
        )
    return board
