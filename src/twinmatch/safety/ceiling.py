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
from typing import Final

import numpy as np

from twinmatch.safety.likeness import PERIOD, Likeness
from twinmatch.signals import FloatArray

WANDERS: Final = 0.3
"""How fast a sensor may wander once the plant has warmed up, °C/√s: 7 °C in ten minutes."""
WANDERS_AT_FIRST: Final = 0.05
"""How fast it may wander at the start, °C/√s: what the first response shows is the plant."""
WARMED_UP: Final = 300.0
"""Time after which it may wander that fast, s: rigs and kits have settled by then."""
OFF_AT_FIRST: Final = 0.5
"""Standard deviation of what a sensor is off at the start, °C."""
FOLLOWS: Final = 14_400.0
"""Time constant with which a difference that stays becomes the plant's, s: rooms change within hours."""
DOUBT: Final = 1.0
"""Standard deviation of what the models leave unexplained, °C."""
ALIKE: Final = 8.0
"""Difference of reading and estimate up to which anything is learned, °C, or …"""
ALIKE_WITHIN: Final = 2.0
"""… so many standard deviations of the estimate, if that is more."""
TOO_LOW: Final = 1.7
"""Standard deviations that the margin shrinks by at the start: the estimate may be too low by that."""
TRUSTED_AFTER: Final = 2400.0
"""Time constant with which these become fewer, s: a lie that has begun early has shown itself by then, while
a room that cools later must not find a margin that is smaller than what it cools by."""
STARTS: Final = 1200.0
"""Time after a start in which the set-point counts only as far as the reading follows it, s."""
AHEAD: Final = 2.0
"""How far above the reading it counts until then, °C."""
TOO_HIGH: Final = 1.2
"""Standard deviations that the margin has at least: a healthy plant may look too hot by that."""
LEAST: Final = 5.0
"""Smallest margin, °C."""
CLOSES: Final = 3.0
"""Part of the margin in which the limit closes, °C."""
HARMLESS: Final = 42.0
"""Set-points below it count as this one, °C: a plate is not hot yet where it gets from there."""
NO_LIMIT: Final = 150.0
"""Margin from which nothing is limited, °C."""
UNLIKELY: Final = 2.7
"""Distance from the typical plant, in standard deviations of all weights together, beyond which no plant of
the kind is: healthy ones within ± 25 % are learned to be within 2.7, while lies lead to 4 and 5."""
SEEN: Final = 2.0
"""Change of the reading that shows that the sensor sees the plant, °C."""
BLIND: Final = 10.0
"""Margin until then, °C, or …"""
BLIND_WITHIN: Final = 3.0
"""… so many standard deviations, if that is more."""


class Ceiling:
    """Limits the drive where it takes the plant beyond both set-point and reading.

    The limit closes linearly over the last degrees of the margin, so in between lies a temperature at which
    it lets pass just what holds the plant there. Heating up is free until then. As long as no reading has
    moved, the set-point does not count: nobody knows whether the sensor sees the plant.
    """

    estimate = math.nan
    """Output to which the drive has taken the plant."""
    share = 1.0
    """Of the full drive, what may pass."""

    def __init__(
        self, margin: float, deviations: FloatArray, *, mean: FloatArray | None = None, seen: bool = False
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
        self._beliefs = Likeness(np.append(deviations, OFF_AT_FIRST))
        if mean is not None:
            self._beliefs.mean[:-1] = mean
        self._first = math.nan
        self._age = 0.0  # s

    def take(
        self, slopes: FloatArray, typical: float, reading: float, reference: float, *, learns: bool = True
    ) -> None:
        """Take one comparison; nothing is learned unless it `learns`, under a limit, or from a reading that
        is far from the estimate."""
        moved, deviation = self._beliefs.moves(np.append(slopes, 0.0))
        self.estimate = typical + moved * self._plausible()
        self._see(reading)
        self.share = 1.0 if self._margin >= NO_LIMIT else self._share(reading, reference, deviation)
        self._wander()
        alike = abs(reading - self.estimate) <= max(ALIKE, ALIKE_WITHIN * deviation)
        if learns and alike and self.seen and self.share >= 1.0:
            self._beliefs.learn(np.append(slopes, 1.0), reading - typical, DOUBT)

    @property
    def off(self) -> float:
        """By how much the sensor is off, if it is the sensor, °C."""
        return float(self._beliefs.mean[-1])

    def _plausible(self) -> float:
        """The share of what was learned that a plant of this kind can be."""
        distance = float(np.linalg.norm(self._beliefs.mean[:-1] / self._deviations))
        return min(1.0, UNLIKELY / max(distance, UNLIKELY))

    def _see(self, reading: float) -> None:
        if math.isnan(self._first):
            self._first = reading
        self.seen = self.seen or abs(reading - self._first) >= SEEN

    def _share(self, reading: float, reference: float, deviation: float) -> float:
        """What may pass: all as long as the estimate is far enough below its highest value, then less."""
        if self.seen:
            level = self._level(reading, reference)
            too_low = TOO_LOW * math.exp(-self._age / TRUSTED_AFTER)
            margin = max(self._margin - too_low * deviation, TOO_HIGH * deviation, LEAST)
            closes = CLOSES
        else:
            level = reading
            margin = max(BLIND, BLIND_WITHIN * deviation)
            closes = margin / 2.0
        return min(1.0, max(0.0, (level + margin - self.estimate) / closes))

    def _level(self, reading: float, reference: float) -> float:
        """The temperature beyond which the margin lies, °C."""
        if self._age < STARTS:
            reference = min(reference, reading + AHEAD)
        return max(reading, reference, HARMLESS)

    def _wander(self) -> None:
        """Let a sample's time pass for the sensor."""
        beliefs = self._beliefs
        self._age += PERIOD
        warm = min(1.0, self._age / WARMED_UP)
        wanders = WANDERS_AT_FIRST + (WANDERS - WANDERS_AT_FIRST) * warm
        kept = 1.0 - PERIOD / FOLLOWS
        beliefs.mean[-1] *= kept
        beliefs.covariance[-1, :] *= kept
        beliefs.covariance[:, -1] *= kept
        beliefs.covariance[-1, -1] += wanders**2 * PERIOD
