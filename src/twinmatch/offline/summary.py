"""The summary of a judged session: leader, its fit, nominal candidate, and where forecasts have held."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from twinmatch.comparing import (
    REFUSED,
    CandidateScore,
    TrustLevel,
    TrustStatement,
    Verdict,
    number_list,
    statements_of,
)
from twinmatch.dynamics import Law, Parameters, Plant
from twinmatch.signals import Window, time_text
from twinmatch.twin import Fits, window_fits
from twinmatch.twin.trust import merged

MAX_RANGES: Final = 3
"""Most ranges of levels in a sentence: the widest."""


class ShownTwin(NamedTuple):
    """The twin that displays show."""

    name: str
    parameters: Parameters

    @property
    def is_structure(self) -> bool:
        """Whether it is a structure under its own name."""
        return self.name == self.parameters.model.structure_name

    @property
    def is_match(self) -> bool:
        """Whether it is named after an operating point; others were given, and have names of their own."""
        points = [point.partition(" ") for point in self.name.split(", ")]
        numbers = all(point.lstrip("-")[:1].isdecimal() for point, _, _ in points)
        units = [output.unit for output in self.parameters.model.plant.outputs.values()]
        return numbers and [unit for _, _, unit in points] == units


def nominal_score(verdict: Verdict | None) -> CandidateScore | None:
    """The nominal candidate of a verdict; None without one."""
    return None if verdict is None else verdict.chosen


def shown_twin(verdict: Verdict | None) -> ShownTwin | None:
    """The leader, or the nominal candidate in old recordings without leaders; None without both."""
    if verdict is None:
        return None
    parameters = {c.name: c.parameters for c in verdict.candidates}
    parameters |= {f.name: f.parameters for f in verdict.forecasts}
    name = verdict.leader or verdict.nominal
    return ShownTwin(name, parameters[name]) if name in parameters else None


class TrustRange(NamedTuple):
    """Levels of the output."""

    spans: tuple[tuple[float, float], ...]
    """Lowest and highest of each range, lowest first."""
    unit: str
    decimals: int = 0
    """Decimal places to which the ends are rounded."""

    def __str__(self) -> str:
        """The widest ranges in words, such as "between 20 and 30 °C", their ends rounded inwards."""
        widest = sorted(self.spans, key=lambda span: span[0] - span[1])[:MAX_RANGES]
        return number_list(
            [f"between {self._rounded(*span)}" for span in sorted(widest)]
        )

    def _rounded(self, low: float, high: float) -> str:
        steps = 10.0**self.decimals
        low_inside = math.ceil(low * steps) / steps
        high_inside = math.floor(high * steps) / steps
        if low_inside <= high_inside:  # else the range is narrower than the rounding
            low = low_inside
            high = high_inside
        return (
            f"{low:.{self.decimals}f} and {high:.{self.decimals}f} {self.unit}".rstrip()
        )


def held_levels(
    plant: type[Plant], ranges: Sequence[tuple[float, float]]
) -> TrustRange | None:
    """Where forecasts have held, one decimal place coarser than the output's; None if nowhere.

    Verdicts record one range of levels. Of several outputs it is that of the first, which is named with the
    unit.
    """
    if not ranges:
        return None
    first, *further_outputs = plant.outputs.values()
    of_first = f" of {first.text or first.name}" if further_outputs else ""
    return TrustRange(
        tuple(ranges), f"{first.unit}{of_first}", max(0, first.decimals - 1)
    )


class LevelStretch(NamedTuple):
    """Samples with the same trust level and the same fault, both ends included."""

    first: int
    last: int
    level: TrustLevel
    fault: str = ""
    """Name of the plant's fault; empty for none."""
    since: int | None = None
    """First sample of the fault's trace, which may be long before the fault was named; None: that of the
    stretch."""

    @property
    def begins(self) -> int:
        """First sample of the fault's trace, or of the stretch."""
        return self.first if self.since is None else self.since

    def times(self, period: float) -> str:
        """From when to when the level was stated, for a sampling period in s."""
        return _times_text(self.first, self.last, period)

    def fault_times(self, period: float) -> str:
        """From when to when the fault has shown, for a sampling period in s."""
        return _times_text(self.begins, self.last, period)


def _times_text(first: int, last: int, period: float) -> str:
    return f"{time_text(first, period)} to {time_text(last, period)} s"


@dataclass(frozen=True)
class SessionSummary:
    """State at the end of a session: leader, its fit to the whole session, and nominal candidate."""

    nominal: str | None
    trust: TrustStatement
    """How far to trust the leader, by the last verdict."""
    parameters: Parameters | None
    """Of the leader; of the nominal candidate in old recordings without leaders."""
    fit_y: float
    """NRMSE fit of that twin's output (of several the worst) over the whole session, 1 at best; NaN without
    candidates."""
    fit_u: float
    """The same of its input."""
    verdicts: int
    identified: int
    """Verdicts whose window excited the loop."""
    matches: dict[str, int]
    """How many matches were admitted, and how many refused."""
    notes: tuple[str, ...] = ()
    order: str | None = None
    """Box–Jenkins order chosen for the nominal candidate."""
    range: TrustRange | None = None
    """Where forecasts have held."""
    leader: str | None = None
    """The twin to ask what comes next."""
    leader_confidence: float = math.nan
    """How often its error was within 3 % of the best candidate's, 0 to 1."""
    refusal: str = ""
    """Why no match came of the last excited window that gave none; empty without one."""
    closed: bool = True
    """Whether the loop is known; otherwise the fit is that of the driven twin."""
    stretches: tuple[LevelStretch, ...] = ()
    """The trust level over time, oldest first."""
    period: float = 1.0
    """Sample time, s."""
    fits: Fits | None = None
    """Fits of each output and input; None without candidates."""


