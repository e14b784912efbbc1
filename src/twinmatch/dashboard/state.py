"""Everything the page shows, bounded however long it stands open; knows neither ROS nor a browser."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dashboard.events import Event, EventLog, Lane, Mark
from twinmatch.dashboard.history import History
from twinmatch.dashboard.roster import Roster
from twinmatch.description import UNDESCRIBED, Description
from twinmatch.discrimination import TrustLevel, Verdict
from twinmatch.forecasting import Forecast
from twinmatch.signals import Sample
from twinmatch.views.events import Event as Told
from twinmatch.views.events import EventKind, Stretch, events

__all__ = ["CAPACITY", "Answered", "DashboardState", "Drive", "Notice", "TwinRow"]

CAPACITY = 36_000
"""Samples that are kept: an hour at 10 Hz, ten hours at 1 Hz."""
EVENTS = 400
STRETCHES = 400
"""Changes of the trust level that are kept."""
INTERVALS = 31
"""Intervals between samples that the period is the median of."""


class TwinRow(NamedTuple):
    """Both twins at one sample; residuals are measured minus twin, RMS over the newest samples."""

    closed_output: float
    """Twin that is given the set-point."""
    closed_input: float
    driven_output: float
    """Twin that is given the plant's control."""
    closed_residual_y: float
    closed_residual_u: float
    driven_residual_y: float
    closed_rms_y: float
    closed_rms_u: float
    driven_rms_y: float


class Drive(NamedTuple):
    """What drives the plant reported last."""

    input: float
    """Applied, in the input's unit; NaN: not known."""
    current: float
    """A; NaN: not measured."""
    fault: str
    """Why the output is held at zero; empty: it is not."""


class Answered(NamedTuple):
    """A question of the page and what became of it."""

    question: str
    lines: tuple[str, ...]
    """In words; why there is no forecast, if there is none."""
    forecast: Forecast | None = None


class Notice(NamedTuple):
    """What became of the last thing asked for on the page."""

    done: bool
    text: str


