"""The published verdict: the family's scores, leader and nominal candidate, and how far to trust them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from typing import Annotated, Final, NamedTuple

import numpy as np

from twinmatch.comparing.criteria import Criteria, OrderScore
from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.margin import loop_controller, loop_plant, stability_margin
from twinmatch.comparing.matrix_gap import matrix_margin, matrix_nu_gap
from twinmatch.comparing.models import Candidate
from twinmatch.comparing.nu_gap import nu_gap
from twinmatch.comparing.plant_gap import LoopConditions, PlantGaps, spans_of
from twinmatch.comparing.scaling import best_scaling
from twinmatch.comparing.state_space import StateSpace
from twinmatch.comparing.uncertainty import (
    CONFIDENCE,
    SEED,
    FamilyUncertainty,
    family_uncertainty,
)
from twinmatch.comparing.undefined import UndefinedError
from twinmatch.dynamics import Law, LinearLaw, Parameters, PidGains, Plant, linearised
from twinmatch.errors import TwinmatchError
from twinmatch.requirements import FINITE, RISING, SHARE, Among, Sized, Within
from twinmatch.signals import OperatingPoint, one_of_each, point_values

ADMITTED: Final = "admitted"
"""The match is now a candidate of the family."""
REFUSED: Final = "refused"
"""The gate, a fault of the plant or missing models kept it out; the verdict's reason says which."""


_SHOWN: Final = 2.5
"""Standard errors from which something is more than chance: 0.6 % in one look, less than 5 % in an hour of
them (`python -m benchmarks.trust`)."""
ONE_SIDED: Final = 1.6448536269514722
"""Quantile of the normal distribution at 95 %: that of `persistence_skill_high` and `arx_skill_high`."""
_TINY: Final = 1e-12
_TENTH: Final = 1.1
"""Up to so many times the errors of ARX, a twin is hardly worse: it alone can answer what-if."""
BASELINES: Final = {
    "persistence": "saying that nothing changes",
    "arx": "a linear model without physics (ARX)",
}
"""The baselines, and what each is called in a sentence."""


class Shortfall(NamedTuple):
    """Why forecasts at a horizon are not trusted."""

    words: str
    """With a place for the figure."""
    figure: str
    certain: bool
    """Whether it is known that they are not to be trusted; otherwise it is not known that they are."""

    def of(self, signal: str) -> Shortfall:
        """The same, said of one signal."""
        return self._replace(words=_OWN.sub(rf"\g<0> of {signal}", self.words, count=1))


FEW: Final = Shortfall("too few of its forecasts have been compared", "", certain=False)
"""Nothing is known yet."""
_OWN: Final = re.compile("its (forecasts|bands)")
_PERSISTENCE: Final = (
    "its forecasts are not surely better than {persistence}, with {{}} times the error"
)
_ARX: Final = "its forecasts are worse than {arx}, with {{}} times the error"
_BANDS: Final = "its bands hold {} % of the readings"
_BEATEN_SOONER: Final = Shortfall(
    "its forecasts are not surely better than {arx}, which is better sooner".format(
        **BASELINES
    ),
    "",
    certain=False,
)
"""What a shorter horizon says of a longer one."""


def doubt_words(doubts: Mapping[float, Shortfall]) -> str:
    """Where the one test fails, by `ForecastScore.doubts`, in words; empty if nowhere."""
    proven = {horizon: doubt for horizon, doubt in doubts.items() if doubt != FEW}
    clauses = []
    for words in dict.fromkeys(doubt.words for doubt in proven.values()):
        figures = {
            horizon: doubt.figure
            for horizon, doubt in proven.items()
            if doubt.words == words
        }
        clauses.append(
            f"{horizon_list(figures)} s ahead {words.format(number_list(figures.values()))}"
        )
    return ", and ".join(clauses)


def number_list(listed: Iterable[float | str], digits: str = "g") -> str:
    """Numbers or texts in a sentence, at least one: 10, 60 and 300."""
    *first, last = (
        entry if isinstance(entry, str) else format(entry, digits) for entry in listed
    )
    return f"{', '.join(first)} and {last}" if first else last


