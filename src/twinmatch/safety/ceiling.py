"""How far the drive alone may take a plant.

A lie that is slow enough never contradicts what was learned a few minutes before. So what limits the drive
does not believe its sensor. Beside the weights z of the plants it estimates by how much the sensor is off, b:

    reading = y₀ + D·z + b,    b ← (1 − Δt/T)·b + w,    w ~ N(0, ε²·Δt)

The plant stays what it is, while a sensor may wander. So a reading teaches what the plant is like only as far
as it moves faster than the sensor can: a step of the set-point teaches much, a level that is held teaches
little, and a moving set-point does not make another plant of it. The rest is b: a sensor that is off, or a
room that has changed. Nothing here can tell these two apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.safety.likeness import PERIOD, Likeness
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


@dataclass(frozen=True)
class SensorWander:
    """How a sensor may wander, and what its readings teach.

    A drift of 0.03 °C/s that begins with the first response takes a sensor 3 °C off in 100 s; a random walk
    of 0.15 °C/√s gets 1.5 °C far in that time, so half of such a lie is not taken for the plant, and the
    first step still teaches it. Once the plant has warmed up, 0.3 °C/√s are 7 °C in ten minutes.
    """

    at_first: float = 0.15
    """Of its random walk at the start, °C/√s."""
    later: float = 0.3
    """Of its random walk once the plant has warmed up, °C/√s."""
    warmed_up: float = 300.0
    """Time after which the plant has warmed up, s: rigs and kits have settled by then."""
    off: float = 0.5
    """Standard deviation of what it is off at the start, °C."""
    follows: float = 14_400.0
    """Time constant with which a difference that stays becomes the plant's, s: rooms change within hours."""
    doubt: float = 1.0
    """Standard deviation of what the models leave unexplained, °C."""
    alike: float = 8.0
    """Difference of reading and estimate up to which anything is learned, °C."""
    alike_within: float = 2.0
    """The same difference in standard deviations of the estimate; the larger one counts."""

    def walk(self, age: float) -> float:
        """Of its random walk so long after the start (s), °C/√s."""
        return self.at_first + (self.later - self.at_first) * min(
            1.0, age / self.warmed_up
        )


class Caution(Rule):
    """How far the estimate may be beyond set-point and reading.

    No plate should get further than 15 °C, so a margin of 13 °C is meant for a plant that is known. What the
    first readings teach may be a lie: the estimate, whose standard deviation is 1.5 to 5 °C, may be too low
    by `too_low` of these. And a sensor that reads a quarter too little looks like a plant that needs a third
    more drive, so of being `weaker` a plant is believed a part only. Both fade: a lie that has begun early
    has shown itself after an hour, while a room that cools by 12 °C then needs a margin of more than that.
    """

    too_low: float = 2.5
    """Standard deviations that the margin shrinks by at the start: the estimate may be too low by that."""
    weaker: float = 0.3
    """Of a plant that needs more drive than the typical one, the part that is not believed at the start."""
    fades: float = 2400.0
    """Time constant with which both become less, s."""
    too_high: float = 1.2
    """Standard deviations that the margin has at least: a healthy plant may look too hot by that."""
    least: float = 4.0
    """Smallest margin, °C."""
    closes: float = 3.0
    """Part of the margin in which the limit closes, °C."""
    harmless: float = 42.0
    """Set-points below it count as this one, °C: a plate is not hot yet where it gets from there."""
    starts: float = 1200.0
    """Time after a start in which the set-point counts only as far as the reading follows it, s."""
    ahead: float = 2.0
    """How far above the reading it counts until then, °C."""
    unlikely: float = 2.7
    """Distance from the typical plant, in standard deviations of all weights together, beyond which no plant
    of the kind is: healthy ones within ± 25 % are learned to be within 2.7, while lies lead to 4 and 5."""
    no_limit: float = 150.0
    """Margin from which nothing is limited, °C."""
    seen: float = 2.0
    """Change of the reading that shows that the sensor sees the plant, °C."""
    blind: float = 10.0
    """Margin until the reading has changed so far, °C."""
    blind_within: float = 3.0
    """The same margin in standard deviations; the larger one counts."""


WANDER: Final = SensorWander()
CAUTION: Final = Caution()


