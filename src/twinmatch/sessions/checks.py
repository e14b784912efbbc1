"""Checks of a session's samples: finite values, gaps, sampling period."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from twinmatch.sessions.errors import SessionError
from twinmatch.signals import Sample

__all__ = ["check_samples", "gaps_of", "period_of", "rounded_period"]

VALUES = ("reference", "output", "input")


def check_samples(samples: Sequence[Sample], place: str) -> None:
    """Refuse samples that cannot be judged.

    Args:
        samples: the samples in the order they were taken.
        place: start of the error message, such as `session night_run`.

    Raises:
        SessionError: there are no samples, or a value is not finite.
    """
    if not samples:
        msg = f"{place}: has no samples"
        raise SessionError(msg)
    for sample in samples:
        for name in VALUES:
            value = getattr(sample, name)
            if not math.isfinite(value):
                msg = f"{place}: {name} of sample {sample.index} is {value}; only finite values can be used"
                raise SessionError(msg)


def gaps_of(samples: Sequence[Sample]) -> list[tuple[int, int]]:
    """Index before and index after every gap in the samples' indices."""
    return [(a.index, b.index) for a, b in pairwise(samples) if b.index != a.index + 1]


def period_of(samples: Sequence[Sample]) -> float:
    """Sampling period in seconds from the stamps of consecutive samples; 1 s if there are none.

    Raises:
        SessionError: the stamps do not advance.
    """
    steps = [b.stamp - a.stamp for a, b in pairwise(samples) if b.index == a.index + 1]
    if not steps:
        return 1.0
    mean = sum(steps) / len(steps) / 1e9
    if mean <= 0:
        msg = f"session: the stamps do not advance between samples {samples[0].index} and {samples[-1].index}"
        raise SessionError(msg)
    return rounded_period(mean)


def rounded_period(mean: float) -> float:
    """The nominal period of a loop, s, from its measured mean.

    Loops are set to whole milliseconds, and clocks and stamps are slightly off: a mean within half a percent
    of whole milliseconds is rounded to them, any other to the nanosecond.
    """
    whole = round(mean, 3)
    if whole > 0 and abs(mean - whole) <= 0.005 * whole:
        return whole
    return round(mean, 9)
