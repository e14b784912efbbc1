"""Akaike, Bayesian and description-length criteria of an identified model (paper, sections II-B and II-C).

All take the loss V = det(1/N Σ ε εᵀ) of the prediction errors (the plain mean square for one output), the
number of estimated parameters and the number of samples; smaller is better. The forms are those that the
paper's own table follows, which for nAIC and MDL differ from the printed ones: those are here under the names
`naic_as_printed` and `mdl_as_printed` for comparison only.

A loss of zero (the model predicts every sample exactly) gives −∞ in the logarithmic criteria and 0 in MDL:
no penalty on parameters outweighs a perfect prediction.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.comparing.errors import DiscriminationError

__all__ = ["aic", "bic", "loss", "mdl", "mdl_as_printed", "naic", "naic_as_printed"]


def loss(errors: ArrayLike) -> float:
    """V = det(1/N Σ ε εᵀ) of prediction errors, shape (N,) for one output or (N, n_y).

    Raises:
        DiscriminationError: no sample, a value that is not finite, or another shape.
    """
    table = np.asarray(errors, dtype=np.float64)
    if table.ndim == 1:
        table = table[:, np.newaxis]
    if table.ndim != 2 or not table.size:
        msg = f"loss: the errors have shape {np.shape(errors)}; give (N,) or (N, outputs)"
        raise DiscriminationError(msg)
    if not np.isfinite(table).all():
        bad = int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0])
        msg = f"loss: the error at sample {bad} is {table[bad].tolist()}; only finite values can be used"
        raise DiscriminationError(msg)
    # A product of squared singular values cannot become negative; a determinant by elimination can.
    singular = np.linalg.svd(table / math.sqrt(table.shape[0]), compute_uv=False)
    return float(np.prod(singular**2)) if table.shape[0] >= table.shape[1] else 0.0


def naic(loss: float, n_parameters: int, n_samples: int) -> float:
    """Normalised Akaike criterion, ln V + 2 n_p / N.

    Raises:
        DiscriminationError: a loss below zero or not finite, no samples, parameters below zero.
    """
    return _log(loss, n_parameters, n_samples) + 2 * n_parameters / n_samples


def aic(loss: float, n_parameters: int, n_samples: int, n_outputs: int = 1) -> float:
    """Akaike criterion, N ln V + 2 n_p + N (n_y ln 2π + 1); raises as `naic`."""
    return _likelihood(loss, n_parameters, n_samples, n_outputs) + 2 * n_parameters


def bic(loss: float, n_parameters: int, n_samples: int, n_outputs: int = 1) -> float:
    """Bayesian criterion, N ln V + N (n_y ln 2π + 1) + n_p ln N; raises as `naic`."""
    return _likelihood(loss, n_parameters, n_samples, n_outputs) + n_parameters * math.log(n_samples)


def mdl(loss: float, n_parameters: int, n_samples: int) -> float:
    """Minimum description length, V (1 + d ln N / N); raises as `naic`."""
    _check(loss, n_parameters, n_samples)
    return loss * (1 + n_parameters * math.log(n_samples) / n_samples)


def naic_as_printed(loss: float, n_parameters: int, n_samples: int) -> float:
    """The paper's printed nAIC, N ln V + 2 n_p / N, which its table does not follow; raises as `naic`."""
    return n_samples * _log(loss, n_parameters, n_samples) + 2 * n_parameters / n_samples


def mdl_as_printed(loss: float, n_parameters: int, n_samples: int) -> float:
    """The paper's printed MDL, V (1 + d/N) ln N, which its table does not follow; raises as `naic`."""
    _check(loss, n_parameters, n_samples)
    return loss * (1 + n_parameters / n_samples) * math.log(n_samples)


def _likelihood(loss: float, n_parameters: int, n_samples: int, n_outputs: int) -> float:
    if n_outputs < 1:
        msg = f"criteria: {n_outputs} outputs; give at least one"
        raise DiscriminationError(msg)
    return n_samples * (_log(loss, n_parameters, n_samples) + n_outputs * math.log(2 * math.pi) + 1)


def _log(loss: float, n_parameters: int, n_samples: int) -> float:
    _check(loss, n_parameters, n_samples)
    return math.log(loss) if loss > 0 else -math.inf


def _check(loss: float, n_parameters: int, n_samples: int) -> None:
    if not (math.isfinite(loss) and loss >= 0):
        msg = f"criteria: the loss is {loss}; give a mean square, finite and not negative"
        raise DiscriminationError(msg)
    if n_samples < 1 or n_parameters < 0:
        msg = f"criteria: {n_parameters} parameters and {n_samples} samples; give at least 0 and 1"
        raise DiscriminationError(msg)