def horizon_list(horizons: Iterable[float]) -> str:
    """Horizons in a sentence, s, to three digits: those of fast plants are odd multiples of their period."""
    return number_list(float(f"{horizon:.3g}") for horizon in horizons)


class TrustLevel(Enum):
    """How far to trust the leader, from the newest window."""

    UNKNOWN = "unknown"
    """There is no candidate yet, or its forecasts have not passed the test of `ForecastScore.doubts` yet."""
    TRUSTED = "trusted"
    """The samples lie in the bands forecast for them, and the leader passes that test at some horizon."""
    DOUBTFUL = "doubtful"
    """The samples lie outside (`miss_since` says since when), or the leader surely fails at every horizon."""
    FAULT = "fault"
    """The plant has a fault, so that no twin holds; check the plant."""


LEVEL_WORDS: Final = {
    TrustLevel.UNKNOWN: "no forecast has been compared with measurements yet",
    TrustLevel.TRUSTED: "measurements lie within the forecast bands",
    TrustLevel.DOUBTFUL: "measurements lie outside the forecast bands",
}
"""What the readings alone say of the leader."""


_BY_HORIZON: Final = Sized("horizons", "its horizons", may_be_empty=True, by_owner=True)
_BY_HORIZON_OF_SIGNAL: Final = Sized(
    "horizons", "the horizons", may_be_empty=True, by_owner=True
)


@dataclass(frozen=True)
class CandidateScore:
    """One candidate of the family at the moment of a verdict."""

    name: str
    operating_point: OperatingPoint
    """In the output's unit."""
    parameters: Parameters
    first: int
    """First sample of the window it was matched on; `last` + 1 if it was given."""
    last: int
    orders: tuple[OrderScore, ...]
    """Scores of every order on the measured window on which the candidate was matched."""
    chosen_order: Annotated[str, Among("orders", "chosen_order", "order")]
    nu_gap_sum: float
    """Column sum of `Verdict.nu_gap`."""
    newest: Criteria | None
    """Score of the family's order on the newest window with excitation, both outputs together."""
    nu_gap_to_plant: float | None
    """Largest ν-gap, over the family's operating points, between this plant and the plant matched to the
    newest samples."""
    margin: Annotated[float | None, SHARE] = None
    """Stability margin b(P, C) of the running controller with this candidate's plant, 0 to 1."""
    plant_gap_to_nominal: Annotated[float | None, SHARE] = None
    """ν-gap from the nominal candidate's plant to this one's, input to output, scaled as `margin`."""
    nu_gap_low: tuple[float, ...] = ()
    """Lower ends of the 90 % intervals of the ν-gaps to the candidates, in their order."""
    nu_gap_high: Annotated[
        tuple[float, ...], Sized("nu_gap_low", "the lower ends")
    ] = ()
    """Upper ends of the same intervals."""
    nu_gap_sum_low: float = math.nan
    """Lower end of the 90 % interval of `nu_gap_sum`; NaN where not computed, as for the two below."""
    nu_gap_sum_high: float = math.nan
    nominal_probability: Annotated[float, SHARE] = math.nan
    """Probability, given the uncertainty of the matches, of having the smallest ν-gap sum."""
    identified_gap_sum: float = math.nan
    """Column sum of `Verdict.identified_gap`; NaN where not computed."""
    identified_gap_to_plant: float | None = None
    """ν-gap from its model of the family's order to the one identified on the newest measured window."""


