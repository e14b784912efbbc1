"""Structures of the plant, fitted again and again to the newest samples.

They are fitted for three purposes. All watched structures, every twenty minutes, to choose the one that the
samples support. Those beside the matched one, at every excited window, to compete as candidates: a match of
three parameters needs one step of the set-point, but the heat stored in a sink, or the temperature of the
room, shows only over many. And the richest one, whenever the family is compared, as the plant as it is now.
A structure in which a match was made is watched from then on.

The candidates' fits take the plant file's typical values as one observation of each parameter, so that during
the first minutes they do not drift along the valley in which many parameters fit equally well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Law, Model, Parameters, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Noise, Prior, StructureFit, fit_structure
from twinmatch.signals import Window, point_of
from twinmatch.twin.structures import StructureChoice, choose_structure

CHOICE_S: Final = (900.0, 1200.0, 1200.0)
"""Time before the first choice, between two choices, and length of the newest stretch that is compared, s."""
MAX_SPAN_S: Final = 2400.0
"""Length of the newest stretch to which candidates are fitted, s."""
EVERY_S: Final = 600.0
"""Age after which a candidate's fit is repeated even without excitation, s."""


_GROWTH: Final = 1.5
"""With what earlier sessions have shown, quiet samples teach, too: a structure is fitted again once there are
so many times as many samples."""

_LEAST_LEARNED: Final = 0.2
"""Least share of the prior variance of a direction that the samples have removed, if it is to count."""
_CHANCE: Final = 1e-3
"""Probability with which a plant like the remembered ones is taken for another at a fit.

It is small enough although every fit of a session is tested: these are hardly independent, and leaving a
memory that was right costs only the quick start."""


def watched(plant: type[Plant]) -> tuple[Model, ...]:
    """The plant in the structures that its file marks to be watched on a running plant."""
    return tuple(
        plant.model(name)
        for name, structure in plant.structures.items()
        if structure.watched
    )


class NewestSamples:
    """Joins the windows of a schedule and keeps the newest samples.

    Windows may overlap or follow one another; after a gap, or if one goes back, it starts over.
    """

    def __init__(self, longest: int) -> None:
        """Begin without samples; keep at most `longest`."""
        self._longest = longest
        self.window: Window | None = None

    def push(self, window: Window) -> Window:
        """Take one window; return all samples that are kept now."""
        samples = self.window
        if (
            samples is None
            or window.first > samples.last + 1
            or window.last < samples.last
        ):
            samples = window
        else:
            samples = samples.joined(window)
        self.window = samples.part(
            max(samples.first, samples.last - self._longest + 1), samples.last
        )
        return self.window

    def cut(self, first: int) -> None:
        """Forget the samples before `first`."""
        samples = self.window
        if samples is not None and samples.first < first:
            self.window = (
                samples.part(first, samples.last) if first <= samples.last else None
            )


class _Competitor(NamedTuple):
    """A structure that competes as a candidate."""

    candidate: Candidate
    fit: StructureFit


