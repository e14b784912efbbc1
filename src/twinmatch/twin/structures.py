"""Choice of the plant structure that the data support.

Every structure is fitted to the same windows and judged by the criteria that also choose the order of the
Box–Jenkins models: information gain, nAIC, BIC and MDL, for output and input and in total.

A twin's residuals are far from white: sensor noise circulates in the loop, and a slow error of the twin
persists for minutes. If each sample counted as independent, a thousand samples would justify any structure.
So a noise model of fixed order, the same for all, is added to the twin, as C/D is to B/F in a Box–Jenkins
model, and the loss is that of its one-step prediction errors: only what the past does not predict counts.
Errors beyond three robust standard deviations are clipped, because the pauses of a sensor cause larger errors
than any difference between structures. The information gain is that of the simulation without noise model, as
for the models, less the characters that the parameters cost.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twinmatch.comparing import information_gain
from twinmatch.comparing.criteria import Criteria
from twinmatch.dynamics import FROM_PLANT_FILE, LoopLaw, Model, Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import FittingError, Noise, StructureFit, fit_structure
from twinmatch.signals import MEDIAN_TO_SIGMA, BoolArray, FloatArray, Window

NOISE_ORDER: Final = 12
"""Order of the noise model: longer than the loop's time constants, small compared with a window."""
CUT: Final = 3.0
"""Robust standard deviations at which prediction errors are clipped."""
_ROUNDS: Final = 3
"""How often the noise model is fitted again with new weights."""
_TINY: Final = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class StructureScore:
    """One structure on the windows of a choice."""

    fitted: StructureFit
    signals: tuple[Criteria, ...]
    """Criteria of each output and, in closed loop, of each input."""
    total: Criteria
    evidence: Criteria
    """`total` plus that of all previous choices on earlier samples."""
    loss: tuple[float, ...]
    """Mean square of the prediction errors of these signals, in their units squared."""

    @property
    def name(self) -> str:
        """Name of the structure."""
        return self.fitted.model.structure_name

    @property
    def parameters(self) -> Parameters:
        """Parameters fitted in this structure."""
        return self.fitted.parameters

    @property
    def fit(self) -> tuple[float, float]:
        """NRMSE of output and input in closed loop on the windows of the choice, the worst of several."""
        return self.fitted.fit


@dataclass(frozen=True, eq=False)
class StructureChoice:
    """The scores of all structures, and the one that the criteria prefer."""

    scores: tuple[StructureScore, ...]
    chosen: str
    votes: Mapping[str, str]
    """The structure that each criterion prefers by the evidence."""
    samples: tuple[int, int]
    """Session indices of the first and last sample of the windows."""

    @property
    def score(self) -> StructureScore:
        """Score of the chosen structure."""
        return self.of(self.chosen)

    @property
    def parameters(self) -> Parameters:
        """Parameters fitted in the chosen structure."""
        return self.score.parameters

    def of(self, name: str) -> StructureScore:
        """The score of one structure.

        Raises:
            KeyError: it was not tried.
        """
        found = next((s for s in self.scores if s.name == name), None)
        if found is None:
            raise KeyError(name)
        return found

    @property
    def sentence(self) -> str:
        """A sentence on which structure was chosen and how clearly."""
        count = sum(name == self.chosen for name in self.votes.values())
        best = self.score
        text = f"{count} of {len(self.votes)} criteria choose: {self.chosen}"
        y, u = best.fit
        of_u = "" if math.isnan(u) else f", {100 * u:.1f} % of u"
        text += f" ({best.fitted.n_parameters} parameters, fit {100 * y:.1f} % of y{of_u})"
        others = [s for s in self.scores if s.name != self.chosen]
        if others:
            second = min(others, key=lambda s: s.evidence.bic)
            lead = second.evidence.bic - best.evidence.bic
            word = "below" if lead >= 0 else "above"
            text += f"; its BIC is {abs(lead):.0f} {word} that of: {second.name}"
        return text


