"""The gate between a match and the family of candidates: whether a fit may be used.

The checks are made in this order, and the first that fails gives the status:

1. Did the set-point move, and early enough? Otherwise no fit is made.
2. Does the best fit explain the window at all? If not, its parameters mean nothing, whatever the other checks
   give. Faults of the plant are then named by the health monitor, not by the gate.
3. Did the fit converge? If not, bounds and covariance are those of an intermediate point.
4. Did a parameter end on its bound? Then the bound determines it, not the data. A bound of zero is different:
   it is a physical limit, and mostly means that the window does not determine the parameter (see 5).
5. Are the parameters determined by this window? One that is not is kept near its previous value, because the
   twin predicts equally well along the whole valley; the check is repeated for the others. A state at the
   window's start need not be: its uncertainty is part of that of the parameters.
6. Do they predict the held-back samples no worse than the incumbent?
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from twinmatch.dynamics import Law
from twinmatch.fitting.data import FittingError
from twinmatch.fitting.problem import Unknown
from twinmatch.signals import FloatArray


class Status(Enum):
    """Result of a match."""

    ACCEPTED = "accepted"
    NOT_EXPLAINED = "not_explained"
    NO_EXCITATION = "no_excitation"
    DID_NOT_CONVERGE = "did_not_converge"
    BOUNDS_HIT = "bounds_hit"
    NOT_IDENTIFIABLE = "not_identifiable"
    NOT_BETTER = "not_better"


@dataclass(frozen=True)
class GateLimits:
    """Limits of the gate.

    The limit on the residuals is based on hours of one rig: two-regime windows of a healthy plant give 0.5 to
    8, the cold start of a session 12; a window with a lost drive gives 130 and more.

    Raises:
        FittingError: a limit is out of range.
    """

    chi2: float = 40.0
    """Mean squared weighted residual above which the best fit does not explain the window."""
    driven: float = 4.0
    """Factor on it for a driven twin: no controller takes its errors back."""
    relative_error: float = 0.5
    """Largest standard error of a free parameter relative to its value, a kept one being known."""
    condition: float = 1000.0
    """Largest condition number of the scaled Jacobian."""
    slack: float = 1.1
    """Factor by which chance may make the held-back residuals larger than the incumbent's."""
    held_back: float = 0.3
    """Share of the window that is held back from the test fit."""
    least_seen: float = 0.9
    """Least share of the window's samples that were received."""
    least_samples: int = 20
    """Least samples between the first excitation and the held-back part, and in that part."""

    def most(self, law: Law | None) -> float:
        """The largest mean squared weighted residual of a twin in this loop that explains a window."""
        return self.chi2 * (self.driven if law is None else 1.0)

    def __post_init__(self) -> None:
        for name in (
            "chi2",
            "relative_error",
            "condition",
            "slack",
            "least_samples",
            "driven",
        ):
            if not getattr(self, name) > 0:
                raise FittingError(
                    f"gate: the limit {name} is {getattr(self, name)}; it must be positive"
                )
        for name in ("held_back", "least_seen"):
            if not 0 < getattr(self, name) < 1:
                msg = f"gate: {name} is {getattr(self, name)}; give a share of the window between 0 and 1"
                raise FittingError(msg)


@dataclass(frozen=True, eq=False)
class FitEvidence:
    """The figures that the gate checks after a fit."""

    free: tuple[Unknown, ...]
    """The fitted unknowns, except the kept one."""
    values: FloatArray
    standard_errors: FloatArray
    condition: float
    bounds_hit: tuple[str, ...]
    converged: bool
    chi2: float
    held_back_chi2: float
    """Mean squared weighted residual of the test fit on the held-back part."""
    incumbent_chi2: float
    """The same for the incumbent, or for the start values if there is none."""
    kept: str = ""
    """The parameter kept because the window does not determine it, with value and interval; or empty."""
    most: float = GateLimits.chi2
    """The largest `chi2` that explains the window."""
    confused: tuple[str, ...] = ()
    """Free parameters that hardly show apart."""
    still: str = ""
    """Which inputs stood still all the time, in words."""


def first_excited(moved: FloatArray, least: float) -> int | None:
    """Position of the first sample at which a signal, shape (N,), has moved by `least` since the second, or
    None."""
    signal = moved[1:]
    if not signal.size:
        return None
    span = np.maximum.accumulate(signal) - np.minimum.accumulate(signal)
    far = np.flatnonzero(span >= least)
    return int(far[0]) + 1 if far.size else None


def judge(evidence: FitEvidence, limits: GateLimits) -> tuple[Status, str]:
    """The status of a fit, and a sentence with the reason."""
    # Negated comparisons, so that residuals that are not numbers count as not explained.
    if not evidence.chi2 <= evidence.most:
        return Status.NOT_EXPLAINED, (
            f"even the best fit leaves residuals of {evidence.chi2:.3g} times the noise variance, more than "
            f"{evidence.most:g}: the plant did something that the model cannot"
        )
    if not evidence.converged:
        return (
            Status.DID_NOT_CONVERGE,
            "least squares did not converge within its number of evaluations",
        )
    if evidence.bounds_hit:
        return Status.BOUNDS_HIT, _bounds_sentence(evidence)
    loose = _loose_sentence(evidence, limits)
    if loose:
        return Status.NOT_IDENTIFIABLE, loose
    if not evidence.held_back_chi2 <= limits.slack * evidence.incumbent_chi2:
        return Status.NOT_BETTER, (
            f"on the held-back samples the residuals are {evidence.held_back_chi2:.3g} times the noise "
            f"variance, with the present parameters only {evidence.incumbent_chi2:.3g}"
        )
    return Status.ACCEPTED, (
        f"explains the window down to {evidence.chi2:.3g} times the noise variance and predicts the "
        f"held-back samples ({evidence.held_back_chi2:.3g}, parameters before: {evidence.incumbent_chi2:.3g})"
        + (f"; not determined and kept: {evidence.kept}" if evidence.kept else "")
    )


def _bounds_sentence(evidence: FitEvidence) -> str:
    named = {
        u.name: value
        for u, value in zip(evidence.free, evidence.values.tolist(), strict=True)
    }
    return ", ".join(
        f"{name} ended on its bound at {named[name]:.3g}"
        for name in evidence.bounds_hit
    )


def _loose_sentence(evidence: FitEvidence, limits: GateLimits) -> str | None:
    """A sentence on a parameter or a combination that is not determined; None if all are."""
    if evidence.condition <= limits.condition:
        return undetermined(
            evidence.free, evidence.values, evidence.standard_errors, limits
        )
    which = ", ".join(evidence.confused) or "the free parameters"
    if len(evidence.confused) != 1:
        which = f"some combination of {which}"
    reason = (
        f"the condition number {evidence.condition:.3g} is above {limits.condition:g}: "
        f"{which} hardly shows in this window"
    )
    return f"{reason}; {evidence.still}" if evidence.still else reason


def undetermined(
    free: Sequence[Unknown],
    values: FloatArray,
    standard_errors: FloatArray,
    limits: GateLimits,
) -> str | None:
    """A sentence on a parameter that is not determined; None if all are."""
    for unknown, value, error in zip(
        free, values.tolist(), standard_errors.tolist(), strict=True
    ):
        size = abs(value) if unknown.relative else unknown.scale
        if not unknown.initial and not (
            math.isfinite(error) and error <= limits.relative_error * size
        ):
            return f"{unknown.name} is {value:.3g} ± {error:.1g}: this window does not determine it"
    return None