class StructureFits:
    """Keeps the newest samples of a healthy plant and the structures' fits to them.

    Everything depends on the samples alone, so a replay fits and chooses as the live twin did. Times are
    scaled for slow and fast samples, as in forecasts.
    """

    def __init__(
        self,
        models: Sequence[Model],
        noise: Noise,
        law: Law | None,
        period: float = 1.0,
        *,
        matched: Model | None = None,
        choice: tuple[float, float, float] = CHOICE_S,
        scale: float = 1.0,
        prior: Mapping[str, Prior] = MappingProxyType({}),
    ) -> None:
        """Begin without samples.

        Args:
            models: the plant in each structure that is watched, simple ones first.
            noise: unit of the residuals.
            law: that of the running controller; None if the loop is not known.
            period: sample time, s.
            matched: the structure that matches fit, which does not compete as a structure, too.
            choice: the times of `CHOICE_S`, s.
            scale: factor on these and the other times.
            prior: what earlier sessions have shown of the parameters, by structure and name.
        """
        self._noise = noise
        self._law = law
        self._matched = matched
        self._models: tuple[Model, ...] = ()
        self._prior = prior
        pace = scale / period
        self._least, self._choose_every, longest = (
            round(time * pace) for time in choice
        )
        self._compared = NewestSamples(longest)
        self._fitted = NewestSamples(max(round(MAX_SPAN_S * pace), 1))
        self._fit_every = round(EVERY_S * pace)
        self._chosen_at: int | None = None
        self._competitors: dict[str, _Competitor] = {}
        self._now: StructureFit | None = None
        self.watch(models)
        self.choice: StructureChoice | None = None
        """The newest choice, if there is one yet."""

    def watch(self, models: Sequence[Model]) -> None:
        """Watch further structures; those that were not watched yet compete at once."""
        new = [model for model in models if model not in self._models]
        self._models = tuple(dict.fromkeys((*self._models, *new)))
        # Structures that run elsewhere may fail, so they are the plant now only if there are no others.
        local = [
            model for model in self._models if not model.is_external
        ] or self._models
        self._richest = max(
            reversed(local), key=lambda model: model.structure.n_parameters()
        )
        if new and self._fitted.window is not None:
            self._compete(new, self._fitted.window)

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """The structures that compete and can still be run, best fit first."""
        able = [
            competitor
            for competitor in self._competitors.values()
            if not competitor.fit.model.lost
        ]
        best_first = sorted(able, key=lambda competitor: competitor.fit.charge)
        return tuple(competitor.candidate for competitor in best_first)

    def charge_of(self, candidate: Candidate) -> float:
        """The `StructureFit.charge` of one of the candidates."""
        return self._competitors[candidate.name].fit.charge

    def push(self, window: Window, *, excited: bool) -> None:
        """Take one window of the schedule, of a healthy plant; choose and fit if that is due.

        Choices on samples that do not overlap add their evidence, so that a stretch with little information
        does not change the choice.
        """
        before = self._compared.window
        newest = self._compared.push(window)
        if before is None or newest.first > before.last or newest.last < before.last:
            self._chosen_at = None
        is_choice_due = (
            self._chosen_at is None
            or newest.last - self._chosen_at >= self._choose_every
        )
        if is_choice_due and len(newest) >= self._least:
            self._chosen_at = newest.last
            self.choice = choose_structure(
                newest,
                self._models,
                previous=self.choice,
                noise=self._noise,
                law=self._law,
                thorough=False,
            )
        window = self._fitted.push(window)
        fitted_at = max(
            (each.candidate.samples[1] for each in self._competitors.values()),
            default=None,
        )
        is_aged = (
            fitted_at is not None and not 0 <= window.last - fitted_at < self._fit_every
        )
        if excited or is_aged:
            self._compete(self._models, window)
        elif self._prior:
            self._compete(
                [m for m in self._models if self._grown(m.structure_name, window)],
                window,
            )

    def _grown(self, name: str, window: Window) -> bool:
        """Whether a structure is remembered and a window has enough more samples than its fit had."""
        before = self._competitors.get(name)
        fitted = None if before is None else before.candidate.window
        samples = 0 if fitted is None else len(fitted)
        return name in self._prior and len(window) >= _GROWTH * samples

    @property
    def estranged(self) -> str:
        """How the plant differs from that of earlier sessions, in a sentence; empty while it may be the same.

        They are compared in the structure in which the memory expects the plant.
        """
        name = next(iter(self._prior), "")
        expected = self._competitors.get(name)
        return "" if expected is None else unlike(expected.fit, self._prior[name])

    def forget(self) -> None:
        """Leave what earlier sessions have shown, and the fits that rest on it."""
        rested = [
            model for model in self._models if model.structure_name in self._prior
        ]
        for name in self._prior:
            self._competitors.pop(name, None)
        # matches are made in another structure now
        self._prior = {}
        self._matched = None
        if self._fitted.window is not None:
            self._compete(rested, self._fitted.window)

    def plant_now(self) -> Parameters | None:
        """The plant that candidates are compared with: the richest structure; None with too few samples.

        Each fit starts from the previous one, so that undetermined parameters keep their values.
        """
        newest = self._compared.window
        fit = None if newest is None else self._fit(self._richest, newest, self._now)
        self._now = fit or self._now
        return fit.parameters if fit else None

    def cut(self, first: int) -> None:
        """Fit candidates to no sample before `first`, where the plant changed; fits stay until replaced."""
        self._fitted.cut(first)

    def expel(self, first: int, last: int) -> tuple[str, ...]:
        """Forget fits to samples that overlap `first` to `last`, a fault; return the candidates' names."""
        self._now = None
        fitted = self._fitted.window
        if fitted is not None and fitted.last >= first:
            self._fitted.window = None
        spans = {
            name: competitor.candidate.samples
            for name, competitor in self._competitors.items()
        }
        gone = tuple(
            name for name, span in spans.items() if span[1] >= first and span[0] <= last
        )
        for name in gone:
            del self._competitors[name]
        return gone

    def _compete(self, models: Sequence[Model], window: Window) -> None:
        """Fit structures to a window: not the matched one, unless it is remembered."""
        levels = window.outputs if self._law is None else window.references
        point = point_of(np.median(levels, axis=0))
        for model in models:
            name = model.structure_name
            free = model.structure.free
            if model is self._matched and name not in self._prior:
                continue
            before = self._competitors.get(name)
            start = None if before is None else before.fit
            fit = None if model.lost else self._fit(model, window, start, informed=True)
            if fit is not None:
                states = fit.states[-1]
                candidate = Candidate(
                    name, point, fit.parameters, window, free, fit.covariance, states
                )
                self._competitors[name] = _Competitor(candidate, fit)

    def _fit(
        self,
        model: Model,
        window: Window,
        start: StructureFit | None,
        *,
        informed: bool = False,
    ) -> StructureFit | None:
        """Fit one structure; None if there are too few samples or it does not converge."""
        try:
            return fit_structure(
                [window],
                model,
                start=start,
                noise=self._noise,
                law=self._law,
                thorough=False,
                informed=informed,
                prior=self._prior.get(model.structure_name) if informed else None,
            )
        except TwinmatchError:
            return None


