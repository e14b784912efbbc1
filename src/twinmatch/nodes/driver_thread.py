"""A thread with exclusive access to the hardware that drives a plant; its last command is zero."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from typing import ClassVar

from twinmatch.nodes.output_gate import OutputGate
from twinmatch.nodes.step import FOREVER, InStep

__all__ = ["DriverThread"]


class DriverThread(ABC):
    """Takes one turn after another until it is closed or fails, and then releases the link."""

    NAME: ClassVar[str]
    CLOSING: ClassVar[float]
    """Default time in which the thread has to end, s."""

    connected: bool
    """Whether the hardware answered last."""
    step: InStep | None = None
    """Told which commands are applied, if the plant waits for them."""

    def __init__(self, gate: OutputGate, first_pause: float, longest_pause: float) -> None:
        """Apply what the gate passes.

        A lost link is retried after the first pause, s; each pause doubles, up to the longest, s.
        """
        self.failure: Exception | None = None
        """The error that ended the thread, if any."""
        self._ending, self._clear_wanted = threading.Event(), threading.Event()
        self._gate = gate
        self._first_pause, self._longest_pause = first_pause, longest_pause
        self._attempts = 0
        self._thread = threading.Thread(target=self._run, name=self.NAME, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def clear(self) -> None:
        """Clear the fault latched by the hardware, before anything else is sent."""
        self._clear_wanted.set()

    def close(self, timeout: float | None = None) -> bool:
        """Set zero, release the port, end the thread; whether it ended within the timeout (s; CLOSING)."""
        self._ending.set()
        if self._thread.ident is not None:
            self._thread.join(self.CLOSING if timeout is None else timeout)
        return not self._thread.is_alive()

    @abstractmethod
    def _turn(self) -> None:
        """Apply the gate's decision once; an exception ends the thread."""

    @abstractmethod
    def _release(self) -> None:
        """Set zero, if that is still possible, and close the link."""

    def _pause(self) -> None:
        """Wait before the next attempt to restore a lost link."""
        self._ending.wait(min(self._first_pause * 2.0 ** min(self._attempts, 30), self._longest_pause))
        self._attempts += 1

    def _run(self) -> None:
        try:
            while not self._ending.is_set():
                commanded = self._gate.commanded
                self._turn()
                if self.step is not None:
                    self.step.applied(commanded if self.connected else FOREVER)
        except Exception as error:  # handed to the main thread, which ends the process with it
            self.failure = error
        finally:
            self._release()
