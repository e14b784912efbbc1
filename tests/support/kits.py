"""Kits on a pseudo-terminal for tests."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from twinmatch.emulation.kit import KitBoard


class BenchKit:
    """A board that runs by itself; its sensors show what the test wants."""

    def __init__(self, folder: Path) -> None:
        self.shown = {1: 25.0, 2: 24.0}
        self.highest = 0.0
        """The largest command to heater 1, %."""
        self.board = KitBoard(folder / "ttyACM0", lambda number: self.shown[number])
        self._ending = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        return self.board.port

    @property
    def heaters(self) -> list[float]:
        return list(self.board.heaters)

    def unplug(self) -> None:
        with self._lock:
            self.board.unplug()

    def plug(self) -> None:
        with self._lock:
            self.board.plug()

    def say(self, data: bytes) -> None:
        with self._lock:
            self.board.say(data)

    @contextmanager
    def suspended(self) -> Iterator[None]:
        """It receives and does nothing, as if its program had to wait for the processor."""
        with self._lock:
            yield

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self.board.unplug()

    def _run(self) -> None:
        while not self._ending.wait(0.001):
            with self._lock:
                self.board.attend()
            self.highest = max(self.highest, self.board.heaters[0])
