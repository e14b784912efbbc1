"""The one thread that talks to a Temperature Control Lab.

Several times a second it sets the command that the gate passes, or zero, and forwards the kit's readings.
However the thread ends, its last command is zero; if it cannot send it, the process that holds the port does.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from twinmatch.links.kit_link import KitAbsentError, KitError, KitLink, KitReading, KitSilentError
from twinmatch.nodes.driver_thread import DriverThread
from twinmatch.nodes.node import Health, Level
from twinmatch.nodes.output_gate import Decision, OutputGate
from twinmatch.safety import FaultKind

__all__ = ["KitDriver", "KitPace"]

_LONGEST = 0.3
"""Longest wall time between two commands, s: well within the deadline of the process that holds the port."""

Tell = Callable[[KitReading | None, int], None]


@dataclass(frozen=True)
class KitPace:
    """Pace of the thread."""

    repeat: float = 0.25
    """Interval between two commands, s of the plant's clock."""
    poll: float = 0.025
    """Longest sleep between two readings of that clock, wall s."""
    first_pause: float = 0.1
    """Pause before the first attempt to reconnect, s; doubled after each attempt."""
    longest_pause: float = 2.0
    """Longest such pause, s."""


class KitDriver(DriverThread):
    """Sends to the kit what the gate passes, and nothing else."""

    NAME = "kit driver"
    CLOSING = 5.0

    def __init__(
        self,
        link: KitLink,
        gate: OutputGate,
        tell: Tell,
        health: Health,
        *,
        other: float = 0.0,
        pace: KitPace | None = None,
    ) -> None:
        """`tell` is called with each reading (None: unknown) and the sample whose command was set.

        `other` is the power of the second heater while commands pass, %.
        """
        self._other, self._pace = other, pace or KitPace()
        super().__init__(gate, self._pace.first_pause, self._pace.longest_pause)
        self._link, self._tell, self._health = link, tell, health
        self._known = False  # whether the kit has answered before
        self._sent: tuple[float, float] | None = None
        self._sent_at = 0.0
        self._said_at = 0.0

    @property
    def connected(self) -> bool:  # type: ignore[override]
        """Whether the kit answered the last command."""
        return self._link.is_open and self._sent is not None

    def _turn(self) -> None:
        try:
            if not self._link.is_open:
                self._connect()
            self._serve()
        except KitAbsentError as error:
            if not self._known:
                raise  # a kit that was never there is not waited for
            self._lost(error)
        except KitSilentError as error:
            self._gate.trip(FaultKind.BOARD, str(error))
        except KitError as error:
            self._lost(error)

    def _connect(self) -> None:
        self._link.open()
        self._known, self._attempts = True, 0
        self._health.count("connections")
        self._health.set("port", self._link.port)
        self._health.set("firmware", self._link.firmware)
        self._health.withdraw("link")

    def _serve(self) -> None:
        if self._clear_wanted.is_set():
            self._link.clear()
            self._clear_wanted.clear()
        decision = self._gate.decide()
        wanted = (decision.input, self._other) if decision.armed else (0.0, 0.0)
        # By the wall clock too: a slow or stopped plant clock must not look like the end of this process.
        due = decision.time - self._sent_at >= self._pace.repeat
        if due or wanted != self._sent or time.monotonic() - self._said_at >= _LONGEST:
            self._set(wanted, decision)
        self._gate.wait(self._pace.poll)

    def _set(self, wanted: tuple[float, float], decision: Decision) -> None:
        reading = self._link.drive(*wanted)
        self._sent, self._sent_at, self._said_at = wanted, decision.time, time.monotonic()
        self._tell(reading, decision.sample)

    def _lost(self, error: KitError) -> None:
        if self._sent is not None and self._sent != (0.0, 0.0):
            self._gate.trip(FaultKind.LINK, str(error))
        self._sent = None
        self._health.count(type(error).__name__)
        self._health.flag("link", Level.ERROR, str(error))
        self._link.close()
        self._tell(None, 0)
        self._pause()

    def _release(self) -> None:
        if self._link.is_open:
            with contextlib.suppress(Exception):  # the port must be released whatever happens
                self._tell(self._link.drive(0.0, 0.0), 0)
        self._link.close()
