"""The criteria of a model on measured data, and the order that they choose (paper, sections II-B and II-C).

All take the loss V = det(1/N Σ ε εᵀ) of the prediction errors (the plain mean square for one output), the
number of estimated parameters and the number of samples; smaller is better. The forms are those that the
paper's own table follows, which for nAIC and MDL differ from the printed ones.

A loss of zero (the model predicts every sample exactly) gives −∞ in the logarithmic criteria and 0 in MDL:
no penalty on parameters outweighs a perfect prediction.

With Δ = AIC − least AIC, exp(−Δ/2) is the likelihood of an order relative to the best, the charge for its
parameters included; divided by their sum these are the Akaike weights. A weight of 0.9 means that the order
is nine times as well supported as all others together. A difference below 2 says next to nothing; one above
10 leaves an order no support. Both outputs count together: AIC = N·(nAIC of y + nAIC of u) up to a
constant.

The coefficients were identified on the twin's response and are scored on the plant's: the differences then
compare that twin with the plant, not only the orders, and the weights are a guide rather than probabilities.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.comparing.code_length import (
    InformationGain,
    information_gain,
    two_part_length,
)
from twinmatch.comparing.models import SimoModel, ahead, deviations, operating_level
from twinmatch.comparing.polynomials import DiscriminationError
from twinmatch.fitting import BoxJenkins
from twinmatch.signals import FloatArray, Window


def naic(loss: float, n_parameters: int, n_samples: int) -> float:
    """Normalised Akaike criterion, ln V + 2 n_p / N.

    Raises:
        DiscriminationError: a loss below zero or not finite, no samples, parameters below zero.
    """
    return _log(loss, n_parameters, n_samples) + 2 * n_parameters / n_samples


def bic(loss: float, n_parameters: int, n_samples: int) -> float:
    """Bayesian criterion, N ln V + N (ln 2π + 1) + n_p ln N; raises as `naic`."""
    likelihood = n_samples * (
        _log(loss, n_parameters, n_samples) + math.log(2 * math.pi) + 1
    )
    return likelihood + n_parameters * math.log(n_samples)


def mdl(loss: float, n_parameters: int, n_samples: int) -> float:
    """Minimum description length, V (1 + d ln N / N); raises as `naic`."""
    _check(loss, n_parameters, n_samples)
    return loss * (1 + n_parameters * math.log(n_samples) / n_samples)


def _log(loss: float, n_parameters: int, n_samples: int) -> float:
    _check(loss, n_parameters, n_samples)
    return math.log(loss) if loss > 0 else -math.inf


def _check(loss: float, n_parameters: int, n_samples: int) -> None:
    if not (math.isfinite(loss) and loss >= 0):
        msg = (
            f"criteria: the loss is {loss}; give a mean square, finite and not negative"
        )
        raise DiscriminationError(msg)
    if n_samples < 1 or n_parameters < 0:
        msg = f"criteria: {n_parameters} parameters and {n_samples} samples; give at least 0 and 1"
        raise DiscriminationError(msg)


@dataclass(frozen=True)
class Criteria:
    """The criteria of one output, or of both together."""

    trivial_length: int
    """l(t), characters: the program that prints the measured table."""
    model_length: int
    """l(p), characters: the model's program and the table of its residuals."""
    gain: int
    """Information gain l(t) − l(p), characters; larger is better."""
    explanation: float
    """gain / l(t), at most 1; negative when the model is worse than the bare table."""
    naic: float
    """Normalised Akaike criterion; smaller is better, as for the two below."""
    bic: float
    mdl: float
    two_part_length: float = math.nan
    """l(p) including the parameters, characters (`two_part_length`); NaN where not computed."""

    @classmethod
    def of(
        cls,
        gain: InformationGain,
        loss: float,
        *,
        parameters: int,
        coefficients: int,
        count: int,
    ) -> Criteria:
        """From gain and loss on `count` samples; the two-part length charges for `coefficients` of the
        model's `parameters`."""
        return cls(
            trivial_length=gain.trivial_length,
            model_length=gain.model_length,
            gain=gain.gain,
            explanation=gain.explanation,
            naic=naic(loss, parameters, count),
            bic=bic(loss, parameters, count),
            mdl=mdl(loss, parameters, count),
            two_part_length=two_part_length(gain.model_length, coefficients, count),
        )

    def __add__(self, other: Criteria) -> Criteria:
        """Combine two outputs: lengths and criteria add, as in the paper's table."""
        trivial = self.trivial_length + other.trivial_length
        gain = self.gain + other.gain
        return Criteria(
            trivial_length=trivial,
            model_length=self.model_length + other.model_length,
            gain=gain,
            explanation=gain / trivial,
            naic=self.naic + other.naic,
            bic=self.bic + other.bic,
            mdl=self.mdl + other.mdl,
            two_part_length=self.two_part_length + other.two_part_length,
        )


