"""How often the messages of a topic come, and when they stopped."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Arrivals"]

RHYTHM = 10
"""Messages after which a topic is expected to go on as it did."""
SHORTEST = 3.0
"""Silence below this is none, s."""
PATIENCE = 10
"""Usual intervals that make a silence."""


@dataclass
class Arrivals:
    """Of one topic; times are seconds of one clock that does not step."""

    count: int = 0
    """Messages so far."""
    first: float = 0.0
    """When the first came, s."""
    last: float = 0.0
    """When the newest came, s."""
    lost: int = 0
    """Messages that the middleware lost."""

    def push(self, now: float) -> None:
        """Take note of a message."""
        if self.count == 0:
            self.first = now
        self.count += 1
        self.last = now

    @property
    def rate(self) -> float:
        """Messages per second while they came, 1/s; 0 before the second."""
        span = self.last - self.first
        return (self.count - 1) / span if span > 0 else 0.0

    def silent(self, now: float) -> bool:
        """Whether a topic that had a rhythm has lost it."""
        if self.count < RHYTHM or self.rate == 0:
            return False
        return now - self.last > max(SHORTEST, PATIENCE / self.rate)

    def text(self) -> str:
        """Rate and count as a person reads them."""
        lost = f", {self.lost} lost" if self.lost else ""
        return f"{self.rate:.1f} Hz, {self.count} messages{lost}"