def unlike(fit: StructureFit, prior: Prior) -> str:
    """How the plant differs from the remembered ones, in a sentence; empty while it may be one of them.

    With prior covariance Σ and that of the fit C, the fit of a plant like the remembered ones lies around the
    prior mean with covariance Σ − C. Only directions count in which the samples have narrowed the prior.
    """
    from scipy.special import chdtri  # noqa: PLC0415

    parameters = fit.parameters
    free = fit.model.structure.free
    mean, deviation = np.array([prior[name] for name in free]).T
    distance = (np.array([parameters[name] for name in free]) - mean) / deviation
    open_share = fit.covariance / np.outer(deviation, deviation)
    learned_share, directions = np.linalg.eigh(
        np.eye(len(free)) - (open_share + open_share.T) / 2
    )
    is_learned = learned_share >= _LEAST_LEARNED
    along_directions = np.square(directions.T[is_learned] @ distance)
    surprise = float(np.sum(along_directions / learned_share[is_learned]))
    if not is_learned.any() or surprise <= chdtri(is_learned.sum(), _CHANCE):
        return ""
    farthest = int(np.argmax(np.abs(distance)))
    name = free[farthest]
    unit = fit.model.declared[name].unit
    is_ = f"{name} is {parameters[name]:.3g} {unit}".rstrip()
    was = f"{mean[farthest]:.3g} ± {deviation[farthest]:.1g}"
    return f"this is not the plant that the memory describes: {is_}, remembered {was}; the memory is left"
