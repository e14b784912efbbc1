"""Between which temperatures the nominal twin has been seen to hold.

The session is cut into stretches of as many samples as the trust level looks at. Over each of them both
twins of the nominal candidate are run, as for the trust level; where neither residual is doubtful, the twin
held, and the temperatures that the plate went through there count. So do those of the window it was matched
on. Of all these temperatures the range is the part that hangs together with that window: a twin that held
at 30 and at 90 °C but not between is not to be trusted at 60.

The range says where there is evidence, not where the physics ends. Nothing outside it was tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from twinmatch.discrimination import CandidateScore
from twinmatch.dynamics import PidGains
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import TrustLimits, residuals

__all__ = ["TrustRange", "trust_range"]

_NEIGHBOURS = 1.0
"""Spans of temperature closer than this hang together, °C: a sample of a fast step is that far apart."""


class TrustRange(NamedTuple):
    """Lowest and highest output."""

    low: float
    high: float
    unit: str = "°C"

    def __str__(self) -> str:
        """Whole numbers, rounded to the inside."""
        return f"{math.ceil(self.low)} and {math.floor(self.high)} {self.unit}".rstrip()


def trust_range(
    samples: Sequence[Sample],
    nominal: CandidateScore,
    gains: PidGains,
    limits: TrustLimits | None = None,
    stride: int = 60,
) -> TrustRange | None:
    """Between which temperatures this candidate's twin held in a session; None if it never did.

    Args:
        samples: the session; stretches between gaps are looked at one by one.
        nominal: the candidate.
        gains: of the plant's controller.
        limits: residuals from which the twin is doubtful.
        stride: samples that are judged together.
    """
    limits = limits or TrustLimits()
    matched = [s.output for s in samples if nominal.first <= s.index <= nominal.last]
    spans = list(_held(samples, nominal, gains, limits, stride))
    home = (min(matched), max(matched)) if matched else _nearest(spans, nominal.operating_point)
    unit = nominal.parameters.model.plant.output.unit
    return None if home is None else _joined(home, spans, unit)


def _held(
    samples: Sequence[Sample], nominal: CandidateScore, gains: PidGains, limits: TrustLimits, stride: int
) -> Iterable[tuple[float, float]]:
    """Lowest and highest temperature of every stretch in which the twin held."""
    for whole in unbroken(samples):
        for begin in range(0, len(whole), stride):
            window = Window.from_samples(whole[begin : begin + stride], gains.period)
            found = residuals(nominal.parameters, window, gains)
            if found.y < limits.doubtful_y and found.u < limits.doubtful_u:
                yield float(np.min(window.output)), float(np.max(window.output))


def _nearest(spans: Sequence[tuple[float, float]], temperature: float) -> tuple[float, float] | None:
    """The span that holds this temperature or is nearest to it."""
    return min(spans, key=lambda s: max(s[0] - temperature, temperature - s[1], 0.0), default=None)


def _joined(home: tuple[float, float], spans: Sequence[tuple[float, float]], unit: str) -> TrustRange:
    """`home` and all that hangs together with it."""
    low, high = home
    for span in sorted(spans):
        if span[0] <= high + _NEIGHBOURS and span[1] >= low:
            high = max(high, span[1])
    for span in sorted(spans, key=lambda s: -s[1]):
        if span[1] >= low - _NEIGHBOURS and span[0] <= high:
            low = min(low, span[0])
    return TrustRange(low, high, unit)