@dataclass(frozen=True)
class ForecastScore:
    """How well one candidate has forecast."""

    name: str
    parameters: Parameters
    first: int
    """First sample of the data it was fitted to; `last` + 1 if it was given."""
    last: int
    gain: float
    """Characters that its forecasts of output and input have saved compared with a forecast of no change: the
    mean over forecasts, older ones weighted less, summed over the horizons. NaN before one could be compared
    with the samples."""
    gains: Annotated[tuple[float, ...], _BY_HORIZON]
    """The gain at each horizon."""
    forecasts: Annotated[float, Within(0.0, math.inf)]
    """Effective number of forecasts in that mean."""
    persistence_skill: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """At each horizon, 1 − (mean |error|) / (that of a forecast of no change); NaN if too few were compared,
    empty in recordings from before it was computed."""
    arx_skill: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """The same beside an ARX model, which is fitted to the samples so far."""
    persistence_skill_high: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """Upper end of the one-sided 95 % interval of `persistence_skill`: below 0, the forecast of no change is
    better, and not by chance. NaN and empty as above."""
    arx_skill_high: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """The same of `arx_skill`."""

    coverage: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """At each horizon, the share of the readings since the horizon before that its bands have held, of
    several signals the least; 0.9 is expected. NaN and empty as above."""
    independent: Annotated[tuple[float, ...], _BY_HORIZON] = ()
    """Effective number of forecasts in that share which do not overlap."""

    def doubts(
        self, horizons: Sequence[float], trusted: Sequence[float] = ()
    ) -> dict[float, Shortfall]:
        """Where its forecasts do not pass the test, and why, by horizon, s; at the others they are trusted.

        They pass if they are better than saying that nothing changes, if ARX is not better, and if their bands
        do not hold less than they promise, each by more than chance. At horizons that were `trusted` before,
        the contrary has to be shown. Where both baselines are better, the better one is named. Nor do they
        pass where ARX is surely much better at a shorter horizon: of long forecasts only few do not overlap.
        """
        doubts = {}
        beaten_sooner = None
        for k, horizon in enumerate(horizons):
            doubt = self._doubt(k, held=horizon in trusted) or beaten_sooner
            if doubt is not None:
                doubts[horizon] = doubt
            if self._is_far_behind_arx(k):
                beaten_sooner = _BEATEN_SOONER
        return doubts

    def _doubt(self, k: int, *, held: bool) -> Shortfall | None:
        if not self.persistence_skill or math.isnan(self.persistence_skill[k]):
            return FEW
        behind = [
            self._behind_persistence(k, held=held),
            self._behind_arx(k, held=held),
        ]
        shortfalls = [shortfall for shortfall in behind if shortfall is not None]
        if shortfalls:
            return max(shortfalls, key=lambda shortfall: float(shortfall.figure))
        allowed = _SHOWN if held else _SHOWN / 2.0
        share, number = (
            figures[k] if figures else math.nan
            for figures in (self.coverage, self.independent)
        )
        short = (CONFIDENCE - share) / math.sqrt(
            CONFIDENCE * (1.0 - CONFIDENCE) / number
        )
        if short > allowed:
            return Shortfall(_BANDS, f"{100 * share:.0f}", short > _SHOWN)
        return None

    def _behind_persistence(self, k: int, *, held: bool) -> Shortfall | None:
        error, sure = self._behind("persistence", k)
        if sure < -(0.0 if held else _SHOWN):
            return None
        return Shortfall(
            _PERSISTENCE.format(**BASELINES), f"{error:.2f}", sure > _SHOWN
        )

    def _behind_arx(self, k: int, *, held: bool) -> Shortfall | None:
        error, sure = self._behind("arx", k)
        if sure > (ONE_SIDED if held else _SHOWN / 2.0):
            certain = error > _TENTH and sure > _SHOWN
            return Shortfall(_ARX.format(**BASELINES), f"{error:.2f}", certain)
        return None

    def _is_far_behind_arx(self, k: int) -> bool:
        """Whether ARX is better by more than a tenth, by the end of the one-sided 95 % interval."""
        _, sure = self._behind("arx", k, _TENTH)
        return sure > ONE_SIDED

    def _behind(self, baseline: str, k: int, times: float = 1.0) -> tuple[float, float]:
        """How many times a baseline's error its own is at the k-th horizon, and by how many standard errors
        it is worse than so many `times` that error; NaN where that is not known."""
        skill, high = (getattr(self, f"{baseline}_skill{end}") for end in ("", "_high"))
        if not skill or not high:
            return math.nan, math.nan
        worse = math.log(1.0 - skill[k])
        least = math.log(1.0 - high[k])
        return 1.0 - skill[k], ONE_SIDED * (worse - math.log(times)) / max(
            worse - least, _TINY
        )