@dataclass(frozen=True)
class OrderScore:
    """One Box–Jenkins order of one candidate."""

    order: str
    y: Criteria
    u: Criteria | None
    """None where the loop is not known: then the input is given, not predicted."""
    total: Criteria
    aic_difference: float = math.nan
    """AIC of both outputs together minus that of the best order; NaN where not computed."""
    weight: float = math.nan
    """Akaike weight of this order among those scored beside it, 0 to 1; NaN where not computed."""


def score(
    model: SimoModel, window: Window, decimals: int = 2, *, absolute: float
) -> OrderScore:
    """Judge a model on a measured window, whichever data it was identified on.

    Args:
        model: set-point to output and to input, or input to output.
        window: measured samples.
        decimals: decimal places of the tables of the information gain.
        absolute: added to outputs in these tables (`Output.absolute`): the published lengths show that
            the tables are in kelvin (paper, table IV).
    """
    driven = model.u is None
    level = operating_level(window, driven=driven, lead=model.lead)
    r, y, u = deviations(window, level)
    on_y = _criteria(model.y, u if driven else r, y, level.output + absolute, decimals)
    if model.u is None:
        return OrderScore(model.order, on_y, None, on_y)
    on_u = _criteria(model.u, ahead(r), u, level.input, decimals)
    return OrderScore(model.order, on_y, on_u, on_y + on_u)


def choose_order(scores: Sequence[OrderScore]) -> str:
    """The order preferred by most criteria in total; of equals the lowest, by Occam's razor."""
    best = [
        min(scores, key=lambda s: float(getattr(s.total, name)))
        for name in ("naic", "bic", "mdl")
    ]
    return common_order(
        [s.order for s in (max(scores, key=lambda s: s.total.gain), *best)]
    )


def common_order(chosen: Sequence[str]) -> str:
    """The order chosen by most candidates; of equals the lowest.

    Models of different orders differ by more than their twins do, so the ν-gap compares one order
    throughout, as the paper does.
    """
    votes = Counter(chosen)
    return min(votes, key=lambda order: (-votes[order], order))


def _criteria(
    model: BoxJenkins, r: FloatArray, output: FloatArray, offset: float, decimals: int
) -> Criteria:
    copied = len(model.F)
    simulated = model.simulate(r, outputs=output[:copied])
    gain = information_gain(
        output + offset, simulated + offset, decimals=decimals, copied=copied
    )
    errors = model.prediction_errors(r, output)
    loss = float(np.mean(errors**2))
    order = model.order
    return Criteria.of(
        gain,
        loss,
        parameters=model.n_parameters,
        coefficients=order.nb + order.nf,
        count=len(output),
    )


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
    has_worst = bool(np.isnan(values).any() or np.isposinf(values).any())
    if values.ndim != 1 or not values.size or has_worst:
        msg = f"Akaike weights: the criteria are {np.asarray(criteria).tolist()}; give one number per model"
        raise DiscriminationError(msg)
    least = values.min()
    with np.errstate(invalid="ignore"):  # −∞ less −∞
        differences = np.where(values == least, 0.0, values - least)
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
    akaike = akaike_weights([len(window) * s.total.naic for s in scores])
    return tuple(
        replace(s, aic_difference=float(d), weight=float(w))
        for s, d, w in zip(scores, akaike.differences, akaike.weights, strict=True)
    )
