"""Choice of the plant structure that the data support: by free runs on samples that its fit has not seen.

Every structure is fitted to the first two thirds of each window and then runs freely over the last third, in
the loop or driven by the recorded input. What counts is its error there, in units of the noise, large ones
linearly. One step ahead, a noise model would carry even the poorest structure; and what a richer one gains on
the samples that it was fitted to says little of the next ones.

The errors are compared in blocks as long as residuals are correlated. A structure is worse than the best if
its mean cost is higher by more than a hundredth, and by more than two standard errors of the difference or, where
few blocks hold most of it, so far that their likelihoods differ by two nats. Of those that are not worse, the
one with the fewest parameters is chosen; of as many, the one that errs less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from twinmatch.dynamics import FROM_PLANT_FILE, LoopLaw, Model, Parameters
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import (
    FittingError,
    Noise,
    StructureFit,
    fit_structure,
    held_back_costs,
)
from twinmatch.signals import FloatArray, Window

_TINY: Final = float(np.finfo(np.float64).tiny)
_EQUAL: Final = 2.0
"""Standard errors of a difference, and nats, up to which structures are equal. At one, two of twelve plain
simulated rigs are called richer; at two none, and every rich one is."""
_ALIKE: Final = 0.01
"""Share of the least cost up to which structures are equal, however sure the difference is. One whose additional
effect was fitted as none is never exactly the one without it: searches end a little beside each other."""


@dataclass(frozen=True, eq=False)
class StructureScore:
    """One structure on the windows of a choice."""

    fitted: StructureFit
    """The fit to all of the windows."""
    held_back: FloatArray
    """Mean cost of the free run in each block of the parts held back."""
    evidence: FloatArray
    """`held_back` after that of all previous choices on earlier samples."""

    @property
    def off(self) -> float:
        """The error of the free run over all evidence, in units of the noise: that of a constant error of the
        same cost."""
        return math.sqrt((1.0 + float(np.mean(self.evidence)) / 2.0) ** 2 - 1.0)

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
    """The scores of all structures, and the one that was chosen."""

    scores: tuple[StructureScore, ...]
    chosen: str
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
        score = next((s for s in self.scores if s.name == name), None)
        if score is None:
            raise KeyError(name)
        return score

    @property
    def sentence(self) -> str:
        """A sentence on which structure was chosen and how clearly."""
        best = self.score
        y, u = self.score.fit
        of_u = "" if math.isnan(u) else f", {100 * u:.1f} % of u"
        text = f"free runs on samples held back choose: {self.chosen} (off by {best.off:.3g} × noise, "
        text += (
            f"{best.fitted.n_parameters} parameters, fit {100 * y:.1f} % of y{of_u})"
        )
        rivals = [s for s in self.scores if s.name != self.chosen]
        if rivals:
            second = min(rivals, key=lambda s: s.off)
            text += f"; {second.name} is off by {second.off:.3g} × noise"
        return text


def choose_structure(
    windows: Window | Sequence[Window],
    models: Sequence[Model],
    *,
    previous: StructureChoice | None = None,
    noise: Noise | None = None,
    law: LoopLaw = FROM_PLANT_FILE,
    thorough: bool = True,
) -> StructureChoice:
    """Fit every structure to the windows and choose the one that errs least on samples held back.

    Of equals the one with fewer parameters is chosen. A structure that runs elsewhere and cannot be fitted is
    skipped.

    Args:
        windows: one or several windows recorded on one plant.
        models: the plant in each structure to be tried.
        previous: an earlier choice; the searches start from its parameters. If it was made on samples before
            these, its evidence is added: the plant is assumed to have kept its structure, though not its
            parameters.
        noise: unit of the residuals of the fits; default: the plant's.
        law: that of the running controller, None if the loop is not known; default: the plant file's.
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
            costs = held_back_costs(fitted, several, noise, law, thorough=thorough)
            scores.append(StructureScore(fitted, costs, costs))
        except TwinmatchError:
            if not model.is_external:
                raise
    samples = (min(w.first for w in several), max(w.last for w in several))
    if previous is not None and _adds_to(previous, scores, samples[0]):
        earlier = {s.name: s.evidence for s in previous.scores}
        scores = [
            replace(s, evidence=np.append(earlier[s.name], s.held_back)) for s in scores
        ]
    if not scores:
        raise FittingError(
            "structures: there is none to choose from; give at least one"
        )
    best = min(scores, key=lambda s: s.off)
    equal = [s for s in scores if s is best or not _worse(s.evidence, best.evidence)]
    chosen = min(equal, key=lambda s: (s.fitted.n_parameters, s.off))
    return StructureChoice(tuple(scores), chosen.name, samples)


def _adds_to(
    previous: StructureChoice, scores: Sequence[StructureScore], first: int
) -> bool:
    """Whether these scores, on samples from the `first` on, can be added to the evidence of a choice."""
    if previous.samples[1] >= first:
        # they share samples, whose evidence would count twice
        return False
    return {s.name for s in previous.scores} >= {s.name for s in scores}


def _worse(costs: FloatArray, least: FloatArray) -> bool:
    """Whether costs, block by block, are higher than the least ones by more than chance."""
    mean = max(float(np.mean(costs)), _TINY)
    best = max(float(np.mean(least)), _TINY)
    blocks = costs.size
    if not math.isfinite(mean):
        return True
    if mean <= (1.0 + _ALIKE) * best:
        return False
    nats = blocks / 2 * math.log(mean / best)
    if nats > _EQUAL:
        return True
    standard_error = (
        float(np.std(costs - least, ddof=1)) / math.sqrt(blocks)
        if blocks > 1
        else math.inf
    )
    return float(np.mean(costs - least)) > _EQUAL * standard_error