@dataclass(frozen=True)
class SignalScore:
    """How well the leader has forecast one signal; figures at horizons as in `ForecastScore`."""

    signal: str
    """Name in the plant file."""
    miss: float
    """RMS over the newest samples of reading minus forecast, in half widths of the band."""
    inside: Annotated[float, SHARE]
    """Share of these samples in the band; 0.9 is expected."""
    coverage: Annotated[tuple[float, ...], _BY_HORIZON_OF_SIGNAL, SHARE]
    """At each horizon, the share of the readings that the bands have held."""
    persistence_skill: Annotated[tuple[float, ...], _BY_HORIZON_OF_SIGNAL]
    arx_skill: Annotated[tuple[float, ...], _BY_HORIZON_OF_SIGNAL]
    trusted: tuple[float, ...]
    """The horizons, s, at which the forecasts of this signal pass the test."""


@dataclass(frozen=True)
class Verdict:
    """One judgement of the family."""

    sample: int
    """Index of the sample that triggered it."""
    first: int
    last: int
    """Last sample of the window that was judged; `first` is its first."""
    level: TrustLevel
    level_reason: str
    """Why the leader is trusted so far and no further: a part of a sentence."""
    stands: bool
    """Whether nothing could be identified from the window and the scores are those of the verdict before."""
    nominal: Annotated[str | None, Among("candidates", "nominal", "name")]
    """Name of the candidate with the smallest ν-gap sum."""
    reason: str
    """One plain sentence."""
    decimals: Annotated[int, Within(0, 15)]
    """Decimal places of the tables in the information gain."""
    candidates: tuple[CandidateScore, ...]
    order: str | None
    """The order chosen by most candidates; `identified_gap` compares their models of this order."""
    nu_gap: Annotated[
        tuple[tuple[float, ...], ...],
        Sized("candidates", "its candidates", square=True, may_be_empty=True),
        SHARE,
    ]
    """Largest ν-gap between the candidates' plants over `nu_gap_points`, in the order of `candidates`."""
    driven_rms_y: float
    """RMS over the newest samples of measured minus driven twin's output; NaN without a nominal. Of several
    outputs, or inputs, that of the worst in units of its noise."""
    closed_rms_u: float
    """RMS over the same samples of measured minus closed-loop twin's input; NaN without a nominal."""
    nu_gap_points: Annotated[tuple[float, ...], FINITE] = ()
    """Operating points at which the candidates' plants are compared, in the output's unit; of several outputs
    one after the other."""
    identified_gap: Annotated[tuple[tuple[float, ...], ...], SHARE] = ()
    """ν-gaps between the models identified on the candidates' twins, as in the paper; in the same order."""
    match: str = ""
    """Result of the window's match: `ADMITTED`, `REFUSED`, or empty if none was requested."""
    dismissed: tuple[str, ...] = ()
    """Names of the candidates removed with this verdict: matched while the fault already showed."""
    decided: bool = False
    """Whether the data decide who leads: `leader_confidence` is 0.9 or more."""
    certainty: str = ""
    """A sentence on how certain leader and nominal are, and which candidates the running controller is
    guaranteed to hold."""
    fault: str = ""
    """Name of the fault a health monitor found in the plant; empty for none."""
    fault_signal: str = ""
    """Name in the plant file of the drive, output or parameter that it concerns; empty if it names none."""
    fault_since: int | None = None
    """Index of the sample since which that fault shows; None without a fault."""
    structure: str = ""
    """Name of the plant structure that the samples support; empty before the first comparison."""
    structure_parameters: Parameters | None = None
    """Parameters fitted in that structure."""
    leader: Annotated[str | None, Among("forecasts", "leader", "name")] = None
    """Name of the candidate whose forecasts have saved the most characters: the one to use for forecasts."""
    leader_confidence: Annotated[float, SHARE] = math.nan
    """Share of the forecasts so far in which the leader's error at the longest horizon was within 3 % of the
    best candidate's in hindsight; NaN without a leader."""
    miss_y: float = math.nan
    """RMS over the newest samples of output minus forecast, in half widths of the leader's band, of several
    outputs the largest; NaN if there was no forecast."""
    miss_u: float = math.nan
    """The same for the input."""
    inside_y: Annotated[float, SHARE] = math.nan
    """Share of those samples with the output inside the band; 0.9 is expected."""
    inside_u: Annotated[float, SHARE] = math.nan
    miss_since: int | None = None
    """Index of the first sample of the current stretch outside the bands; None while inside."""
    held_low: float = math.nan
    """Lowest output of the contiguous range of levels at which forecasts held; NaN if there is none."""
    held_high: float = math.nan
    """Highest output of that range."""
    horizons: Annotated[tuple[float, ...], RISING] = ()
    """Horizons of the forecasts, s."""
    forecasts: tuple[ForecastScore, ...] = ()
    """Scores of every candidate that forecasts, including the leader."""
    trusted: tuple[float, ...] = ()
    """The horizons, s, at which the leader's forecasts pass the test of `ForecastScore.doubts`, also of each
    of several outputs."""
    signals: tuple[SignalScore, ...] = ()
    """How far to trust the forecasts of each output and, where the loop is known, of each input."""

    @property
    def chosen(self) -> CandidateScore | None:
        """The nominal candidate."""
        return next((c for c in self.candidates if c.name == self.nominal), None)

    @property
    def leading(self) -> ForecastScore | None:
        """The leader's score; None without a leader."""
        return next(
            (score for score in self.forecasts if score.name == self.leader), None
        )

    @property
    def doubts(self) -> str:
        """Where the leader's forecasts do not pass the test, in words; empty if nowhere."""
        return (
            doubt_words(self.leading.doubts(self.horizons, self.trusted))
            if self.leading
            else ""
        )

    @property
    def misses(self) -> tuple[float, ...]:
        """The miss of each output, then of each input that was forecast, in the order of the plant file, as
        `SignalScore.miss`; recorded verdicts of a single loop may have no scores of signals."""
        plant = self.plant
        if self.signals or (plant is not None and not plant.single):
            return tuple(score.miss for score in self.signals)
        return self.miss_y, self.miss_u

    @property
    def modelled(self) -> tuple[CandidateScore, ...]:
        """The paper's family: the candidates with Box–Jenkins models, which come first, in the order of
        `identified_gap`. The ones after them are other structures of the plant."""
        return tuple(candidate for candidate in self.candidates if candidate.orders)

    @property
    def family(self) -> tuple[CandidateScore, ...]:
        """The candidates that displays list: the paper's family; of a plant with several loops, which has no
        such models, all."""
        several = any(
            not candidate.parameters.model.plant.single for candidate in self.candidates
        )
        return self.candidates if several else self.modelled

    @property
    def named_fault(self) -> str:
        """The name of the fault; on a plant with several loops with what it concerns."""
        plant = self.plant
        signal = self.fault_signal
        return (
            f"{self.fault} of {plant.called(signal)}"
            if signal and plant and not plant.single
            else self.fault
        )

    @property
    def plant(self) -> type[Plant] | None:
        """The plant that was judged; None while nothing was fitted."""
        parameters = [
            *(f.parameters for f in self.forecasts),
            *(c.parameters for c in self.candidates),
        ]
        return parameters[0].model.plant if parameters else None