class Ceiling:
    """Limits the drive where it takes the plant beyond both set-point and reading.

    The limit closes linearly over the last degrees of the margin, so in between lies a temperature at which
    it lets pass just what holds the plant there. Heating up is free until then. As long as no reading has
    moved, the set-point does not count: nobody knows whether the sensor sees the plant.
    """

    estimate = math.nan
    """Output to which the drive has taken the plant."""
    deviation = 0.0
    """Standard deviation of the estimate."""
    share = 1.0
    """Of the full drive, what may pass."""

    def __init__(
        self,
        margin: float,
        deviations: FloatArray,
        *,
        mean: FloatArray | None = None,
        seen: bool = False,
    ) -> None:
        """Start with a likeness and how much it may be wrong, both of shape (n,).

        Args:
            margin: highest estimate beyond set-point and reading, °C.
            deviations: how much plants of this kind differ.
            mean: which of them this plant is like; by default the typical one.
            seen: whether readings have moved.
        """
        self.seen = seen
        """Whether readings have moved."""
        self._margin = margin
        self._deviations = deviations
        self._beliefs = Likeness(np.append(deviations, WANDER.off))
        if mean is not None:
            self._beliefs.mean[:-1] = mean
        self._first = math.nan
        self._age = 0.0  # s

    def take(
        self,
        slopes: FloatArray,
        typical: float,
        reading: float,
        reference: float,
        *,
        learns: bool = True,
        at_least: float = -math.inf,
    ) -> None:
        """Take one comparison.

        Nothing is learned unless it `learns`, under a limit, or from a reading that is far from the estimate.
        The estimate is `at_least` that of an observer that the reading contradicts; doubt does not fade then.
        """
        doubt = 1.0 if at_least > -math.inf else self._early()
        self.estimate = max(typical + self._moved(slopes), at_least)
        _, self.deviation = self._beliefs.moves(np.append(slopes, 0.0))
        self._see(reading)
        self.share = (
            1.0
            if self._margin >= CAUTION.no_limit
            else self._share(reading, reference, doubt)
        )
        self._wander()
        alike_within = max(WANDER.alike, WANDER.alike_within * self.deviation)
        if (
            learns
            and self.seen
            and self.share >= 1.0
            and abs(reading - self.estimate) <= alike_within
        ):
            self._beliefs.learn(np.append(slopes, 1.0), reading - typical, WANDER.doubt)

    @property
    def off(self) -> float:
        """By how much the sensor is off, if it is the sensor, °C."""
        return float(self._beliefs.mean[-1])

    def _early(self) -> float:
        """What is left of the doubt of the start: from 1 to 0."""
        return math.exp(-self._age / CAUTION.fades)

    def _moved(self, slopes: FloatArray) -> float:
        """By how much the plant is believed to be hotter than the typical one, °C."""
        moved = float(slopes @ self._beliefs.mean[:-1]) * self._plausible()
        return moved if moved > 0.0 else moved * (1.0 - CAUTION.weaker * self._early())

    def _plausible(self) -> float:
        """The share of what was learned that a plant of this kind can be."""
        distance = float(np.linalg.norm(self._beliefs.mean[:-1] / self._deviations))
        return min(1.0, CAUTION.unlikely / max(distance, CAUTION.unlikely))

    def _see(self, reading: float) -> None:
        if math.isnan(self._first):
            self._first = reading
        self.seen = self.seen or abs(reading - self._first) >= CAUTION.seen

    def _share(self, reading: float, reference: float, doubt: float) -> float:
        """What may pass: all as long as the estimate is far enough below its highest value, then less."""
        deviation = self.deviation
        if self.seen:
            level = self._level(reading, reference)
            cautious = self._margin - CAUTION.too_low * doubt * deviation
            margin = max(cautious, CAUTION.too_high * deviation, CAUTION.least)
            closes = CAUTION.closes
        else:
            level = reading
            margin = max(CAUTION.blind, CAUTION.blind_within * deviation)
            closes = margin / 2.0
        return min(1.0, max(0.0, (level + margin - self.estimate) / closes))

    def _level(self, reading: float, reference: float) -> float:
        """The temperature beyond which the margin lies, °C."""
        if self._age < CAUTION.starts:
            reference = min(reference, reading + CAUTION.ahead)
        return max(reading, reference, CAUTION.harmless)

    def _wander(self) -> None:
        """Let a sample's time pass for the sensor."""
        beliefs = self._beliefs
        self._age += PERIOD
        share_kept = 1.0 - PERIOD / WANDER.follows
        beliefs.mean[-1] *= share_kept
        beliefs.covariance[-1, :] *= share_kept
        beliefs.covariance[:, -1] *= share_kept
        beliefs.covariance[-1, -1] += WANDER.walk(self._age) ** 2 * PERIOD
