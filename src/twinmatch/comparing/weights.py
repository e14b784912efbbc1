"""How strongly the Akaike criterion prefers one order over the others (Burnham and Anderson 2002).

With Δ = AIC − least AIC, exp(−Δ/2) is the likelihood of an order relative to the best, the charge for its
parameters included; divided by their sum these are the Akaike weights. A weight of 0.9 means that the order
is nine times as well supported as all others together. A difference below 2 says next to nothing; one above
10 leaves an order no support. Both outputs count together: AIC = N·(nAIC of y + nAIC of u) up to a
constant.

The coefficients were identified on the twin's response and are scored on the plant's: the differences then
compare that twin with the plant, not only the orders, and the weights are a guide rather than probabilities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.comparing.errors import DiscriminationError
from twinmatch.comparing.models import SimoModel
from twinmatch.comparing.score import OrderScore, score
from twinmatch.signals import FloatArray, Window

__all__ = ["AkaikeWeights", "akaike_weights", "score_orders"]


class AkaikeWeights(NamedTuple):
    """Akaike differences and weights of models scored on the same data."""

    differences: FloatArray
    """AIC above the least, shape (n,); 0 for the best."""
    weights: FloatArray
    """Akaike weights, sum 1, shape (n,)."""


def akaike_weights(criteria: ArrayLike) -> AkaikeWeights:
    """Differences and weights from values of AIC, shape (n,).

    −∞ (a perfect prediction) takes all the weight, shared if there are several.

    Raises:
        DiscriminationError: no value, or one that is not a number or +∞.
    """
    values = np.asarray(criteria, dtype=np.float64)
    if values.ndim != 1 or not values.size or np.isnan(values).any() or np.isposinf(values).any():
        msg = f"Akaike weights: the criteria are {np.asarray(criteria).tolist()}; give one number per model"
        raise DiscriminationError(msg)
    least = values.min()
    differences = np.where(values == least, 0.0, values - least) if np.isfinite(least) else _perfect(values)
    likelihoods = np.exp(-differences / 2)
    return AkaikeWeights(differences, likelihoods / likelihoods.sum())


def score_orders(
    models: Sequence[SimoModel], window: Window, decimals: int = 2, *, absolute: float
) -> tuple[OrderScore, ...]:
    """Score every order of one candidate, with the Akaike differences and weights among them.

    Raises:
        DiscriminationError: no model, or as `score`.
    """
    scores = [score(model, window, decimals, absolute=absolute) for model in models]
    found = akaike_weights([len(window) * s.total.naic for s in scores])
    return tuple(
        replace(s, aic_difference=float(d), weight=float(w))
        for s, d, w in zip(scores, found.differences, found.weights, strict=True)
    )


def _perfect(values: FloatArray) -> FloatArray:
    return np.where(np.isneginf(values), 0.0, np.inf)