def nominal_of(candidates: tuple[CandidateScore, ...]) -> str | None:
    """The candidate nearest to the whole family.

    It has the smallest ν-gap sum (paper, section IV-C); of equal sums (two candidates always have
    equal ones), it is the one nearest to the plant as it is now.
    """
    if not candidates:
        return None

    def rank(candidate: CandidateScore) -> tuple[float, float, str]:
        to_plant = (
            1.0 if candidate.nu_gap_to_plant is None else candidate.nu_gap_to_plant
        )
        return candidate.nu_gap_sum, to_plant, candidate.name

    return min(candidates, key=rank).name


DECIDED_FROM = CONFIDENCE
"""Probability of being nominal from which the choice counts as decided; that of the intervals, too.

Of 200 simulated families whose plants have ν-gaps of 0.13 to 0.26, 199 reached this probability, and every
choice was right. With ν-gaps of 0.01 to 0.03, below the uncertainty of a match, one in fourteen did, by
chance.
"""


class Certainty(NamedTuple):
    """The part of a verdict that is filled in here; `Verdict` documents the fields."""

    candidates: tuple[CandidateScore, ...]
    certainty: str


def judge_uncertainty(
    candidates: Sequence[CandidateScore],
    twins: Sequence[Candidate],
    gaps: PlantGaps,
    nominal: str | None,
    loop: LoopConditions,
    *,
    plant: Parameters | None = None,
    seed: int = SEED,
) -> Certainty:
    """Add intervals and probabilities to the scores of a family, and margins to all candidates.

    A candidate that cannot be held at its operating point has no margin, and the reason for the first point
    at which one cannot be linearised is reported; neither is an error.

    Args:
        candidates: scores of the family, and after them of candidates beside it.
        twins: the family.
        gaps: ν-gaps between their plants.
        nominal: name of the candidate of the family that was chosen.
        loop: the loop in which they are held; its controller, if known, gives the margins.
        plant: the plant as it is now, if known; it decides between two candidates.
        seed: of the random draws.
    """
    names = [c.name for c in candidates]
    if nominal not in names:
        return Certainty(tuple(candidates), "")
    chosen = names.index(nominal)
    all_scores = with_margins(candidates, chosen, loop.law)
    scored = all_scores[: len(twins)]
    if twins[0].parameters.model.plant.single:
        scored = _with_intervals(
            scored, family_uncertainty(twins, gaps, loop, plant=plant, seed=seed)
        )
    sentences = [_choice(scored, chosen)]
    sentences += [_reach(scored, chosen)] if loop.law is not None else []
    sentences += [f"not compared everywhere: {reason}" for reason in gaps.left_out[:1]]
    return Certainty((*scored, *all_scores[len(twins) :]), "; ".join(sentences))


