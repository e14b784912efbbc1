"""The four criteria of a model on measured data, per output and in total, and the order that they choose."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinmatch.comparing.code_length import information_gain, two_part_length
from twinmatch.comparing.criteria import bic, mdl, naic
from twinmatch.comparing.models import SimoModel, ahead, deviations, operating_level
from twinmatch.fitting import BoxJenkins
from twinmatch.signals import FloatArray, Window

__all__ = ["Criteria", "OrderScore", "choose_order", "common_order", "score"]


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


def score(model: SimoModel, window: Window, decimals: int = 2, *, absolute: float) -> OrderScore:
    """Judge a model on a measured window, whichever data it was identified on.

    Args:
        model: set-point to output and to input, or input to output.
        window: measured samples.
        decimals: decimal places of the tables of the information gain.
        absolute: added to outputs in these tables (`Output.absolute`): the published lengths show that
            the tables are in kelvin (paper, table IV).
    """
    if model.u is None:
        level = operating_level(window, driven=True)
        _, y, u = deviations(window, level)
        on_y = _criteria(model.y, u, y, level.output + absolute, decimals)
        return OrderScore(model.order, on_y, None, on_y)
    level = operating_level(window)
    r, y, u = deviations(window, level)
    on_y = _criteria(model.y, r, y, level.output + absolute, decimals)
    on_u = _criteria(model.u, ahead(r), u, level.input, decimals)
    return OrderScore(model.order, on_y, on_u, on_y + on_u)


def choose_order(scores: Sequence[OrderScore]) -> str:
    """The order preferred by most criteria in total; of equals the lowest, by Occam's razor."""
    best = [max(scores, key=lambda s: s.total.gain).order]
    for name in ("naic", "bic", "mdl"):
        best.append(min(scores, key=lambda s: float(getattr(s.total, name))).order)
    return common_order(best)


def common_order(chosen: Sequence[str]) -> str:
    """The order chosen by most candidates; of equals the lowest.

    Models of different orders differ by more than their twins do, so the ν-gap compares one order
    throughout, as the paper does.
    """
    votes = Counter(chosen)
    return min(votes, key=lambda order: (-votes[order], order))


def _criteria(model: BoxJenkins, r: FloatArray, output: FloatArray, offset: float, decimals: int) -> Criteria:
    copied = len(model.F)
    simulated = model.simulate(r, outputs=output[:copied])
    gain = information_gain(output + offset, simulated + offset, decimals=decimals, copied=copied)
    errors = model.prediction_errors(r, output)
    loss = float(np.mean(errors**2))
    n, count = model.n_parameters, len(output)
    return Criteria(
        trivial_length=gain.trivial_length,
        model_length=gain.model_length,
        gain=gain.gain,
        explanation=gain.explanation,
        naic=naic(loss, n, count),
        bic=bic(loss, n, count),
        mdl=mdl(loss, n, count),
        two_part_length=two_part_length(gain.model_length, model.order.nb + model.order.nf, count),
    )
