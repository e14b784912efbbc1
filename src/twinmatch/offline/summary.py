"""The summary of a judged session: leader, its fit, nominal candidate, and where forecasts have held."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from twinmatch.comparing import REFUSED, CandidateScore, TrustLevel, Verdict
from twinmatch.dynamics import Law, Output, Parameters
from twinmatch.signals import Window
from twinmatch.twin import window_fit


class ShownTwin(NamedTuple):
    """The twin that displays show."""

    name: str
    parameters: Parameters

    @property
    def is_structure(self) -> bool:
        """Whether it is a structure under its own name, and not a match named after an operating point."""
        return self.name == self.parameters.model.structure_name


def nominal_score(verdict: Verdict | None) -> CandidateScore | None:
    """The nominal candidate of a verdict; None without one."""
    candidates = verdict.candidates if verdict is not None else ()
    return next((c for c in candidates if verdict and c.name == verdict.nominal), None)


def shown_twin(verdict: Verdict | None) -> ShownTwin | None:
    """The leader, or the nominal candidate in old recordings without leaders; None without both."""
    if verdict is None:
        return None
    known = {c.name: c.parameters for c in verdict.candidates}
    known |= {f.name: f.parameters for f in verdict.forecasts}
    name = verdict.leader or verdict.nominal
    return ShownTwin(name, known[name]) if name in known else None


class TrustRange(NamedTuple):
    """Lowest and highest output."""

    low: float
    high: float
    unit: str
    decimals: int = 0
    """Decimal places to which the ends are rounded."""

    def __str__(self) -> str:
        """Both ends, rounded inwards."""
        steps = 10.0**self.decimals
        low, high = math.ceil(self.low * steps) / steps, math.floor(self.high * steps) / steps
        if low > high:  # the range is narrower than the rounding
            low, high = self.low, self.high
        return f"{low:.{self.decimals}f} and {high:.{self.decimals}f} {self.unit}".rstrip()


def trust_range(verdict: Verdict, output: Output) -> TrustRange | None:
    """The range in which forecasts have held, one decimal place coarser than the output; None if none has."""
    if math.isnan(verdict.held_low):
        return None
    return TrustRange(verdict.held_low, verdict.held_high, output.unit, max(0, output.decimals - 1))


class FaultSpan(NamedTuple):
    """A fault of the plant that was reported."""

    fault: str
    first: int
    """Sample since which it was there."""
    last: int | None = None
    """Sample of the first verdict without it; None while it lasts."""

    def words(self, period: float) -> str:
        """Its name and when it was there, for a sampling period in s."""
        if self.last is None:
            return f"{self.fault} since {self.first * period:.0f} s"
        return f"{self.fault} from {self.first * period:.0f} to {self.last * period:.0f} s"


@dataclass(frozen=True)
class SessionSummary:
    """State at the end of a session: leader, its fit to the whole session, and nominal candidate."""

    nominal: str | None
    level: TrustLevel
    """Of the last verdict."""
    parameters: Parameters | None
    """Of the leader; of the nominal candidate in old recordings without leaders."""
    fit_y: float
    """NRMSE fit of that twin's output over the whole session, 1 at best; NaN without candidates."""
    fit_u: float
    verdicts: int
    identified: int
    """Verdicts whose window excited the loop."""
    matches: dict[str, int]
    """How many matches were admitted, and how many refused."""
    notes: tuple[str, ...] = ()
    order: str | None = None
    """Box–Jenkins order chosen for the nominal candidate."""
    range: TrustRange | None = None
    """Range of the output in which forecasts have held."""
    why: str = ""
    """The reason of the level."""
    proven: tuple[float, ...] = ()
    """Horizons, s, at which the leader's forecasts have been better than those that need no twin."""
    beaten: str = ""
    """Where a forecast that needs no twin is better, in words; empty if nowhere."""
    leader: str | None = None
    """The twin to ask what comes next."""
    leader_confidence: float = math.nan
    """How often its error was within 3 % of the best candidate's, 0 to 1."""
    refusal: str = ""
    """Why no match came of the last excited window that gave none; empty without one."""
    closed: bool = True
    """Whether the loop is known; otherwise the fit is that of the driven twin."""
    faults: tuple[FaultSpan, ...] = ()
    """Faults of the plant, oldest first."""
    period: float = 1.0
    """Sample time, s."""


class Tally:
    """Counts over the verdicts for a summary, updated one verdict at a time."""

    def __init__(self, verdicts: Iterable[Verdict] = ()) -> None:
        """Start with these verdicts."""
        self.last: Verdict | None = None
        self.verdicts = self.identified = 0
        self.refusal = ""
        self.matches: Counter[str] = Counter()
        """How many matches were admitted, and how many refused."""
        self.faults: list[FaultSpan] = []
        for verdict in verdicts:
            self.push(verdict)

    def push(self, verdict: Verdict) -> None:
        """Take a verdict."""
        self.last = verdict
        self.verdicts += 1
        self.identified += not verdict.stands
        if verdict.match:
            self.matches[verdict.match] += 1
        if verdict.match == REFUSED:
            self.refusal = verdict.reason
        lasting = self.faults[-1] if self.faults and self.faults[-1].last is None else None
        now = (verdict.fault, verdict.fault_since)
        if lasting is not None and now != lasting[:2]:
            self.faults[-1] = lasting._replace(last=verdict.sample)
            lasting = None
        if lasting is None and verdict.fault and verdict.fault_since is not None:
            self.faults.append(FaultSpan(verdict.fault, verdict.fault_since))


def summarise(
    stretches: Sequence[Window],
    verdicts: Sequence[Verdict],
    law: Law | None,
    notes: Sequence[str] = (),
) -> SessionSummary:
    """Summarise a judged session from its stretches, as `filled_stretches` gives them, and its verdicts."""
    period = stretches[0].period if stretches else 1.0
    return conclude(Tally(verdicts), lambda: (max(stretches, key=len), len(stretches)), law, notes, period)


def conclude(
    tally: Tally,
    longest: Callable[[], tuple[Window, int]],
    law: Law | None,
    notes: Sequence[str] = (),
    period: float = 1.0,
) -> SessionSummary:
    """Summarise a session with this sample time, s; `longest` returns its longest unbroken stretch and the
    number of stretches, and is called only if there is a twin to compare it with."""
    last = tally.last
    nominal, shown = nominal_score(last), shown_twin(last)
    fit = (math.nan, math.nan)
    remarks = list(notes)
    if shown is not None:
        window, stretches = longest()
        if stretches > 1:
            remarks.append(
                f"the fit is over samples {window.first} to {window.last}, "
                f"the longest of {stretches} unbroken stretches"
            )
        fit = window_fit(shown.parameters, window, law)
    return SessionSummary(
        nominal=last.nominal if last else None,
        level=last.level if last else TrustLevel.UNKNOWN,
        parameters=shown.parameters if shown else None,
        fit_y=fit[0],
        fit_u=fit[1],
        verdicts=tally.verdicts,
        identified=tally.identified,
        matches=dict(tally.matches),
        notes=tuple(remarks),
        order=nominal.chosen_order if nominal else None,
        range=trust_range(last, shown.parameters.model.plant.output) if last and shown else None,
        why=last.level_reason if last else "",
        proven=last.proven if last else (),
        beaten=last.beaten if last else "",
        leader=last.leader if last else None,
        leader_confidence=last.leader_confidence if last else math.nan,
        refusal=tally.refusal,
        closed=law is not None,
        faults=tuple(tally.faults),
        period=period,
    )