def choose_structure(
    windows: Window | Sequence[Window],
    models: Sequence[Model],
    *,
    previous: StructureChoice | None = None,
    noise: Noise | None = None,
    law: LoopLaw = FROM_PLANT_FILE,
    decimals: int = 2,
    thorough: bool = True,
) -> StructureChoice:
    """Fit every structure to the windows and choose the one that most criteria prefer.

    Of equals the one with fewer parameters is chosen, then the one named first. A structure that runs
    elsewhere and cannot be fitted is skipped.

    Args:
        windows: one or several windows recorded on one plant.
        models: the plant in each structure to be tried.
        previous: an earlier choice; the searches start from its parameters. If it was made on samples before
            these, its evidence is added: the plant is assumed to have kept its structure, though not its
            parameters.
        noise: unit of the residuals of the fits; default: the plant's.
        law: that of the running controller, None if the loop is not known; default: the plant file's.
        decimals: decimal places of the tables of the information gain.
        thorough: as in `fit_structure`.

    Raises:
        FittingError: no window, one too short, or no structure.
    """
    several = [windows] if isinstance(windows, Window) else list(windows)
    before = {s.name: s.fitted for s in previous.scores} if previous else {}
    scores = []
    for model in models:
        try:
            fitted = fit_structure(
                several,
                model,
                start=before.get(model.structure_name),
                noise=noise,
                law=law,
                thorough=thorough,
            )
            scores.append(score_structure(fitted, decimals))
        except TwinmatchError:
            if not model.is_external:
                raise
    samples = (min(w.first for w in several), max(w.last for w in several))
    if (
        previous is not None
        and previous.samples[1] < samples[0]
        and before.keys() >= {s.name for s in scores}
    ):
        scores = [replace(s, evidence=previous.of(s.name).evidence + s.total) for s in scores]
    if not scores:
        raise FittingError("structures: there is none to choose from; give at least one")
    votes = _votes(scores)
    count = Counter(votes.values())
    chosen = min(scores, key=lambda s: (-count[s.name], s.fitted.n_parameters))
    return StructureChoice(tuple(scores), chosen.name, votes, samples)


def score_structure(fitted: StructureFit, decimals: int = 2) -> StructureScore:
    """Score a fit on the windows on which it was made; samples that were not measured are not counted."""
    seen = np.concatenate(fitted.seen)
    scores, losses = [], []
    offsets = [output.absolute for output in fitted.model.plant.outputs.values()]
    for row in range(len(fitted.measured[0])):
        offset = offsets[row] if row < len(offsets) else 0.0
        measured = [window[row] for window in fitted.measured]
        simulated = [window[row] for window in fitted.simulated]
        # Where nothing was measured, the twin itself stands in for what comes before an error.
        pairs = zip(measured, simulated, fitted.seen, strict=True)
        residuals = [np.where(marks, m - s, 0.0) for m, s, marks in pairs]
        errors = prediction_errors(residuals, seen=fitted.seen)
        # An exact twin leaves no errors; the smallest number keeps the logarithm finite.
        loss = max(float(np.mean(np.square(errors))), _TINY)
        gain = information_gain(
            np.concatenate(measured)[seen] + offset,
            np.concatenate(simulated)[seen] + offset,
            decimals=decimals,
        )
        losses.append(loss)
        n = fitted.n_parameters
        scores.append(Criteria.of(gain, loss, parameters=n, coefficients=n, count=errors.size))
    total = sum(scores[1:], scores[0])
    return StructureScore(fitted, tuple(scores), total, total, tuple(losses))


def prediction_errors(
    residuals: Sequence[FloatArray], order: int = NOISE_ORDER, *, seen: Sequence[BoolArray] = ()
) -> FloatArray:
    """One-step prediction errors of an autoregression of the residuals, clipped; one common model.

    The autoregression is fitted by iteratively reweighted least squares: samples with large errors or large
    regressors get smaller weights, so that a few outliers do not determine it.

    Args:
        residuals: one array per window.
        order: order of the autoregression; windows of no more samples than this are ignored.
        seen: which samples of each window were measured; by default all. Only their errors are returned.
    """
    past, now = [], []
    seen = seen or [np.ones(window.size, dtype=np.bool_) for window in residuals]
    for window, marks in zip(residuals, seen, strict=True):
        if window.size > order:
            counted = marks[order:]
            past.append(np.lib.stride_tricks.sliding_window_view(window[:-1], order)[counted])
            now.append(window[order:][counted])
    rows, target = np.concatenate(past), np.concatenate(now)
    reach = 2.0 * CUT * MEDIAN_TO_SIGMA * float(np.median(np.abs(target)))
    downweighted = _downweighted(reach, np.max(np.abs(rows), axis=1))
    weights = np.ones(target.size)
    for _ in range(_ROUNDS + 1):
        weighed = rows * weights[:, None]
        errors = target - rows @ np.linalg.lstsq(weighed.T @ rows, weighed.T @ target, rcond=None)[0]
        limit = CUT * MEDIAN_TO_SIGMA * float(np.median(np.abs(errors)))
        weights = downweighted * _downweighted(limit, np.abs(errors))
    return np.clip(errors, -limit, limit)


def _downweighted(reach: float, sizes: FloatArray) -> FloatArray:
    """Weights that scale sizes above the reach down to it."""
    return np.asarray(reach / np.maximum(sizes, max(reach, _TINY)))


def _votes(scores: Sequence[StructureScore]) -> dict[str, str]:
    def best(name: str) -> str:
        return min(scores, key=lambda s: (getattr(s.evidence, name), s.fitted.n_parameters)).name

    return {
        "information gain": best("two_part_length"),
        "nAIC": best("naic"),
        "BIC": best("bic"),
        "MDL": best("mdl"),
    }
