"""What a plant with several signals has shown, been asked for and been believed to be, as far back as changes may
have begun."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from twinmatch.health.acting_inputs import CROSSING
from twinmatch.health.change_table import BETWEEN_ONSETS
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class _Remembered(Rule):
    """How far back is remembered; times in s of a plant as fast as the rig."""

    reach: float = 480.0
    """Age after which the onset of a change is forgotten."""
    before: float = 30.0
    """Time before the onset of a change at which the plant is taken to have been as before: a change is often said
    to have begun some seconds late, when it has been learned in part."""


REMEMBERED: Final = _Remembered()


class RecentSamples:
    """The newest samples since the last gap, and what was believed when changes began to be followed."""

    def __init__(self, second: float, latest: int) -> None:
        """Begin with none.

        Args:
            second: samples in a second of a plant as fast as the rig.
            latest: samples by which an input may act later than the equations say.
        """
        self._samples_before_onset = REMEMBERED.before * second
        self.between_onsets = max(1, round(BETWEEN_ONSETS * second))
        """Number of samples between two onsets."""
        self.reach = round(REMEMBERED.reach * second)
        """Age after which the onset of a change is forgotten, samples."""
        believed = (REMEMBERED.reach + REMEMBERED.before) * second
        of_onsets = math.ceil(believed / self.between_onsets) + 1
        with_arrival = round((REMEMBERED.reach + CROSSING.usual) * second)
        with_jump = round((REMEMBERED.reach + 4.0 * BETWEEN_ONSETS) * second) + 3
        self._beliefs = deque[FloatArray](maxlen=of_onsets)
        self._commands = deque[FloatArray](maxlen=self.reach + latest)
        self._arrived = deque[FloatArray](maxlen=with_arrival)
        self._readings = deque[FloatArray](maxlen=with_jump)

    def restart(self) -> None:
        """Forget all, after a gap."""
        self._beliefs.clear()
        self._commands.clear()
        self._arrived.clear()
        self._readings.clear()

    def take(self, readings: FloatArray, commands: FloatArray) -> None:
        """Take the readings of a sample, shape (o,), and the commands, shape (m,), as distances from rest."""
        self._readings.append(readings)
        self._commands.append(commands)

    def take_arrived(self, arrived: FloatArray) -> None:
        """Take what arrives in that sample of each drive at the places of the others, shape (m,)."""
        self._arrived.append(arrived)

    def take_belief(self, belief: FloatArray) -> None:
        """Take what is believed at an onset, shape (N,)."""
        self._beliefs.append(belief)

    @property
    def commands(self) -> FloatArray:
        """The newest commands as distances from rest, shape (k, m), the newest last."""
        return np.array(self._commands)

    @property
    def arrived(self) -> FloatArray:
        """What arrived of each drive at the places of the others, shape (k, m), the newest last."""
        return np.array(self._arrived)

    def readings_of(self, output: int) -> FloatArray:
        """The newest readings of an output, shape (k,), the newest last."""
        return np.array([readings[output] for readings in self._readings])

    def believed_before(self, age: int) -> FloatArray | None:
        """What was believed before a change that began so many samples ago, shape (N,); the oldest belief that is
        remembered if that is too long ago, None if there is none at all."""
        if not self._beliefs:
            return None
        onsets_ago = math.ceil((age + self._samples_before_onset) / self.between_onsets)
        newest = len(self._beliefs) - 1
        return self._beliefs[max(newest - onsets_ago, 0)]