def _with_intervals(
    candidates: Sequence[CandidateScore], uncertainty: FamilyUncertainty
) -> tuple[CandidateScore, ...]:
    with_intervals = []
    for k, candidate in enumerate(candidates):
        score = replace(
            candidate,
            nu_gap_low=tuple(uncertainty.nu_gap_low[k].tolist()),
            nu_gap_high=tuple(uncertainty.nu_gap_high[k].tolist()),
            nu_gap_sum_low=float(uncertainty.sum_low[k]),
            nu_gap_sum_high=float(uncertainty.sum_high[k]),
            nominal_probability=float(uncertainty.nominal_probability[k]),
        )
        with_intervals.append(score)
    return tuple(with_intervals)


def with_margins(
    candidates: Sequence[CandidateScore], chosen: int, law: Law | None
) -> tuple[CandidateScore, ...]:
    """Add the running controller's margin for each candidate, and its ν-gap from the chosen one.

    A candidate that cannot be held at its operating point has none; without a known controller, none has.
    """
    if isinstance(law, LinearLaw):
        twins = tuple((c.parameters, c.operating_point) for c in candidates)
        try:
            figures = _held_by(law, twins, chosen)
        except UndefinedError:
            return tuple(candidates)
    elif isinstance(law, PidGains):
        try:
            controller = loop_controller(law)
        except TwinmatchError:  # the controller has no proportional part to scale by
            return tuple(candidates)
        plants = [_plant(c, law) for c in candidates]
        centre = plants[chosen]
        figures = tuple(_figures_of(plant, controller, centre) for plant in plants)
    else:
        return tuple(candidates)
    return tuple(
        replace(c, margin=margin, plant_gap_to_nominal=gap)
        for c, (margin, gap) in zip(candidates, figures, strict=True)
    )


_margin = lru_cache(maxsize=64)(stability_margin)
_Figures = tuple[float | None, float | None]
"""Margin of a candidate, and its ν-gap from the chosen one."""


