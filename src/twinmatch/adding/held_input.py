"""A drive that stood at one level for nearly all of a recording, which shows gain and rest only together."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from twinmatch.signals import FloatArray

_STOOD: Final = 0.9
"""Share of the samples at one level from which a drive counts as held."""


class GainAndRest(NamedTuple):
    """The gain, output per unit of the input, and the output without input."""

    gain: float
    rest: float


def is_held(drive: FloatArray) -> bool:
    """Whether a drive, shape (N,), stood at one level for nearly all of the time."""
    _, counts = np.unique(drive, return_counts=True)
    return bool(counts.max() >= _STOOD * drive.size)


def begun_at_rest(
    reading: FloatArray, drive: FloatArray, final: float
) -> GainAndRest | None:
    """Gain and rest if the output rested at its first readings, and tends to `final` since the drive stands
    where it is held; None if the drive stands where it began, or at zero."""
    levels, counts = np.unique(drive, return_counts=True)
    held_level = float(levels[np.argmax(counts)])
    is_before = np.cumsum(drive == held_level) == 0
    if is_before.any():
        level_before = float(drive[0])
        output_before = float(np.mean(reading[is_before]))
    else:
        level_before = 0.0
        output_before = float(reading[0])
    if held_level == level_before:
        return None
    gain = (final - output_before) / (held_level - level_before)
    return GainAndRest(gain, output_before - gain * level_before)