MAX_STRETCHES: Final = 400
"""Most stretches of the trust level in a tally: the newest."""


class Tally:
    """Counts over the verdicts for a summary, updated one verdict at a time."""

    def __init__(
        self, verdicts: Iterable[Verdict] = (), first: int | None = None
    ) -> None:
        """Start with these verdicts; `first`: the session's first sample, by default that of the first
        window."""
        self.last: Verdict | None = None
        self.verdicts = self.identified = 0
        self.refusal = ""
        self.matches: Counter[str] = Counter()
        """How many matches were admitted, and how many refused."""
        self.stretches: list[LevelStretch] = []
        """The trust level over time: that of a verdict covers the samples since the last one, and that of a
        fault those since it was named."""
        self.held: list[tuple[float, float]] = []
        """Lowest and highest output of each range in which forecasts have held, lowest first."""
        self._first = first
        for verdict in verdicts:
            self.push(verdict)

    def push(self, verdict: Verdict) -> None:
        """Take a verdict."""
        self.verdicts += 1
        self.identified += not verdict.stands
        if verdict.match:
            self.matches[verdict.match] += 1
        if verdict.match == REFUSED:
            self.refusal = verdict.reason
        if not math.isnan(verdict.held_low):
            # the range around the readings: others were held before
            self.held = merged([*self.held, (verdict.held_low, verdict.held_high)])
        self._extend(verdict)
        self.last = verdict

    def _extend(self, verdict: Verdict) -> None:
        """Extend the trust level over time.

        The level of a fault begins at the verdict that names it, although its trace began at `fault_since`,
        and lasts until the first verdict without it.
        """
        if self._first is None:
            self._first = max(0, min(verdict.first, verdict.sample))
        sample = max(verdict.sample, self._first)
        fault = verdict.named_fault
        since = verdict.fault_since if fault else None
        stretch = LevelStretch(self._first, sample, verdict.level, fault, since)
        if self.last is None and fault and sample > self._first:
            # nothing was said before it
            self.stretches.append(LevelStretch(self._first, sample, TrustLevel.UNKNOWN))
        if not self.stretches:
            self.stretches.append(stretch)
            return
        last = self.stretches[-1]
        if (last.level, last.fault) == (stretch.level, stretch.fault):
            self.stretches[-1] = last._replace(last=sample)
            return
        fault_ends = last.fault and last.fault != fault
        if fault_ends:
            last = last._replace(last=max(sample - 1, last.last))
        begin = last.last + 1
        fault_begins = fault not in {"", last.fault}
        if fault_begins:
            begin = max(sample, last.first + 1)
            last = last._replace(last=begin - 1)
        self.stretches[-1:] = [
            last,
            stretch._replace(first=begin, last=max(sample, begin)),
        ]
        del self.stretches[:-MAX_STRETCHES]


def summarise(
    stretches: Sequence[Window],
    verdicts: Sequence[Verdict],
    law: Law | None,
    notes: Sequence[str] = (),
) -> SessionSummary:
    """Summarise a judged session from its stretches, as `filled_stretches` gives them, and its verdicts."""
    first = stretches[0].first if stretches else None
    period = stretches[0].period if stretches else 1.0

    def longest() -> tuple[Window, int]:
        return max(stretches, key=len), len(stretches)

    return conclude(Tally(verdicts, first), longest, law, notes, period)


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
    nominal = nominal_score(last)
    shown = shown_twin(last)
    fits = None
    remarks = list(notes)
    if shown is not None:
        window, stretches = longest()
        if stretches > 1:
            remarks.append(
                f"the fit is over samples {window.first} to {window.last}, "
                f"the longest of {stretches} unbroken stretches"
            )
        fits = window_fits(shown.parameters, window, law)
    fit = fits.worst if fits else (math.nan, math.nan)
    return SessionSummary(
        nominal=last.nominal if last else None,
        trust=statements_of(last).trust,
        parameters=shown.parameters if shown else None,
        fit_y=fit[0],
        fit_u=fit[1],
        verdicts=tally.verdicts,
        identified=tally.identified,
        matches=dict(tally.matches),
        notes=tuple(remarks),
        order=nominal.chosen_order if nominal else None,
        range=held_levels(shown.parameters.model.plant, tally.held) if shown else None,
        leader=last.leader if last else None,
        leader_confidence=last.leader_confidence if last else math.nan,
        refusal=tally.refusal,
        closed=law is not None,
        stretches=tuple(tally.stretches),
        period=period,
        fits=fits,
    )
