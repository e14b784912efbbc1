"""The published verdict: the family's scores, leader and nominal candidate, and how far to trust them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Final

from twinmatch.comparing.criteria import Criteria, OrderScore
from twinmatch.comparing.doubts import doubt_words
from twinmatch.comparing.forecast_score import ForecastScore, SignalScore
from twinmatch.dynamics import Parameters, Plant
from twinmatch.requirements import FINITE, RISING, SHARE, Among, Sized, Within
from twinmatch.signals import OperatingPoint

ADMITTED: Final = "admitted"
"""The match is now a candidate of the family."""
REFUSED: Final = "refused"
"""The gate, a fault of the plant or missing models kept it out; the verdict's reason says which."""


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
