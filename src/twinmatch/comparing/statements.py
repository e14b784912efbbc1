"""What is said of trust and of faults: statements, computed once from a verdict.

Terminal, lines, page, report, `/diagnostics`, metrics and MQTT show these statements, each in its own form.
They have no words of their own for a level, its reason or a fault.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from twinmatch.comparing.doubts import horizon_list
from twinmatch.comparing.verdict import LEVEL_WORDS, TrustLevel, Verdict
from twinmatch.safety import is_limit
from twinmatch.signals import time_text

_PLACE: Final = ": look at "
"""In a reason of the health monitor: what precedes the place to look at."""
ANYWHERE: Final = "drive, sensor and cables"
"""Where to look at a plant whose fault does not say it."""


class TrustStatement(NamedTuple):
    """How far to trust the leader's forecasts."""

    level: TrustLevel = TrustLevel.UNKNOWN
    reason: str = LEVEL_WORDS[TrustLevel.UNKNOWN]
    """Why so far and no further: a part of a sentence."""
    horizons: tuple[float, ...] = ()
    """Horizons, s, at which the forecasts pass the test of trust, whatever the level."""
    doubts: str = ""
    """At which others they do not pass it, and why; empty if at none."""
    missed_since: int | None = None
    """First sample of the current stretch outside the bands, where that is the doubt."""

    @property
    def longest(self) -> float:
        """The longest horizon at which forecasts are trusted now, s; 0: at none."""
        return (
            max(self.horizons, default=0.0) if self.level is TrustLevel.TRUSTED else 0.0
        )


NOWHERE: Final = "at no horizon"


def ahead_words(horizons: tuple[float, ...]) -> str:
    """At which horizons, s, forecasts pass the test of trust."""
    return f"{horizon_list(horizons)} s ahead" if horizons else NOWHERE


class FaultStatement(NamedTuple):
    """A fault that is on."""

    name: str
    """Its kind, such as `drive-lost`; of the drive itself, what the fault does to the output."""
    signal: str
    """Name in the plant file of what it concerns; empty if it names none."""
    called: str
    """The name; on a plant with several loops with what it concerns."""
    reason: str
    """Its evidence, as a sentence."""
    level: TrustLevel
    """What it leaves of the trust in the leader."""
    since: int | None = None
    """First sample at which it shows; None where that is not known."""

    @property
    def with_reason(self) -> str:
        """Name and evidence."""
        return f"{self.called}: {self.reason}"

    @property
    def with_signal(self) -> str:
        """Name and what it concerns, as programs know them."""
        return f"{self.name} of {self.signal}" if self.signal else self.name

    @property
    def place(self) -> str:
        """Where to look."""
        return self.reason.partition(_PLACE)[2] or ANYWHERE

    def begin(self, period: float) -> str:
        """Since when it shows, for a sample time in s; empty where that is not known."""
        if self.since is None:
            return ""
        return f"since {time_text(self.since, period)} s"

    def with_begin(self, period: float) -> str:
        """Name, and since when it shows, for a sample time in s."""
        return f"{self.called} {self.begin(period)}".rstrip()


class Statements(NamedTuple):
    """All that is said at one sample."""

    trust: TrustStatement
    plant_fault: FaultStatement | None
    """The fault that the newest verdict found in the plant."""
    drive_fault: FaultStatement | None
    """What holds the output at zero, or limits it."""

    @property
    def faults(self) -> tuple[FaultStatement, ...]:
        """The faults that are on."""
        return tuple(
            fault for fault in (self.plant_fault, self.drive_fault) if fault is not None
        )


def statements_of(verdict: Verdict | None, drive_fault: str = "") -> Statements:
    """What the newest verdict says (None: before the first), beside the fault that the drive reports."""
    trust = TrustStatement() if verdict is None else _trust_in(verdict)
    return Statements(trust, plant_fault(verdict), fault_of_drive(drive_fault))


def _trust_in(verdict: Verdict) -> TrustStatement:
    is_doubtful = verdict.level is TrustLevel.DOUBTFUL
    return TrustStatement(
        level=verdict.level,
        reason=verdict.level_reason or LEVEL_WORDS.get(verdict.level, ""),
        horizons=verdict.trusted,
        doubts=verdict.doubts,
        missed_since=verdict.miss_since if is_doubtful else None,
    )


def plant_fault(verdict: Verdict | None) -> FaultStatement | None:
    """The fault of the plant that a verdict names; None without one."""
    if verdict is None or not verdict.fault:
        return None
    return FaultStatement(
        name=verdict.fault,
        signal=verdict.fault_signal,
        called=verdict.named_fault,
        reason=verdict.reason,
        level=verdict.level,
        since=verdict.fault_since,
    )


def fault_of_drive(report: str) -> FaultStatement | None:
    """The fault that the guard of the drive reports as `kind: why`; None for an empty report."""
    if not report:
        return None
    kind, _, why = report.partition(": ")
    effect = (
        "output limited"
        if is_limit(report)
        else f"output held at zero: {kind.replace('_', ' ')}"
    )
    return FaultStatement(
        name=effect, signal="", called=effect, reason=why, level=TrustLevel.FAULT
    )
