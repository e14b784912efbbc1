"""Rate of a topic's messages, and detection of silence."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Arrivals"]

RHYTHM = 10
"""Messages after which a topic is expected to keep its rate."""
SHORTEST = 3.0
"""Shortest silence, s."""
PATIENCE = 10
"""Silence in mean intervals between messages."""


@dataclass
class Arrivals:
    """Arrivals of one topic; times in seconds of a clock that does not jump."""

    count: int = 0
    """Messages so far."""
    first: float = 0.0
    """When the first came, s."""
    last: float = 0.0
    """When the newest came, s."""
    lost: int = 0
    """Messages that the middleware lost."""

    def push(self, now: float) -> None:
        """Count a message."""
        if self.count == 0:
            self.first = now
        self.count += 1
        self.last = now

    @property
    def rate(self) -> float:
        """Mean rate from the first to the newest message, 1/s; 0 before the second."""
        span = self.last - self.first
        return (self.count - 1) / span if span > 0 else 0.0

    def silent(self, now: float) -> bool:
        """Whether a topic with a known rate has gone silent."""
        if self.count < RHYTHM or self.rate == 0:
            return False
        return now - self.last > max(SHORTEST, PATIENCE / self.rate)

    def text(self) -> str:
        """Rate and count as text."""
        lost = f", {self.lost} lost" if self.lost else ""
        return f"{self.rate:.1f} Hz, {self.count} messages{lost}"
