"""Who may accuse: only who has predicted this plant far better than to say that nothing changes.

Equations with a wrong gain, or without the plant's dead time, miss what the plant does, and then miss it also
in a plant that is healthy. So every judge keeps a record of them over the same time ahead.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from twinmatch.settings import Rule


class _Earning(Rule):
    """How well forecasts must have come true before a missing effect is told from their error.

    0.6 of an effect are missing when it is lost.
    """

    moved: float = 20.0
    """Least root of the sum of squared movements, in noises of a reading."""
    most: float = 0.5
    """Greatest share of it by which the forecasts may have been off."""
    most_missing: float = 0.35
    """Greatest share of it by which they may have been off if a missing effect is to be told from it."""


_EARNING: Final = _Earning()


NOTHING: Final = 0.1
"""Greatest share of an expected effect that counts as nothing. Over the longest of the times that are looked
at, so small a share is evidence even before the judge has earned its record."""


class Record(NamedTuple):
    """Sums of squares over the forecasts of one judge; immutable."""

    error: float = 0.0
    """Of measurements minus forecasts, in the output's unit squared."""
    moved: float = 0.0
    """Of how far the output moved: the error of saying that nothing changes."""

    def after(self, error: float, moved: float, factor: float = 1.0) -> Record:
        """The record with one more forecast; the sums before it are multiplied by `factor`, which forgets."""
        return Record(factor * self.error + error**2, factor * self.moved + moved**2)

    def earned(self, noise: float) -> bool:
        """Whether these forecasts are a reason to believe the next; `noise` of a reading (1 σ)."""
        return self._were_within(_EARNING.most, noise)

    def sees_drive(self, noise: float) -> bool:
        """Whether they were so near that the missing effect of a drive would show."""
        return self._were_within(_EARNING.most_missing, noise)

    def _were_within(self, share: float, noise: float) -> bool:
        """Whether they were off by at most a share of considerable movements."""
        return (
            self.moved >= (_EARNING.moved * noise) ** 2
            and self.error <= share**2 * self.moved
        )
