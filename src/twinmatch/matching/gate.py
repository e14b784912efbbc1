"""Whether a fit may be used: the gate between a window and the family of candidates.

The questions are asked in this order, and the first that is answered badly names the status:

1. Did the set-point move, and early enough? Without that no fit is made.
2. Can the best fit explain the window at all? If not, its parameters mean nothing, whatever the rest says.
   What is wrong with the plant then, the health monitor says and not the gate.
3. Did the fit converge? If not, bounds and covariance are those of a point on the way.
4. Did a parameter end on its bound? Then the search ended there and not the data. Zero is another matter:
   there physics ends, and it mostly says that the window does not show the parameter (see 5).
5. Are the parameters determined by this window? One that is not is kept near what stood before, because
   the twin predicts well all along the valley that leaves it open; the question is put to the others.
6. Do they predict what was held back no worse than the incumbent?
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from twinmatch.matching.bounds import MatchingError, Unknown
from twinmatch.signals import FloatArray

__all__ = ["Evidence", "Limits", "Status", "first_excited", "judge", "undetermined"]


class Status(Enum):
    """What became of a match."""

    ACCEPTED = "accepted"
    NOT_EXPLAINED = "not_explained"
    NO_EXCITATION = "no_excitation"
    DID_NOT_CONVERGE = "did_not_converge"
    BOUNDS_HIT = "bounds_hit"
    NOT_IDENTIFIABLE = "not_identifiable"
    NOT_BETTER = "not_better"


@dataclass(frozen=True)
class Limits:
    """Where the gate closes.

    That on the residuals comes from hours of one rig: two-regime windows of a healthy plant leave 0.5 to 8,
    at the cold start of a session 12; a window with a lost drive leaves 130 and more.

    Raises:
        MatchingError: a limit has no meaning.
    """

    chi2: float = 40.0
    """Mean squared weighed residual above which the best fit does not explain the window."""
    relative_error: float = 0.5
    """Largest standard error of a free parameter in units of its value, a kept one being known."""
    condition: float = 1000.0
    """Largest condition number of the scaled Jacobian."""
    slack: float = 1.1
    """Factor by which chance may make the held-back part worse than the incumbent leaves it."""
    held_back: float = 0.3
    """Part of the window that the test fit does not see."""
    least_samples: int = 20
    """Samples wanted between the first excitation and the held-back part, and in that part."""

    def __post_init__(self) -> None:
        for name in ("chi2", "relative_error", "condition", "slack", "least_samples"):
            if not getattr(self, name) > 0:
                msg = f"gate: the limit {name} is {getattr(self, name)}; it must be positive"
                raise MatchingError(msg)
        if not 0 < self.held_back < 1:
            msg = f"gate: held_back is {self.held_back}; it is a part of the window between 0 and 1"
            raise MatchingError(msg)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the gate looks at once a fit was made."""

    free: tuple[Unknown, ...]
    """What was fitted, but the kept one."""
    values: FloatArray
    standard_errors: FloatArray
    condition: float
    bounds_hit: tuple[str, ...]
    converged: bool
    chi2: float
    held_back_chi2: float
    """Mean squared weighed residual of the test fit on the held-back part."""
    incumbent_chi2: float
    """The same of the incumbent, or of the start values if there is none."""
    kept: str = ""
    """What was kept because the window does not determine it, with value and interval; or nothing."""


def first_excited(moved: FloatArray, least: float) -> int | None:
    """Position of the first sample by which a signal, shape (N,), has moved by `least` since the second, or
    None."""
    signal = moved[1:]
    if not signal.size:
        return None
    span = np.maximum.accumulate(signal) - np.minimum.accumulate(signal)
    far = np.flatnonzero(span >= least)
    return int(far[0]) + 1 if far.size else None


def judge(evidence: Evidence, limits: Limits) -> tuple[Status, str]:
    """The status of a fit and one sentence why."""
    # Written so that residuals that are not numbers count as not explained.
    if not evidence.chi2 <= limits.chi2:
        return Status.NOT_EXPLAINED, (
            f"even the best fit leaves {evidence.chi2:.3g} times the noise variance, more than "
            f"{limits.chi2:g}: the plant did something the model cannot"
        )
    if not evidence.converged:
        return Status.DID_NOT_CONVERGE, "least squares was still moving when its evaluations ran out"
    if evidence.bounds_hit:
        return Status.BOUNDS_HIT, _bounds_sentence(evidence)
    loose = undetermined(evidence.free, evidence.values, evidence.standard_errors, evidence.condition, limits)
    if loose:
        return Status.NOT_IDENTIFIABLE, loose
    if not evidence.held_back_chi2 <= limits.slack * evidence.incumbent_chi2:
        return Status.NOT_BETTER, (
            f"on the held-back samples the fit leaves {evidence.held_back_chi2:.3g} times the noise "
            f"variance, the parameters that stand only {evidence.incumbent_chi2:.3g}"
        )
    return Status.ACCEPTED, (
        f"explains the window down to {evidence.chi2:.3g} times the noise variance and predicts what was "
        f"held back ({evidence.held_back_chi2:.3g}, the parameters before: {evidence.incumbent_chi2:.3g})"
        + (f"; not determined and kept: {evidence.kept}" if evidence.kept else "")
    )


def _bounds_sentence(evidence: Evidence) -> str:
    named = {u.name: value for u, value in zip(evidence.free, evidence.values.tolist(), strict=True)}
    return ", ".join(f"{name} ended on its bound at {named[name]:.3g}" for name in evidence.bounds_hit)


def undetermined(
    free: Sequence[Unknown],
    values: FloatArray,
    standard_errors: FloatArray,
    condition: float,
    limits: Limits,
) -> str | None:
    """One sentence on a parameter or combination that is not determined; None if all are."""
    if not condition <= limits.condition:
        return (
            f"the condition number {condition:.3g} is above {limits.condition:g}: "
            "some combination of the free parameters hardly shows in this window"
        )
    for unknown, value, error in zip(free, values.tolist(), standard_errors.tolist(), strict=True):
        size = abs(value) if unknown.relative else unknown.scale
        if not (math.isfinite(error) and error <= limits.relative_error * size):
            return f"{unknown.name} is {value:.3g} ± {error:.1g}: this window does not determine it"
    return None
