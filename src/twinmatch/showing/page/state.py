"""Everything the page shows, in bounded memory; depends on neither ROS nor Bokeh."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.description import UNDESCRIBED, Description
from twinmatch.forecasting import Forecast
from twinmatch.showing.events import Event as SessionEvent
from twinmatch.showing.events import EventKind, Stretch, events
from twinmatch.showing.page.events import Event, EventLog, Lane, Mark
from twinmatch.showing.page.history import History
from twinmatch.showing.page.roster import Roster
from twinmatch.signals import Sample

__all__ = ["CAPACITY", "Answered", "DashboardState", "Drive", "Notice", "TwinRow"]

CAPACITY = 36_000
"""Samples kept: an hour at 10 Hz, ten hours at 1 Hz."""
EVENTS = 400
STRETCHES = 400
"""Changes of the trust level kept."""
INTERVALS = 31
"""The sampling period is the median of so many intervals."""


class TwinRow(NamedTuple):
    """Both twins at one sample; residuals are measured minus twin, RMS over the newest samples."""

    closed_output: float
    """Of the closed-loop twin, driven by the set-point."""
    closed_input: float
    driven_output: float
    """Of the twin driven by the plant's input."""
    closed_residual_y: float
    closed_residual_u: float
    driven_residual_y: float
    closed_rms_y: float
    closed_rms_u: float
    driven_rms_y: float


class Drive(NamedTuple):
    """The last report of the node that drives the plant."""

    input: float
    """Applied value, in the input's unit; NaN: not known."""
    current: float
    """A; NaN: not measured."""
    fault: str
    """Why the output is held at zero; empty: no fault."""


class Answered(NamedTuple):
    """A what-if question and its answer."""

    question: str
    lines: tuple[str, ...]
    """The answer in words, or why there is no forecast."""
    forecast: Forecast | None = None


class Notice(NamedTuple):
    """The result of the last request made on the page."""

    done: bool
    text: str


