"""A thread that alone speaks to what drives a plant, and whose last word is zero."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from typing import ClassVar

__all__ = ["DriverThread"]


class DriverThread(ABC):
    """Takes one turn after the other until it is closed or fails, and then lets go of the link."""

    NAME: ClassVar[str]
    CLOSING: ClassVar[float]
    """Seconds that the end may take, unless another time is asked for."""

    def __init__(self, first_pause: float, longest_pause: float) -> None:
        """A lost link is looked for again after the first pause, s; each one is twice the one before."""
        self.failure: Exception | None = None
        """What ended the thread before its time."""
        self._ending, self._clear_wanted = threading.Event(), threading.Event()
        self._first_pause, self._longest_pause = first_pause, longest_pause
        self._attempts = 0
        self._thread = threading.Thread(target=self._run, name=self.NAME, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def clear(self) -> None:
        """Let go what the other end has latched by itself, before anything else is sent."""
        self._clear_wanted.set()

    def close(self, timeout: float | None = None) -> bool:
        """Set zero, let go of the port, end the thread; whether it did within the timeout (s; CLOSING)."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join(self.CLOSING if timeout is None else timeout)
        return not self._thread.is_alive()

    @abstractmethod
    def _turn(self) -> None:
        """Look at the gate once and do what it says; what is raised ends the thread."""

    @abstractmethod
    def _let_go(self) -> None:
        """Set zero, if that can still be done, and close the link."""

    def _pause(self) -> None:
        """Wait until a lost link is worth another look."""
        self._ending.wait(min(self._first_pause * 2.0 ** min(self._attempts, 30), self._longest_pause))
        self._attempts += 1

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                self._turn()
        except Exception as error:  # handed to the main thread, which ends the process with it
            self.failure = error
        finally:
            self._let_go()
