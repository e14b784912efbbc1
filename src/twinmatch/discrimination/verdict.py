"""What is published: the family's scores, the nominal candidate, and how far to trust it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Final

from twinmatch.discrimination.score import Criteria, OrderScore
from twinmatch.dynamics import Parameters

__all__ = ["ADMITTED", "REFUSED", "CandidateScore", "ForecastScore", "TrustLevel", "Verdict", "nominal_of"]

ADMITTED: Final = "admitted"
"""The match is a candidate of the family now."""
REFUSED: Final = "refused"
"""The gate, a fault of the plant or the lack of models kept it out; the verdict's reason says which."""


class TrustLevel(Enum):
    """How far to trust the leader, from the newest window."""

    UNKNOWN = "unknown"
    """There is no candidate yet, or nothing has come of what it foretold."""
    TRUSTED = "trusted"
    """What came lies in the bands that were given before."""
    DOUBTFUL = "doubtful"
    """What came lies outside, or a window cannot be explained; `miss_since` says since when."""
    FAULT = "fault"
    """No parameters explain what the plant does; look at the plant."""


@dataclass(frozen=True)
class CandidateScore:
    """One candidate of the family at the moment of a verdict."""

    name: str
    operating_point: float
    """In the output's unit."""
    parameters: Parameters
    first: int
    """First sample of the window it was matched on; equal to `last` + 1 for one that was given."""
    last: int
    orders: tuple[OrderScore, ...]
    """Every order, scored on the measured window the candidate was matched on."""
    chosen_order: str
    nu_gap_sum: float
    """Column sum of `Verdict.nu_gap`."""
    newest: Criteria | None
    """The family's order scored on the newest window that excited the loop, both outputs together."""
    nu_gap_to_plant: float | None
    """Largest ν-gap, over the family's operating points, between this plant and the plant as the newest
    samples show it."""
    margin: float | None = None
    """Stability margin b(P, C) of the running controller on this candidate's plant, 0 to 1."""
    plant_gap_to_nominal: float | None = None
    """ν-gap from the nominal candidate's plant to this one's, input to output, scaled as `margin`."""
    nu_gap_low: tuple[float, ...] = ()
    """Lower ends of the 90 % intervals of the ν-gaps to the candidates, in their order."""
    nu_gap_high: tuple[float, ...] = ()
    """Upper ends of the same intervals."""
    nu_gap_sum_low: float = math.nan
    """Lower end of the 90 % interval of `nu_gap_sum`; NaN where not computed, as for the two below."""
    nu_gap_sum_high: float = math.nan
    nominal_probability: float = math.nan
    """Probability, given what the matches leave open, of having the smallest ν-gap sum."""
    identified_gap_sum: float = math.nan
    """Column sum of `Verdict.identified_gap`; NaN where not computed."""
    identified_gap_to_plant: float | None = None
    """ν-gap from its model of the family's order to that identified on the newest measured window."""


@dataclass(frozen=True)
class ForecastScore:
    """What the forecasts of one candidate have been worth."""

    name: str
    parameters: Parameters
    first: int
    """First sample of what it was fitted to; equal to `last` + 1 for one that was given."""
    last: int
    gain: float
    """Characters its forecasts of output and input have saved, against saying that nothing changes; the mean
    over forecasts, those long ago counting less, summed over the horizons. NaN before one could be compared
    with what came."""
    gains: tuple[float, ...]
    """The same at each horizon."""
    forecasts: float
    """How many forecasts that is the mean of."""


@dataclass(frozen=True)
class Verdict:
    """One judgement of the family."""

    sample: int
    """Index of the sample that set it off."""
    first: int
    last: int
    """The window it looked at."""
    level: TrustLevel
    stands: bool
    """True when the window identified nothing and the scores are those of the verdict before."""
    nominal: str | None
    """Name of the candidate with the smallest ν-gap sum."""
    reason: str
    """One plain sentence."""
    decimals: int
    """Decimal places of the tables in the information gain."""
    candidates: tuple[CandidateScore, ...]
    order: str | None
    """The order most candidates chose; `identified_gap` compares their models of this order."""
    nu_gap: tuple[tuple[float, ...], ...]
    """Largest ν-gap between the candidates' plants over `nu_gap_points`, in the order of `candidates`."""
    driven_rms_y: float
    """RMS over the newest samples of measured minus driven-twin output; NaN without a nominal."""
    closed_rms_u: float
    """RMS over the same samples of measured minus closed-loop-twin input; NaN without a nominal."""
    nu_gap_points: tuple[float, ...] = ()
    """Operating points at which the candidates' plants are compared, in the output's unit."""
    identified_gap: tuple[tuple[float, ...], ...] = ()
    """ν-gap between the models identified on the candidates' twins, as in the paper; in the same order."""
    match: str = ""
    """What became of the window's match: `ADMITTED`, `REFUSED`, or nothing where none was to be made."""
    dismissed: tuple[str, ...] = ()
    """Names of the candidates that left with this verdict: matched while the fault already showed."""
    decided: bool = False
    """Whether the data tell who leads: `leader_confidence` is 0.9 or more."""
    certainty: str = ""
    """Plain words: how sure the leader is, how sure the nominal, and which candidates the running controller
    holds for."""
    fault: str = ""
    """Name of the fault a health monitor found in the plant; empty for none."""
    fault_since: int | None = None
    """Index of the sample since which that fault shows; None without a fault."""
    structure: str = ""
    """Name of the plant structure that the samples pay for; empty before the first comparison."""
    structure_parameters: Parameters | None = None
    """The plant as that structure has it."""
    leader: str | None = None
    """Name of the candidate whose forecasts have saved the most characters: the twin to ask what comes."""
    leader_confidence: float = math.nan
    """How often the leader's error of the longest horizon was, so far, within 3 % of the best candidate's in
    hindsight; NaN without a leader."""
    miss_y: float = math.nan
    """RMS over the newest samples of output minus forecast, in half widths of the band that the leader gave
    before them; NaN where none was given."""
    miss_u: float = math.nan
    """The same of the input."""
    inside_y: float = math.nan
    """Share of those samples whose output lay in the band; 0.9 is promised."""
    inside_u: float = math.nan
    miss_since: int | None = None
    """Index of the first sample of the stretch in which what came lies outside; None while it does not."""
    held_low: float = math.nan
    """Least output of the levels at which forecasts came true, as far as they hang together; NaN for none."""
    held_high: float = math.nan
    """Greatest output of these levels."""
    horizons: tuple[float, ...] = ()
    """Of the forecasts, s."""
    forecasts: tuple[ForecastScore, ...] = ()
    """Every candidate that foretells, the leader among them."""

    @property
    def modelled(self) -> tuple[CandidateScore, ...]:
        """The paper's family: candidates that have Box–Jenkins models, first among all, in the order of
        `identified_gap`. Those behind them are other structures of the plant."""
        return tuple(candidate for candidate in self.candidates if candidate.orders)


def nominal_of(candidates: tuple[CandidateScore, ...]) -> str | None:
    """The candidate nearest to the whole family.

    The smallest ν-gap sum names it (paper, section IV-C). Of equal sums (two candidates always have
    equal ones) the one nearest to the plant as it is now.
    """
    if not candidates:
        return None

    def rank(candidate: CandidateScore) -> tuple[float, float, str]:
        to_plant = 1.0 if candidate.nu_gap_to_plant is None else candidate.nu_gap_to_plant
        return candidate.nu_gap_sum, to_plant, candidate.name

    return min(candidates, key=rank).name
