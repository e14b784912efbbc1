"""The family: parameter sets matched at different operating points, one of which becomes nominal."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twinmatch.dynamics import Parameters
from twinmatch.signals import FloatArray, Window


@dataclass(frozen=True, eq=False)
class Candidate:
    """One parameter set of the family."""

    name: str
    operating_point: float
    """Set-point at the end of the window it was matched on."""
    parameters: Parameters
    window: Window | None
    """The window it was matched on; None if it was given, not matched."""
    free: tuple[str, ...] = ()
    """Names of the parameters that were fitted."""
    covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """Covariance of these, in their order and units, (n, n); empty if the candidate was given: exact."""
    states: FloatArray | None = None
    """States of its twin at the last samples of the window, shape (N, states), if its fit gave them."""

    @property
    def samples(self) -> tuple[int, int]:
        """First and last sample to which it was fitted; (0, -1) if it was given."""
        return (self.window.first, self.window.last) if self.window is not None else (0, -1)

    @property
    def known_covariance(self) -> FloatArray | None:
        """The covariance if it can be used; None: the parameters count as exact.

        Where a match left some combination unbounded, the other variances are unusable, too. The width of
        the bands then follows from past errors.
        """
        usable = len(self.covariance) > 0 and bool(np.isfinite(self.covariance).all())
        return self.covariance if usable else None

    def states_at(self, sample: int) -> FloatArray | None:
        """States of its twin at a sample, shape (states,); None where they are unknown."""
        if self.states is None or self.window is None:
            return None
        place = sample - (self.window.last - len(self.states) + 1)
        return self.states[place] if 0 <= place < len(self.states) else None


class Family:
    """At most `most` candidates, one per set-point regime; a newer match of a regime replaces the older."""

    def __init__(self, most: int = 8, regime_width: float = 10.0) -> None:
        """Begin empty.

        Args:
            most: how many candidates are kept; the one matched longest ago is removed first.
            regime_width: operating points closer than half of this, in the output's unit, belong to one
            regime.
        """
        self.most = most
        self.regime_width = regime_width
        self._candidates: list[Candidate] = []

    def __len__(self) -> int:
        return len(self._candidates)

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """The candidates in the order of their operating points."""
        return tuple(sorted(self._candidates, key=lambda c: (c.operating_point, c.name)))

    def standing_at(self, operating_point: float) -> Candidate | None:
        """The candidate whose regime contains this set-point, if any."""
        near = [
            c for c in self._candidates if abs(c.operating_point - operating_point) < self.regime_width / 2
        ]
        return min(near, key=lambda c: (abs(c.operating_point - operating_point), c.name), default=None)

    def admit(self, candidate: Candidate) -> Candidate | None:
        """Add a candidate; return the one it replaces, if any."""
        namesakes = [c for c in self._candidates if c.name == candidate.name]
        leaving = namesakes[0] if namesakes else self.standing_at(candidate.operating_point)
        if leaving is None and len(self._candidates) >= self.most:
            leaving = self._candidates[0]
        if leaving is not None:
            self._candidates.remove(leaving)
        self._candidates.append(candidate)
        return leaving

    def dismiss(self, name: str) -> None:
        """Remove the candidate of this name, if present."""
        self._candidates = [c for c in self._candidates if c.name != name]