class DashboardState:
    """Filled by the node, read by the pages; hold `lock` around several reads.

    A sample whose index is not above the previous one starts a new session: the graph was restarted, or
    another recording is played.
    """

    def __init__(self, capacity: int = CAPACITY, described: Description = UNDESCRIBED) -> None:
        """Start empty; `capacity` samples are kept."""
        self.described = described
        """Names and units of the plant and its signals."""
        self.lock = threading.RLock()
        self.plant = History(("reference", "output", "input"), capacity)
        self.twin = History(TwinRow._fields, capacity)
        self.session = 1
        """Counted from 1."""
        self.period = 1.0
        """Sampling period, s; computed from the stamps."""
        self.received_at: float | None = None
        """When the newest sample was received, in seconds of the receiver's clock."""
        self.verdict: Verdict | None = None
        self.trust: deque[Stretch] = deque(maxlen=STRETCHES)
        self.verdicts = 0
        """Changes of the two above, counted."""
        self.sentence = ""
        """The session so far in one sentence; empty: neither leader nor nominal yet."""
        self.forecast: Forecast | None = None
        """The leader's newest forecast."""
        self.answered: Answered | None = None
        """The newest what-if question."""
        self.forecast_changes = 0
        """Changes of the two above, counted."""
        self.drive: Drive | None = None
        self.events = EventLog(EVENTS)
        self.roster = Roster()
        self.image: NDArray[np.float32] | None = None
        """Newest thermal image with values, °C, first row on top; NaN where a pixel has no value."""
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
        """The fault that holds the output at zero; empty: no fault."""
        return self._fault

    @property
    def ahead(self) -> Forecast | None:
        """The newest forecast; None if it starts at a sample that this session has not reached."""
        last, forecast = self.plant.last, self.forecast
        return None if forecast is None or last is None or forecast.sample > last else forecast

    @property
    def leader(self) -> str:
        """Name of the twin with the best forecasts; empty: none yet."""
        if self.forecast is not None:
            return self.forecast.candidate
        return "" if self.verdict is None else self.verdict.leader or ""

    def describe(self, described: Description) -> None:
        """Take the names and units of the plant and its signals."""
        with self.lock:
            self.described = described

    def push_sample(self, sample: Sample, now: float) -> None:
        """Take a sample received at `now` (s)."""
        with self.lock:
            previous = self._previous
            self.roster.begin(now)
            if previous is not None and sample.index <= previous.index:
                self._begin(previous.index, sample.index)
            elif previous is not None:
                self._note_interval(sample, previous)
            self.plant.push(sample.index, (sample.reference, sample.output, sample.input))
            self._previous, self.received_at = sample, now

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
                self._log_event(event, _mark_of(event, verdict))
            self.verdict = verdict
            self.verdicts += 1
            self._stretch(verdict)

    def push_forecast(self, forecast: Forecast) -> None:
        """Take a forecast of the leader."""
        with self.lock:
            self.forecast = forecast
            self.forecast_changes += 1

    def answer(self, answered: Answered) -> None:
        """Take a what-if question and its answer."""
        with self.lock:
            self.answered = answered
            self.forecast_changes += 1

    def push_drive(self, drive: Drive) -> None:
        """Take a report of the node that drives the plant."""
        with self.lock:
            self.drive = drive
            if drive.fault == self._fault:
                return
            self._fault = drive.fault
            if drive.fault:
                kind, _, why = drive.fault.partition(": ")
                title = f"output held at zero: {kind.replace('_', ' ')}"
                self._log(Lane.FAULT, Mark.BAD, title, why)
            else:
                self._log(Lane.FAULT, Mark.GOOD, "fault cleared", "the output may be driven")

    def push_health(self, name: str, level: int, message: str, values: Mapping[str, str], now: float) -> None:
        """Take a report from /diagnostics: name, level of REP 107, message and values."""
        with self.lock:
            change, plain = self.roster.push(name, level, message, values, now), name.removesuffix(": health")
            if change == "error":
                self._log(Lane.NODES, Mark.BAD, f"{plain} reports an error", message)
            elif change == "recovered":
                self._log(Lane.NODES, Mark.GOOD, f"{plain} has recovered", message)

    def push_image(self, image: NDArray[np.float32]) -> None:
        """Take a thermal image in °C, shape (rows, columns); one without any value is ignored."""
        if not np.isfinite(image).any():
            return
        with self.lock:
            self.image = image
            self.images += 1

    def notify(self, done: bool, text: str) -> None:
        """Show the result of a request made on the page."""
        with self.lock:
            self.notice = Notice(done, text)

    def _begin(self, ended: int, first: int) -> None:
        """Start a new session: drop what belongs to the previous one, except its events."""
        duration = (ended + 1) * self.period
        self.session += 1
        self.roster.ended = None
        self.plant.clear()
        if self.twin.last is not None and self.twin.last > first:
            self.twin.clear()
        self.verdict, self.verdicts, self.sentence = None, self.verdicts + 1, ""
        self.forecast, self.answered, self.forecast_changes = None, None, self.forecast_changes + 1
        self.trust.clear()
        self._intervals.clear()
        self._log(Lane.NODES, Mark.NOTE, "a new session began", f"the previous one lasted {duration:g} s")

    def _note_interval(self, sample: Sample, previous: Sample) -> None:
        interval = (sample.stamp - previous.stamp) / 1e9 / (sample.index - previous.index)
        if interval > 0:
            self._intervals.append(interval)
            self.period = float(f"{median(self._intervals):.2g}")

    def _stretch(self, verdict: Verdict) -> None:
        """Extend `trust` like `level_stretches`: a verdict's level covers the samples since the last one."""
        begin = self.trust[-1].last + 1 if self.trust else max(0, min(verdict.first, verdict.sample))
        if self.trust and self.trust[-1].level is verdict.level:
            begin = self.trust.pop().first
        self.trust.append(Stretch(begin, max(verdict.sample, begin), verdict.level))

    def _log_event(self, event: SessionEvent, mark: Mark) -> None:
        lane = _LANES[event.kind]
        self.events.add(Event(self.session, event.sample, lane, mark, event.title, event.why))

    def _log(self, lane: Lane, mark: Mark, title: str, text: str) -> None:
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


def _mark_of(event: SessionEvent, verdict: Verdict) -> Mark:
    return _MARKS.get(event.kind) or _LEVEL_MARKS[verdict.level]
