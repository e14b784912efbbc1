"""How often the leader was nearly the best candidate in hindsight."""

from __future__ import annotations

from typing import Final

__all__ = ["Hindsight"]

NEAR: Final = 1.03
"""A leader whose error is no larger than this times the least of all candidates counts as right."""
_DOUBT: Final = 0.5
"""Prior count of either outcome (Jeffreys)."""


class Hindsight:
    """Share of the leader's forecasts that no other candidate beat by more than 3 %; old ones weigh less."""

    def __init__(self, kept: float) -> None:
        """Begin undecided; `kept` is the factor on past weights per forecast."""
        self._kept = kept
        self._right = self._wrong = _DOUBT

    def add(self, leading: float, best: float) -> None:
        """Add the error of the leader and the least error of all candidates."""
        right = leading <= NEAR * best
        self._right = self._kept * self._right + right
        self._wrong = self._kept * self._wrong + (not right)

    @property
    def share(self) -> float:
        """The share, between 0 and 1."""
        return self._right / (self._right + self._wrong)