class DashboardState:
    """Filled by whoever hears the graph, read by the pages; hold `lock` around several reads.

    A sample whose index is not above the one before begins a session anew: the graph was started again,
    or another recording is played.
    """

    def __init__(self, capacity: int = CAPACITY, described: Description = UNDESCRIBED) -> None:
        """Begin with nothing heard of this plant; `capacity` samples are kept."""
        self.described = described
        """What the plant and its signals are called."""
        self.lock = threading.RLock()
        self.plant = History(("reference", "output", "input"), capacity)
        self.twin = History(TwinRow._fields, capacity)
        self.session = 1
        """Counted from 1."""
        self.period = 1.0
        """Of the samples, s; found from their stamps."""
        self.heard_at: float | None = None
        """When the newest sample came, in seconds of the listener's clock."""
        self.verdict: Verdict | None = None
        self.trust: deque[Stretch] = deque(maxlen=STRETCHES)
        self.verdicts = 0
        """Counts up with every change of the two above."""
        self.sentence = ""
        """What the session comes down to so far; empty: no nominal yet."""
        self.forecast: Forecast | None = None
        """What the leader foretold at the newest sample."""
        self.answered: Answered | None = None
        """The newest question of the page."""
        self.told_ahead = 0
        """Counts up with every change of the two above."""
        self.drive: Drive | None = None
        self.events = EventLog(EVENTS)
        self.roster = Roster()
        self.image: NDArray[np.float32] | None = None
        """Newest thermal image with values, °C, first row on top; NaN where there is none."""
        self.images = 0
        """Images so far."""
        self.notice: Notice | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._previous: Sample | None = None
        self._fault = ""

    @property
    def sample(self) -> int | None:
        """Index of the newest sample."""
        return self.plant.last

    @property
    def fault(self) -> str:
        """The fault that holds the output at zero; empty: there is none."""
        return self._fault

    @property
    def ahead(self) -> Forecast | None:
        """The newest forecast; None if it is of a sample that this session has not come to."""
        last, forecast = self.plant.last, self.forecast
        return None if forecast is None or last is None or forecast.sample > last else forecast

    @property
    def leader(self) -> str:
        """Who foretells best; empty: nobody yet."""
        if self.forecast is not None:
            return self.forecast.candidate
        return "" if self.verdict is None else self.verdict.leader or ""

    def describe(self, described: Description) -> None:
        """Take what the plant says it is called."""
        with self.lock:
            self.described = described

    def push_sample(self, sample: Sample, now: float) -> None:
        """Take a sample that came at `now` (s)."""
        with self.lock:
            previous = self._previous
            self.roster.begin(now)
            if previous is not None and sample.index <= previous.index:
                self._begin(previous.index, sample.index)
            elif previous is not None:
                self._note_interval(sample, previous)
            self.plant.push(sample.index, (sample.reference, sample.output, sample.input))
            self._previous, self.heard_at = sample, now

    def push_twin(self, index: int, row: TwinRow) -> None:
        """Take the twins' state at a sample."""
        with self.lock:
            if self.twin.last is not None and index <= self.twin.last:
                self.twin.clear()
            self.twin.push(index, row)

    def push_verdict(self, verdict: Verdict) -> None:
        """Take a verdict."""
        with self.lock:
            before = [] if self.verdict is None else [self.verdict]
            known = len(events(before))
            for event in events([*before, verdict])[known:]:
                self._tell(event, _mark_of(event, verdict))
            self.verdict = verdict
            self.verdicts += 1
            self._stretch(verdict)

    def push_forecast(self, forecast: Forecast) -> None:
        """Take what the leader foretells."""
        with self.lock:
            self.forecast = forecast
            self.told_ahead += 1

    def answer(self, answered: Answered) -> None:
        """Take note of what was asked on the page and what came of it."""
        with self.lock:
            self.answered = answered
            self.told_ahead += 1

    def push_drive(self, drive: Drive) -> None:
        """Take what the driver's board reported."""
        with self.lock:
            self.drive = drive
            if drive.fault == self._fault:
                return
            self._fault = drive.fault
            if drive.fault:
                kind, _, why = drive.fault.partition(": ")
                title = f"output held at zero: {kind.replace('_', ' ')}"
                self._note(Lane.FAULT, Mark.BAD, title, why)
            else:
                self._note(Lane.FAULT, Mark.GOOD, "fault cleared", "the output may be driven")

    def push_health(self, name: str, level: int, message: str, values: Mapping[str, str], now: float) -> None:
        """Take a report from /diagnostics: name, level of REP 107, and what it says."""
        with self.lock:
            change, plain = self.roster.push(name, level, message, values, now), name.removesuffix(": health")
            if change == "error":
                self._note(Lane.NODES, Mark.BAD, f"{plain} reports an error", message)
            elif change == "well":
                self._note(Lane.NODES, Mark.GOOD, f"{plain} is well again", message)

    def push_image(self, image: NDArray[np.float32]) -> None:
        """Take a thermal image in °C, shape (rows, columns); one without any value is passed over."""
        if not np.isfinite(image).any():
            return
        with self.lock:
            self.image = image
            self.images += 1

    def tell(self, done: bool, text: str) -> None:
        """Take note of what became of something asked for on the page."""
        with self.lock:
            self.notice = Notice(done, text)

    def _begin(self, ended: int, first: int) -> None:
        """Everything that belongs to the session before goes; events stay, as that session's."""
        duration = (ended + 1) * self.period
        self.session += 1
        self.roster.ended = None
        self.plant.clear()
        if self.twin.last is not None and self.twin.last > first:
            self.twin.clear()
        self.verdict, self.verdicts, self.sentence = None, self.verdicts + 1, ""
        self.forecast, self.answered, self.told_ahead = None, None, self.told_ahead + 1
        self.trust.clear()
        self._intervals.clear()
        self._note(Lane.NODES, Mark.NOTE, "a new session began", f"the one before had {duration:g} s")

    def _note_interval(self, sample: Sample, previous: Sample) -> None:
        interval = (sample.stamp - previous.stamp) / 1e9 / (sample.index - previous.index)
        if interval > 0:
            self._intervals.append(interval)
            self.period = float(f"{median(self._intervals):.2g}")

    def _stretch(self, verdict: Verdict) -> None:
        """As `level_stretches` does: a verdict's level is that of the samples since the last."""
        begin = self.trust[-1].last + 1 if self.trust else max(0, min(verdict.first, verdict.sample))
        if self.trust and self.trust[-1].level is verdict.level:
            begin = self.trust.pop().first
        self.trust.append(Stretch(begin, max(verdict.sample, begin), verdict.level))

    def _tell(self, event: Told, mark: Mark) -> None:
        lane = _LANES[event.kind]
        self.events.add(Event(self.session, event.sample, lane, mark, event.title, event.why))

    def _note(self, lane: Lane, mark: Mark, title: str, text: str) -> None:
        self.events.add(Event(self.session, self.sample, lane, mark, title, text))


_LANES = {
    EventKind.ADMITTED: Lane.MATCH,
    EventKind.REFUSED: Lane.MATCH,
    EventKind.DISMISSED: Lane.MATCH,
    EventKind.LEADER: Lane.TRUST,
    EventKind.NOMINAL: Lane.TRUST,
    EventKind.LEVEL: Lane.TRUST,
    EventKind.FAULT: Lane.FAULT,
}
_MARKS = {
    EventKind.ADMITTED: Mark.GOOD,
    EventKind.REFUSED: Mark.WARNING,
    EventKind.DISMISSED: Mark.WARNING,
    EventKind.LEADER: Mark.NOTE,
    EventKind.NOMINAL: Mark.NOTE,
}
_LEVEL_MARKS = {
    TrustLevel.UNKNOWN: Mark.NOTE,
    TrustLevel.TRUSTED: Mark.GOOD,
    TrustLevel.DOUBTFUL: Mark.WARNING,
    TrustLevel.FAULT: Mark.BAD,
}


def _mark_of(event: Told, verdict: Verdict) -> Mark:
    return _MARKS.get(event.kind) or _LEVEL_MARKS[verdict.level]
