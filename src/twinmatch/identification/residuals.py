"""What prediction errors should look like: white, and unrelated to the inputs that came before."""

from __future__ import annotations

from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.identification.data import checked_pair
from twinmatch.identification.errors import IdentificationError
from twinmatch.signals import FloatArray

__all__ = ["ResidualTest", "examine_residuals"]


class ResidualTest(NamedTuple):
    """Correlations of prediction errors e, each test with the probability of a worse value by chance."""

    autocorrelation: FloatArray
    """Of e at lags 1 … L, shape (L,)."""
    autocorrelation_limit: float
    """A single lag of white e stays below this with the confidence asked for."""
    whiteness: float
    """Probability of the Ljung–Box statistic; small: e is not white."""
    cross_correlation: FloatArray
    """Of e(t) with u(t − k), k = 0 … L, shape (L + 1,)."""
    cross_correlation_limit: float
    """A single lag stays below this where e and u are unrelated."""
    independence: float
    """Probability of the cross-correlations together; small: B/F misses something of the input."""
    confidence: float
    """The confidence asked for."""

    @property
    def white(self) -> bool:
        """Whether e passes as white."""
        return self.whiteness >= 1.0 - self.confidence

    @property
    def independent(self) -> bool:
        """Whether e passes as unrelated to past inputs."""
        return self.independence >= 1.0 - self.confidence


def examine_residuals(
    errors: ArrayLike, u: ArrayLike, *, fitted: int = 0, lags: int = 25, confidence: float = 0.99
) -> ResidualTest:
    """Whiteness and input cross-correlation of prediction errors (Ljung, System Identification, 16.6).

    Args:
        errors: e, shape (N,).
        u: input, shape (N,).
        fitted: coefficients of C and D, taken off the degrees of freedom of the whiteness test.
        lags: L.
        confidence: of the limits and verdicts.

    Raises:
        IdentificationError: signals that are no pair, or too short for the lags.
    """
    u, e = checked_pair(u, errors)
    count = e.size
    if not 1 <= lags < count // 2:
        msg = f"residuals: {lags} lags need more than {2 * max(lags, 1) + 1} samples; there are {count}"
        raise IdentificationError(msg)
    e = e - np.mean(e)
    u = u - np.mean(u)
    autocovariance = _covariances(e, e, lags)
    power = autocovariance[0] if autocovariance[0] > 0.0 else 1.0
    r = autocovariance[1:] / power
    q = count * (count + 2) * float(np.sum(r**2 / (count - np.arange(1, lags + 1))))
    input_covariance = _covariances(u, u, lags)
    cross = _covariances(e, u, lags)
    spacing = np.abs(np.subtract.outer(np.arange(lags + 1), np.arange(lags + 1)))
    weights = np.linalg.lstsq(input_covariance[spacing], cross, rcond=1e-10)
    unit = float(np.sqrt(power * input_covariance[0])) or 1.0
    # Coloured errors make chance correlations larger: the variance of one lag is Σ r_e(τ) r_u(τ) / N.
    spread = power * input_covariance[0] + 2.0 * float(autocovariance[1:] @ input_covariance[1:])
    width = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    return ResidualTest(
        autocorrelation=r,
        autocorrelation_limit=width / count**0.5,
        whiteness=_chance(q, max(lags - fitted, 1)),
        cross_correlation=cross / unit,
        cross_correlation_limit=width * (max(spread, 0.0) / count) ** 0.5 / unit,
        independence=_chance(count / power * float(cross @ weights[0]), int(weights[2])),
        confidence=confidence,
    )


def _chance(statistic: float, freedom: int) -> float:
    """Probability that χ² of these degrees of freedom is larger; NaN where there are none."""
    from scipy.special import chdtrc  # noqa: PLC0415 — scipy.stats has it too, after half a second of imports

    return float(chdtrc(freedom, max(statistic, 0.0))) if freedom > 0 else float("nan")


def _covariances(a: FloatArray, b: FloatArray, lags: int) -> FloatArray:
    """Mean of a(t) b(t − k) for k = 0 … lags."""
    return np.array([float(a[k:] @ b[: b.size - k]) / a.size for k in range(lags + 1)])
