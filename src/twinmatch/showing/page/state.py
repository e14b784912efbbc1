"""Everything the page shows, in bounded memory; depends on neither ROS nor Bokeh."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import replace
from statistics import median
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing import Statements, Verdict, fault_of_drive, statements_of
from twinmatch.description import UNDESCRIBED, Description, nth
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import Forecast
from twinmatch.health import EstimatedReading
from twinmatch.offline.summary import Tally, conclude
from twinmatch.safety import LawReport, TrialPhase
from twinmatch.showing.experiments import report_words
from twinmatch.showing.page.goal import GoalAnswer
from twinmatch.showing.page.health import NodeReports
from twinmatch.showing.summary import sentence
from twinmatch.showing.verdicts import (
    Event,
    EventKind,
    Mark,
    events_since,
)
from twinmatch.signals import FloatArray, OperatingPoint, Sample, point_values
from twinmatch.twin import TwinSettings, filled_stretches
from twinmatch.twin.experiment import ExperimentPhase, ExperimentReport

LOOP: Final = ("reference", "output", "input")
"""Columns of the plant's first loop; those of further loops are numbered (`nth`)."""
CAPACITY = 36_000
"""Samples kept: an hour at 10 Hz, ten hours at 1 Hz."""
EVENTS = 400
INTERVALS = 31
"""The sampling period is the median of so many intervals."""


class TwinRow(NamedTuple):
    """Both twins at one sample; residuals are measured minus twin, RMS over the newest samples."""

    closed_output: OperatingPoint
    """Of the closed-loop twin, driven by the set-point. Like all values of a row, it has one for each
    signal."""
    closed_input: OperatingPoint
    driven_output: OperatingPoint
    """Of the twin driven by the plant's input."""
    closed_residual_y: OperatingPoint
    closed_residual_u: OperatingPoint
    driven_residual_y: OperatingPoint
    closed_rms_y: OperatingPoint
    closed_rms_u: OperatingPoint
    driven_rms_y: OperatingPoint


class DriveReport(NamedTuple):
    """The last report of the node that drives the plant."""

    input: OperatingPoint
    """Applied value of each input, in its unit; NaN: not known."""
    current: float
    """A; NaN: not measured."""
    fault: str
    """Why the output is held at zero, or limited; empty: no fault."""
    stamp: int | None = None
    """When it was made, ns by the clock of the samples' stamps; None: not known."""


ESTIMATE_SHOWN: Final = 5
"""Samples for which an estimate is shown after the one that it is of."""


class WhatIfAnswer(NamedTuple):
    """A what-if question and its answer."""

    question: str
    lines: tuple[str, ...]
    """The answer in words, or why there is no forecast."""
    forecast: Forecast | None = None


class Notice(NamedTuple):
    """The result of the last request made on the page."""

    done: bool
    text: str


