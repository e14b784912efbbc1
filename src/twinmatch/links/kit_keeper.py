"""A watchdog process that holds a kit's serial port, and switches the heaters off when commands stop.

The firmware of a Temperature Control Lab has no deadline: without a host its heaters stay as they are. So
this small process holds the port, and outlives the commanding process just long enough to switch off. It
reads one line per command and answers each with one line.

    drive POWER OTHER     →  read T1 T2 POWER OTHER
    clear                 →  cleared
                             error WHAT: both heaters were switched off, and this process ends
                             silent WHAT: heaters are off because no command arrived, until cleared

Usage: python -m twinmatch.links.kit_keeper PORT DEADLINE
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys

from twinmatch.errors import EXIT_USER_ERROR
from twinmatch.links.kit_errors import KitAbsentError, KitError
from twinmatch.links.kit_serial import Kit, open_kit

__all__ = ["main"]

_OFFS = 5
"""Attempts to switch the heaters off before giving up."""


class _Keeper:
    def __init__(self, kit: Kit, deadline: float) -> None:
        self._kit = kit
        self._deadline = deadline
        self._driving = False
        self._silent = False
        self._heard = b""

    def serve(self) -> int:
        """Answer commands until the input ends."""
        while True:
            for line in self._lines():
                if line is None:
                    return 0
                try:
                    self._say(self._answer(line.split()))
                except (KitError, OSError) as error:
                    self._say(f"error {error}")
                    return 1

    def off(self) -> None:
        for _ in range(_OFFS):
            with contextlib.suppress(KitError, OSError):
                self._kit.off()
                return

    def _lines(self) -> list[str | None]:
        """The received lines; None at the end of input. Waits at most the deadline while a heater is on."""
        if not select.select([0], [], [], self._deadline if self._driving else None)[0]:
            self._kit.off()
            self._driving, self._silent = False, True
            return []
        heard = os.read(0, 4096)
        *lines, self._heard = (self._heard + heard).split(b"\n")
        return [line.decode(errors="replace") for line in lines] if heard else [None]

    def _answer(self, words: list[str]) -> str:
        if words == ["clear"]:
            self._silent = False
            return "cleared"
        if len(words) != 3 or words[0] != "drive":
            raise KitError(f"kit: {' '.join(words)!r} is not a command")
        power, other = (_number(word) for word in words[1:])
        wanted = power > 0.0 or other > 0.0
        if self._silent and wanted:
            return (
                f"silent the kit received no command for {self._deadline:g} s; its heaters were switched off"
            )
        self._driving = wanted
        return "read {:.4f} {:.4f} {:.4f} {:.4f}".format(*self._kit.drive(power, other))

    @staticmethod
    def _say(line: str) -> None:
        with contextlib.suppress(OSError):  # the reader is gone, which the end of our input will show
            os.write(1, f"{line}\n".encode())


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise KitError(f"kit: {word!r} is not a number") from None


def main(arguments: list[str]) -> int:
    """Hold a port until the standard input ends; returns the exit code."""
    port, deadline = arguments[0], float(arguments[1])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ends at the end of its input instead
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.signal(signal.SIGHUP, lambda *_: sys.exit(0))
    try:
        kit = open_kit(port)
    except KitAbsentError as error:
        os.write(1, f"absent {error}\n".encode())
        return EXIT_USER_ERROR
    except (KitError, OSError) as error:
        os.write(1, f"error {error}\n".encode())
        return 1
    keeper = _Keeper(kit, deadline)
    try:
        os.write(1, f"ready {kit.port} {kit.version}\n".encode())
        return keeper.serve()
    finally:
        keeper.off()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