def _figures_of(
    plant: GraphSymbol | None, controller: GraphSymbol, centre: GraphSymbol | None
) -> _Figures:
    """Those of a candidate's plant; None where it cannot be held."""
    if plant is None:
        return None, None
    return _margin(plant, controller), nu_gap(plant, centre) if centre else None


@lru_cache(maxsize=16)  # a family stays for many verdicts
def _held_by(
    law: LinearLaw, twins: tuple[tuple[Parameters, OperatingPoint], ...], chosen: int
) -> tuple[_Figures, ...]:
    """Margin of each twin's plant with a linear law, and its ν-gap from the chosen one, in the units in which
    that margin exceeds the gaps by most; None for one that cannot be held, and for all if it is the chosen.
    """
    systems: list[StateSpace | None] = []
    for parameters, point in twins:
        try:
            systems.append(StateSpace.of(linearised(parameters, point, law.period)))
        except TwinmatchError:
            systems.append(None)
    centre = systems[chosen]
    controller = StateSpace.of(law)
    if centre is None:
        return ((None, None),) * len(twins)
    spans = spans_of(twins[0][0].model.plant)
    family = [system for system in systems if system is not None]
    y, u, *_ = best_scaling(
        centre, family, controller, outputs=spans.output, inputs=spans.input
    )
    scaled_centre = centre.scaled(y, u)
    scaled_controller = controller.scaled(u, y)
    figures: list[_Figures] = []
    for system in systems:
        if system is None:
            figures.append((None, None))
        else:
            scaled = system.scaled(y, u)
            figures.append(
                (
                    matrix_margin(scaled, scaled_controller),
                    matrix_nu_gap(scaled_centre, scaled),
                )
            )
    return tuple(figures)


def _plant(candidate: CandidateScore, gains: PidGains) -> GraphSymbol | None:
    try:
        return loop_plant(
            candidate.parameters,
            one_of_each("set-point", point_values(candidate.operating_point)),
            gains,
        )
    except TwinmatchError:
        return None


def _choice(candidates: Sequence[CandidateScore], chosen: int) -> str:
    name = candidates[chosen].name
    share = candidates[chosen].nominal_probability
    if len(candidates) == 1:
        return f"{name} is the only candidate"
    if math.isnan(share):
        return f"{name} is nearest to the whole family"
    if share >= DECIDED_FROM:
        return f"{name} is nominal with probability {_probability(share)}"
    rivals = [c for c in candidates if c.name != name]
    rival = rivals[int(np.argmax([c.nominal_probability for c in rivals]))]
    return (
        f"the data do not decide which candidate is nominal: {name} with probability {_probability(share)}, "
        f"{rival.name} with {_probability(rival.nominal_probability)}"
    )


def _probability(share: float) -> str:
    """Format a probability as finely as the draws resolve it."""
    if share > 0.99:
        return "above 0.99"
    return "below 0.01" if share < 0.01 else f"{share:.2f}"


def _reach(candidates: Sequence[CandidateScore], chosen: int) -> str:
    """Which candidates the controller is guaranteed to hold (Vinnicombe: ν-gap to nominal below margin)."""
    margin = candidates[chosen].margin
    lost = [c.name for c in candidates if c.margin == 0]
    if margin is None:
        return "the controller has no margin for it, because no input holds it at its set-point"
    if margin == 0:
        return "the controller does not stabilise it"
    begin = (
        f"the controller stabilises it and every plant within a ν-gap of {margin:.2f}"
    )
    gaps = {
        c.name: c.plant_gap_to_nominal
        for c in candidates
        if c.name != candidates[chosen].name
    }
    beyond = [
        f"{n} ({g:.2f} away)" for n, g in gaps.items() if g is not None and g >= margin
    ]
    within = [g for g in gaps.values() if g is not None and g < margin]
    if lost:
        return f"{begin}, but not {', '.join(lost)}"
    if beyond:
        return f"{begin}, which excludes {', '.join(beyond)}"
    if within and len(within) == len(gaps):
        return f"{begin}, which covers all candidates (the farthest is {max(within):.2f} away)"
    return begin
