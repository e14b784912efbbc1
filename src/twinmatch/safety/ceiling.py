"""How far the drive alone may take a plant.

A lie that is slow enough never contradicts what was learned a few minutes before. So what limits the drive
learns from steps: from the readings of the first minutes at a set-point, and in each direction only until it
is known. What changes later is followed so slowly that a room is, and a lie that heats is not.
"""

from __future__ import annotations

import math
from typing import Final

from twinmatch.safety.likeness import PERIOD, Likeness
from twinmatch.signals import FloatArray

SIGMAS: Final = 3.0
LEARNS: Final = 600.0
"""Time after a step of the set-point from which is learned, s: rigs and kits have settled by then."""
FOLLOWS: Final = 14_400.0
"""Time constant with which later changes are followed, s. A drift of 0.0007 °C/s, a margin within that time,
stays below the margin for ever; rooms change by a third of that."""
ALIKE: Final = 60.0
"""Time over which the errors of a model are alike, s."""
STEP, KNOWN, SEEN, OPEN = 0.3, 0.15, 0.2, 0.5
"""In margins: a step of the set-point; the standard deviation up to which is learned; the change that shows
that the sensor sees the plant; the distance from the ceiling at which it begins to limit."""


class Ceiling:
    """Limits the drive where it takes the plant beyond both set-point and reading.

    The limit closes linearly between the half and the whole margin, so in between lies a temperature at which
    it lets pass just what holds the plant there. Heating up is free until then. As long as no reading has
    moved, the set-point does not count: nobody knows whether the sensor sees the plant.
    """

    estimate = math.nan
    """Output to which the drive has taken the plant."""
    share = 1.0
    """Of the full drive, what may pass."""

    def __init__(self, margin: float, mean: FloatArray, *, seen: bool = False) -> None:
        """Start with the plant's likeness; `seen`: whether readings have moved."""
        self.seen = seen
        """Whether readings have moved."""
        self._margin, self._z = margin, Likeness(mean)
        self._first = self._reference = math.nan
        self._since = 0.0  # time since the last step of the set-point, s

    def take(self, slopes: FloatArray, typical: float, reading: float, reference: float) -> float:
        """Take one comparison; returns in what time the reading is learned, s: 0 at once, infinite never."""
        moved, deviation = self._z.moves(slopes)
        self.estimate = typical + moved
        if math.isnan(self._first):
            self._first = reading
        saw, self.seen = self.seen, self.seen or abs(reading - self._first) >= SEEN * self._margin
        level = max(reading, reference) if self.seen else reading
        margin = max(self._margin, SIGMAS * deviation)
        self.share = min(1.0, max(0.0, (level + margin - self.estimate) / (OPEN * margin)))
        stepped = saw != self.seen or not abs(reference - self._reference) < STEP * self._margin
        if stepped:
            self._reference = reference
        self._since = 0.0 if stepped else self._since + PERIOD
        if self.seen and self._since < LEARNS:
            return 0.0
        return FOLLOWS if self.seen and self.share >= 1.0 else math.inf

    def learn(self, slopes: FloatArray, off: float, doubt: float, time: float) -> None:
        """Learn from a reading that was `off` from the typical plant, in the time that `take` returned."""
        _, deviation = self._z.moves(slopes)
        if time == 0.0 and deviation > KNOWN * self._margin:
            self._z.learn(slopes, off, doubt * math.sqrt(ALIKE / PERIOD))
        else:
            self._z.follow(slopes, off, PERIOD / max(time, FOLLOWS))