class RollingTable:
    """A table that forgets its oldest rows; each row belongs to one sample of the session.

    Rows are counted from 0 since the last `clear`, so that a reader can ask for the rows after those it has.
    Where samples are missing, a row of NaN breaks the drawn line.
    """

    def __init__(self, columns: Sequence[str], capacity: int) -> None:
        """Allocate `capacity` rows of these columns."""
        self.columns = ("index", *columns)
        self.capacity = capacity
        self.count = 0
        """Rows since the last `clear`, including those dropped."""
        self.epoch = 0
        """How often the table was cleared."""
        self.last: int | None = None
        """Index of the newest sample."""
        self._rows = np.full((capacity, len(self.columns)), np.nan)

    def push(self, index: int, values: Sequence[float]) -> None:
        """Append the row of a sample."""
        if self.last is not None and index > self.last + 1:
            self._append(self.last + 1, [np.nan] * len(values))
        self._append(index, values)
        self.last = index

    def clear(self) -> None:
        """Drop all rows."""
        self.count = 0
        self.epoch += 1
        self.last = None

    def newest(self) -> dict[str, float] | None:
        """The newest row by column name; None while the table is empty."""
        if self.count == 0:
            return None
        row = self._rows[(self.count - 1) % self.capacity]
        return dict(zip(self.columns, row.tolist(), strict=True))

    def since(self, row: int, stride: int = 1) -> tuple[dict[str, FloatArray], int]:
        """The rows after the first `row` rows, and the row number to pass next time with the same stride.

        Only full groups of `stride` rows, which are drawn as one, are returned: see `envelope`.
        """
        oldest = -(-max(0, self.count - self.capacity) // stride) * stride
        first = max(row, oldest)
        after = max(first, self.count // stride * stride)
        rows = self._rows[np.arange(first, after) % self.capacity]
        drawn = envelope(rows, stride)
        return {name: drawn[:, k].copy() for k, name in enumerate(self.columns)}, after

    def _append(self, index: int, values: Sequence[float]) -> None:
        self._rows[self.count % self.capacity] = (index, *values)
        self.count += 1


def envelope(rows: FloatArray, stride: int) -> FloatArray:
    """Every `stride` rows as two: minimum and maximum of each column, in the order in which they occurred.

    A spike of one sample so keeps its height, however many samples share a pixel. The rows, shape
    (N, columns), are whole groups; a NaN makes both rows of its group NaN.
    """
    if stride == 1 or not rows.size:
        return rows
    groups = rows.reshape(-1, stride, rows.shape[1])
    low = np.min(groups, axis=1)
    high = np.max(groups, axis=1)
    rising = np.argmin(groups, axis=1) <= np.argmax(groups, axis=1)
    drawn = np.empty((2 * len(groups), rows.shape[1]))
    drawn[0::2] = np.where(rising, low, high)
    drawn[1::2] = np.where(rising, high, low)
    return drawn


class DashboardState:
    """Filled by the node, read by the pages; hold `lock` around several reads.

    A sample whose index is not above the previous one starts a new session: the graph was restarted, or
    another recording is played.
    """

    def __init__(
        self, capacity: int = CAPACITY, described: Description = UNDESCRIBED
    ) -> None:
        """Start empty; `capacity` samples are kept."""
        self.lock = threading.RLock()
        self._capacity = capacity
        self.describe(described)
        self.estimates: dict[str, EstimatedReading] = {}
        """The newest of each sensor that was not believed, by its name in the plant file."""
        self.session = 1
        """Counted from 1."""
        self.period = 1.0
        """Sampling period, s; computed from the stamps."""
        self.received_at: float | None = None
        """When the newest sample was received, in seconds of the receiver's clock."""
        self.verdict: Verdict | None = None
        self.tally = Tally()
        """What the verdicts of this session come down to."""
        self.taught: list[Verdict] = []
        """The first verdict of this session with a nominal candidate, alone; empty before it."""
        self.fault_reason = ""
        """What was said of the plant's fault when it was named; empty without a fault."""
        self.verdicts = 0
        """How often the verdict has changed, over all sessions."""
        self.sentence = ""
        """The session so far in one sentence; empty: neither leader nor nominal yet."""
        self.forecast: Forecast | None = None
        """The leader's newest forecast."""
        self.what_if: WhatIfAnswer | None = None
        """The newest what-if question."""
        self.goal: GoalAnswer | None = None
        """The newest answer to when a level is reached; None: nothing is asked, or there is no twin."""
        self.forecast_changes = 0
        """How often the forecast or the what-if answer has changed, over all sessions."""
        self.drive: DriveReport | None = None
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self.event_count = 0
        """Events so far, including those dropped."""
        self.nodes = NodeReports()
        self.image: NDArray[np.float32] | None = None
        """Newest thermal image with values, °C, first row on top; NaN where a pixel has no value."""
        self.images = 0
        """Images so far."""
        self.notice: Notice | None = None
        self._intervals: deque[float] = deque(maxlen=INTERVALS)
        self._previous: Sample | None = None

    @property
    def sample(self) -> int | None:
        """Index of the newest sample."""
        return self.plant.last

    @property
    def fault(self) -> str:
        """The fault that holds the output at zero; empty: no fault."""
        return self.drive.fault if self.drive else ""

    @property
    def statements(self) -> Statements:
        """What is said now of trust and faults; of the plant's fault the sentence that named it: later ones
        are of other things, such as matches."""
        statements = statements_of(self.verdict, self.fault)
        fault = statements.plant_fault
        if fault is None or not self.fault_reason:
            return statements
        return statements._replace(plant_fault=fault._replace(reason=self.fault_reason))

    @property
    def current_forecast(self) -> Forecast | None:
        """The newest forecast; None if it starts at a sample that this session has not reached."""
        last = self.plant.last
        forecast = self.forecast
        return (
            None
            if forecast is None or last is None or forecast.sample > last
            else forecast
        )

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
            """Names and units of the plant and its signals."""
            loops = len(described.loops)
            if getattr(self, "_loops", 0) != loops:
                self._loops = loops
                capacity = self._capacity
                self.plant = RollingTable(_columns_of_loops(LOOP, loops), capacity)
                self.twin = RollingTable(
                    _columns_of_loops(TwinRow._fields, loops), capacity
                )

    @property
    def read_through(self) -> list[EstimatedReading]:
        """What the sensors that are not believed should read now."""
        newest = self.sample or 0
        return [
            estimate
            for estimate in self.estimates.values()
            if newest - estimate.sample <= ESTIMATE_SHOWN
        ]

    def push_sample(self, sample: Sample, now: float) -> None:
        """Take a sample received at `now` (s), once the plant it is of has been described."""
        with self.lock:
            if sample.shape[:3] != self.described.shape:
                return
            previous = self._previous
            self.nodes.begin(now)
            if previous is not None and not sample.continues(previous):
                self._begin(previous.index, sample.index)
            elif previous is not None:
                self._note_interval(sample, previous)
            begins_session = self.sample is None
            self.plant.push(
                sample.index,
                self._spread((sample.references, sample.outputs, sample.inputs)),
            )
            self._previous = sample
            self.received_at = now
            if begins_session:
                self._date(sample)

    def push_twin(self, index: int, row: TwinRow) -> None:
        """Take the twins' state at a sample."""
        with self.lock:
            if self.twin.last is not None and index <= self.twin.last:
                self.twin.clear()
            self.twin.push(index, self._spread(map(point_values, row)))

    def _spread(self, kinds: Iterable[Sequence[float]]) -> list[float]:
        """One value per loop of each kind: a kind with fewer values than there are loops repeats its last
        one."""
        return [
            values[min(k, len(values) - 1)]
            for values in kinds
            for k in range(self._loops)
        ]

    def push_estimate(self, estimate: EstimatedReading) -> None:
        """Take what a sensor should read."""
        with self.lock:
            self.estimates[estimate.signal] = estimate

    def push_experiment(self, report: ExperimentReport) -> None:
        """Take what an experiment has come to."""
        mark = Mark.BAD if report.phase is ExperimentPhase.REFUSED else Mark.NOTE
        with self.lock:
            self._note(
                EventKind.NODE, mark, "experiment", report_words(report, self.described)
            )
            if report.phase is not ExperimentPhase.RUNNING:
                self.notice = Notice(
                    mark is Mark.NOTE, report_words(report, self.described)
                )

    def push_law(self, report: LawReport) -> None:
        """Take what has become of a law on trial."""
        mark = (
            Mark.BAD
            if report.phase in {TrialPhase.REFUSED, TrialPhase.BACK}
            else Mark.NOTE
        )
        with self.lock:
            self._note(
                EventKind.NODE,
                mark,
                f"law on trial: {report.phase.value}",
                report.reason,
            )

    def push_verdict(self, verdict: Verdict) -> None:
        """Take a verdict."""
        with self.lock:
            for event in events_since(self.verdict, verdict):
                self._log(event)
            self.tally.push(verdict)
            if not self.taught and verdict.chosen is not None:
                self.taught.append(verdict)
            self.fault_reason = self._reason_of_fault(verdict)
            self.verdict = verdict
            self.verdicts += 1

    def _reason_of_fault(self, verdict: Verdict) -> str:
        """What is said of the fault of a verdict: the reason of the first one that named it.

        The reasons of those after it are of other things, such as matches.
        """
        fault = statements_of(verdict).plant_fault
        before = statements_of(self.verdict).plant_fault
        if fault is None:
            return ""
        if before is not None and before.called == fault.called:
            return self.fault_reason
        return fault.reason

    def push_plant_report(self, message: str) -> None:
        """Take what the discriminator reports of the plant: a page that was opened late has not seen the
        verdict that named the fault."""
        named, _, reason = message.partition(": ")
        with self.lock:
            fault = statements_of(self.verdict).plant_fault
            if fault is not None and fault.called == named:
                self.fault_reason = reason

    def push_forecast(self, forecast: Forecast) -> None:
        """Take a forecast of the leader."""
        with self.lock:
            self.forecast = forecast
            self.forecast_changes += 1

    def question(
        self, level: float, hold: float | None
    ) -> tuple[str, list[float], list[float]]:
        """A what-if question in words, with its times (s) and set-points: at a level, and back after a time
        (s)."""
        question = f"set-point {level:g} {self.described.reference.unit}"
        if hold is None:
            return question, [0.0], [level]
        newest_level = (self.plant.newest() or {"reference": level})["reference"]
        return f"{question} for {hold:g} s", [0.0, hold], [level, newest_level]

    def answer(self, answer: WhatIfAnswer) -> None:
        """Take a what-if question and its answer."""
        with self.lock:
            self.what_if = answer
            self.forecast_changes += 1

    def push_drive(self, drive: DriveReport) -> None:
        """Take a report of the node that drives the plant."""
        with self.lock:
            before = self.fault
            self.drive = drive
            if drive.fault == before:
                return
            fault = fault_of_drive(drive.fault)
            if fault is not None:
                self._note(
                    EventKind.FAULT, Mark.BAD, fault.called, fault.reason, drive.stamp
                )
            else:
                why = "the output may be driven"
                self._note(
                    EventKind.FAULT, Mark.GOOD, "fault cleared", why, drive.stamp
                )

    def push_health(
        self, name: str, level: int, message: str, values: Mapping[str, str], now: float
    ) -> None:
        """Take a report from /diagnostics: name, level of REP 107, message and values."""
        with self.lock:
            change = self.nodes.push(name, level, message, values, now)
            plain = name.removesuffix(": health")
            if change == "error":
                self._note(
                    EventKind.NODE, Mark.BAD, f"{plain} reports an error", message
                )
            elif change == "recovered":
                self._note(EventKind.NODE, Mark.GOOD, f"{plain} has recovered", message)

    def push_goal(self, answer: GoalAnswer | None) -> None:
        """Take when a level is reached."""
        with self.lock:
            self.goal = answer
            self.forecast_changes += 1

    def push_image(self, image: NDArray[np.float32]) -> None:
        """Take a thermal image in °C, shape (rows, columns); one without any value is ignored."""
        if not np.isfinite(image).any():
            return
        with self.lock:
            self.image = image
            self.images += 1

    def notify(self, text: str, *, done: bool) -> None:
        """Show the result of a request made on the page: whether it was done, and in words."""
        with self.lock:
            self.notice = Notice(done, text)

    def _begin(self, ended: int, first: int) -> None:
        """Start a new session: drop what belongs to the previous one, except its events."""
        duration = (ended + 1) * self.period
        self.session += 1
        self.nodes.ended = None
        self.plant.clear()
        if self.twin.last is not None and self.twin.last > first:
            self.twin.clear()
        self.verdict = None
        self.fault_reason = ""
        self.verdicts = self.verdicts + 1
        self.sentence = ""
        self.forecast = None
        self.what_if = None
        self.goal = None
        self.forecast_changes = self.forecast_changes + 1
        self.tally = Tally()
        self.taught = []
        self.estimates = {}
        self._intervals.clear()
        why = f"the previous one lasted {duration:g} s"
        self._note(EventKind.NODE, Mark.NOTE, "a new session began", why)

    def _note_interval(self, sample: Sample, previous: Sample) -> None:
        """Compute the sampling period from one more interval between samples."""
        interval = (
            (sample.stamp - previous.stamp) / 1e9 / (sample.index - previous.index)
        )
        if interval > 0:
            self._intervals.append(interval)
            self.period = float(f"{median(self._intervals):.2g}")

    def _note(
        self,
        kind: EventKind,
        mark: Mark,
        title: str,
        why: str,
        stamp: int | None = None,
    ) -> None:
        """Log an event of this moment, or of its stamp (ns)."""
        event = Event(self.sample, kind, title, why, mark, stamp=stamp)
        newest = self._previous
        if self.sample is None or newest is None:
            self._log(event)  # the first sample of the session dates it
        else:
            self._log(event.dated(newest))

    def _date(self, first: Sample) -> None:
        """Give the events that were received before the session's first sample its date."""
        dated = (
            event.dated(first) if event.sample is None else event
            for event in self.events
        )
        self.events = deque(dated, maxlen=EVENTS)

    def _log(self, event: Event) -> None:
        self.events.append(replace(event, session=self.session))
        self.event_count += 1


def _columns_of_loops(names: Iterable[str], loops: int) -> list[str]:
    """Every name once for each of `loops` loops."""
    return [nth(name, k) for name in names for k in range(loops)]


def update_sentence(state: DashboardState, settings: TwinSettings) -> None:
    """Summarise the samples that are kept, with the newest verdict, into `state.sentence`.

    Takes a few milliseconds; call it for a new verdict, not for every sample. `settings` are the twin's.
    """
    with state.lock:
        verdict = state.verdict
        period = state.period
        tally = copy(state.tally)
        taught = list(state.taught)
        columns, _ = state.plant.since(0)
        shape = state.described.shape
    samples = _samples_in(columns, shape)
    summed_up = ""
    if samples and verdict is not None and (verdict.leader or verdict.nominal):
        with suppress(TwinmatchError):  # so few samples that there is no window
            law = settings.law and settings.law.at_period(period)
            settings_at_period = replace(settings, period=period, law=law)
            without_gaps = filled_stretches(samples, settings_at_period, taught)
            longest = max(without_gaps, key=len)
            summary = conclude(
                tally, lambda: (longest, len(without_gaps)), law, period=period
            )
            summed_up = sentence(summary)
    with state.lock:
        if state.verdict is verdict:
            state.sentence = summed_up


def _samples_in(
    columns: Mapping[str, NDArray[Any]], shape: tuple[int, int, int]
) -> list[Sample]:
    """The samples in columns of set-points, outputs and inputs, so many of each, without the gaps (NaN)."""
    rows_of_kinds = []
    for name, size in zip(LOOP, shape, strict=True):
        signals = [columns[nth(name, k)].tolist() for k in range(size)]
        rows_of_kinds.append(zip(*signals, strict=True))
    samples = []
    for index, references, outputs, inputs in zip(
        columns["index"].tolist(), *rows_of_kinds, strict=True
    ):
        if not all(map(math.isnan, (*references, *outputs, *inputs))):
            samples.append(Sample(int(index), int(index), references, outputs, inputs))
    return samples
