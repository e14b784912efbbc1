"""Scores of forecasts once their samples are known, their summary in report cards, and the result."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import Band, Forecast
from twinmatch.offline.summary import SessionSummary
from twinmatch.record import finite
from twinmatch.signals import BoolArray, FloatArray, Window, rms

PEERS: Final = {"persistence": "persistence", "arx": "ARX"}
"""Names in tables and figures of the forecasts that need no twin: those of `BASELINES`."""


class BacktestError(TwinmatchError):
    """A backtest that cannot be made: samples that do not fit a forecast, or an unknown peer."""


_ROUNDING = 1e-9
"""Relative tolerance within which a horizon counts as a whole number of samples."""


@dataclass(frozen=True, slots=True)
class SignalMarks:
    """Scores of one signal over the path up to a horizon, in units of its noise."""

    rms: float
    """Root of the mean squared error of the mean."""
    end: float
    """Error at the horizon itself: measured minus forecast mean."""
    coverage: float
    """Share of the samples within the band, edges included; NaN, as width and score, without a band."""
    width: float
    """Mean width of the band."""
    score: float
    """Mean interval score of the band; smaller is better."""


@dataclass(frozen=True, slots=True)
class Marks:
    """Scores of a forecast up to a horizon."""

    output: SignalMarks
    input: SignalMarks | None
    """None if the input was given."""

    @property
    def error(self) -> float:
        """Both signals together: root of the mean of their mean squared errors; or only the output's."""
        signals = [self.output] if self.input is None else [self.output, self.input]
        return float(rms(np.array([signal.rms for signal in signals])))

    @property
    def score(self) -> float:
        """Both signals together: mean of their interval scores; or only the output's."""
        if self.input is None:
            return self.output.score
        return (self.output.score + self.input.score) / 2.0


def interval_score(
    low: FloatArray, high: FloatArray, came: FloatArray, confidence: float
) -> FloatArray:
    """Interval score of known values; its expectation is least for the true quantiles.

    S = (high − low) + 2/α (low − x)⁺ + 2/α (x − high)⁺ with α = 1 − confidence: Gneiting and Raftery,
    *Strictly Proper Scoring Rules, Prediction, and Estimation*, JASA 102 (2007), eq. 43.

    The ends, the values and the scores have one shape and unit; `confidence` is the share of the values that
    the intervals are to hold.

    Raises:
        BacktestError: the confidence is not between 0 and 1.
    """
    if not 0.0 < confidence < 1.0:
        raise BacktestError(
            f"interval score: the confidence is {confidence}; it must lie between 0 and 1"
        )
    outside = np.maximum(low - came, 0.0) + np.maximum(came - high, 0.0)
    return np.asarray(high - low + 2.0 / (1.0 - confidence) * outside, dtype=np.float64)


def samples_within(horizon: float, period: float) -> int:
    """Number of samples in a horizon, for horizon and period in seconds.

    Raises:
        BacktestError: the horizon is shorter than one sample.
    """
    count = math.floor(horizon / period * (1.0 + _ROUNDING))
    if count < 1:
        msg = f"backtest: a horizon of {horizon:g} s is shorter than one sample of {period:g} s; give more"
        raise BacktestError(msg)
    return count


def marks(
    forecast: Forecast, came: Window, horizons: Sequence[float], plant: type[Plant]
) -> list[Marks]:
    """Score one forecast by the actual samples, up to each horizon; see `marks_of_each`."""
    (of_forecast,) = marks_of_each([forecast], came, horizons, plant)
    return of_forecast


def marks_of_each(
    forecasts: Sequence[Forecast],
    came: Window,
    horizons: Sequence[float],
    plant: type[Plant],
) -> list[list[Marks]]:
    """Score forecasts made at one sample by the actual samples: the marks of each, up to each horizon.

    Args:
        forecasts: the forecasts, all of them for set-points or all for given inputs.
        came: samples beginning with the one after `forecast.sample`; at least as many as a horizon has.
        horizons: lengths of the paths that are scored, s.
        plant: declares the noise of output and input.

    Raises:
        BacktestError: the samples are not those of a forecast, or one of both is too short.
    """
    counts = [samples_within(horizon, came.period) for horizon in horizons]
    for forecast in forecasts:
        _require_comparable(forecast, came, horizons, counts)
    outputs = _marks_of_signal(
        [forecast.output for forecast in forecasts],
        came.output,
        plant.output.noise,
        forecasts[0].confidence,
        counts,
        is_received=came.seen,
    )
    if not forecasts[0].closed:
        return [[Marks(output, None) for output in of_output] for of_output in outputs]
    inputs = _marks_of_signal(
        [forecast.input for forecast in forecasts],
        came.input,
        plant.drive.noise,
        forecasts[0].confidence,
        counts,
        is_received=came.seen,
    )
    return [
        list(map(Marks, of_output, of_input))
        for of_output, of_input in zip(outputs, inputs, strict=True)
    ]


def _require_comparable(
    forecast: Forecast, came: Window, horizons: Sequence[float], counts: Sequence[int]
) -> None:
    """Raise unless these are the samples of the forecast, as many as each horizon has."""
    if came.first != forecast.sample + 1:
        msg = f"backtest: a forecast made at sample {forecast.sample} cannot be scored from {came.first} on"
        raise BacktestError(msg)
    comparable = min(len(came), forecast.output.mean.size, forecast.input.mean.size)
    for horizon, count in zip(horizons, counts, strict=True):
        if comparable < count:
            needed = f"a horizon of {horizon:g} s needs {count} samples"
            msg = f"backtest: {needed}; only {comparable} can be compared"
            raise BacktestError(msg)


def _marks_of_signal(
    bands: Sequence[Band],
    came: FloatArray,
    noise: float,
    confidence: float,
    counts: Sequence[int],
    *,
    is_received: BoolArray | None,
) -> list[list[SignalMarks]]:
    """The marks of one signal in each of several forecasts, up to each horizon, without samples that were not
    received.

    `counts` are the horizons in samples; `came` are the actual values, in the unit of `noise`.
    """
    longest = max(counts, default=0)
    x = came[:longest] / noise
    mean = np.array([band.mean[:longest] for band in bands]) / noise
    low = np.array([band.low[:longest] for band in bands]) / noise
    high = np.array([band.high[:longest] for band in bands]) / noise
    error = x - mean
    inside = np.where(np.isnan(high - low), np.nan, (low <= x) & (x <= high))
    scores = interval_score(low, high, x, confidence)
    inside_width_score = np.array([inside, high - low, scores])
    marks_by_forecast: list[list[SignalMarks]] = [[] for _ in bands]
    for count in counts:
        errors_of_path = error[:, :count]
        averaged = inside_width_score[:, :, :count]
        if is_received is not None:
            received = np.flatnonzero(is_received[:count])
            errors_of_path = errors_of_path.take(received, axis=-1)
            averaged = averaged.take(received, axis=-1)
        figures = np.array([rms(errors_of_path), error[:, count - 1]])
        columns = np.concatenate([figures, averaged.mean(axis=-1)]).T.tolist()
        for of_forecast, column in zip(marks_by_forecast, columns, strict=True):
            of_forecast.append(SignalMarks(*column))
    return marks_by_forecast


HINDSIGHT = "best in hindsight"
"""Name for the best candidate of each forecast, known only in hindsight."""


@dataclass(frozen=True, slots=True)
class Marked:
    """One forecast of one forecaster, judged at one horizon."""

    session: str
    sample: int
    """Index of the newest sample it was made from."""
    horizon: float
    """Horizon, s."""
    who: str
    """Name of the forecaster."""
    marks: Marks
    candidate: str = ""
    """Name of the candidate; empty for a peer."""

    @property
    def place(self) -> tuple[str, int, float]:
        """Session, sample and horizon; equal for comparable forecasts."""
        return self.session, self.sample, self.horizon


@dataclass(frozen=True, slots=True)
class Card:
    """One forecaster at one horizon, over many forecasts; errors, widths, scores in units of the noise."""

    who: str
    horizon: float
    """Horizon, s."""
    count: int
    """Number of scored forecasts."""
    median: float
    """Median of the errors over the path, both signals together."""
    nine_in_ten: float
    """Value below which nine in ten of these errors are."""
    ratio: float
    """Mean of the errors, each divided by that of the best in hindsight; NaN without it."""
    end_output: float
    """Median size of the output's error at the horizon itself."""
    end_input: float
    """NaN where inputs were given, as for coverage and width."""
    coverage_output: float
    """Share of all output samples within the band."""
    coverage_input: float
    width_output: float
    """Median over the forecasts of the band's mean width."""
    width_input: float
    score: float
    """Mean interval score, both signals together; smaller is better."""


def best_in_hindsight(marked: Iterable[Marked]) -> list[Marked]:
    """The forecast with the least error for every origin and horizon, under the name `HINDSIGHT`; of equal
    ones the first."""
    best: dict[tuple[str, int, float], Marked] = {}
    for mark in marked:
        if mark.place not in best or mark.marks.error < best[mark.place].marks.error:
            best[mark.place] = mark
    return [replace(mark, who=HINDSIGHT) for mark in best.values()]


def common(marked: Sequence[Marked]) -> list[Marked]:
    """Only the forecasts at places where every forecaster made one, so that all are compared alike."""
    all_forecasters = {mark.who for mark in marked}
    forecasters_at: dict[tuple[str, int, float], set[str]] = {}
    for mark in marked:
        forecasters_at.setdefault(mark.place, set()).add(mark.who)
    return [mark for mark in marked if forecasters_at[mark.place] == all_forecasters]


def cards(marked: Sequence[Marked]) -> list[Card]:
    """The report cards: forecasters in the order in which they first appear, horizons from near to far.

    Marks of several sessions give the cards over all: every forecast has the same weight.
    """
    best = {mark.place: mark.marks.error for mark in marked if mark.who == HINDSIGHT}
    groups: dict[str, dict[float, list[Marked]]] = {}
    for mark in marked:
        groups.setdefault(mark.who, {}).setdefault(mark.horizon, []).append(mark)
    return [
        _card(forecaster, horizon, marks_of_card, best)
        for forecaster, by_horizon in groups.items()
        for horizon, marks_of_card in sorted(by_horizon.items())
    ]


def _card(
    forecaster: str,
    horizon: float,
    marked: Sequence[Marked],
    best: dict[tuple[str, int, float], float],
) -> Card:
    """The card of one forecaster at one horizon; `best` are the least errors at each origin."""
    errors = np.array([mark.marks.error for mark in marked])
    least = np.array([best.get(mark.place, np.nan) for mark in marked])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(errors == least, 1.0, errors / least)
    signals = _scored_signals([mark.marks for mark in marked])
    ends = _pair(np.median(np.abs(_figures("end", signals)), axis=0))
    coverages = _pair(np.mean(_figures("coverage", signals), axis=0))
    widths = _pair(np.median(_figures("width", signals), axis=0))
    return Card(
        who=forecaster,
        horizon=horizon,
        count=len(marked),
        median=float(np.median(errors)),
        nine_in_ten=float(np.quantile(errors, 0.9)),
        ratio=float(np.mean(ratios)),
        end_output=float(ends[0]),
        end_input=float(ends[1]),
        coverage_output=float(coverages[0]),
        coverage_input=float(coverages[1]),
        width_output=float(widths[0]),
        width_input=float(widths[1]),
        score=float(np.mean([mark.marks.score for mark in marked])),
    )


def _scored_signals(marks_of_forecasts: Sequence[Marks]) -> list[list[SignalMarks]]:
    """Of each forecast the marks of output and input; of the output only if the input was given to some."""
    with_inputs = []
    for forecast in marks_of_forecasts:
        if forecast.input is None:
            return [[forecast.output] for forecast in marks_of_forecasts]
        with_inputs.append([forecast.output, forecast.input])
    return with_inputs


def _figures(name: str, signals: Sequence[Sequence[SignalMarks]]) -> FloatArray:
    """One figure of the signals of every forecast, shape (N, 1 or 2)."""
    return np.array(
        [[getattr(signal, name) for signal in of_forecast] for of_forecast in signals]
    )


def _pair(figures: FloatArray) -> tuple[float, float]:
    """Figures of output and input; NaN for a given input."""
    of_output, of_input = [*figures.tolist(), float("nan")][:2]
    return of_output, of_input


LEADER: Final = "leader"
NOMINAL: Final = "nominal"
NEWEST: Final = "newest"
CONSTANT: Final = "nominal, constant band"
"""The nominal twin's forecast with a band of one width, from its residuals so far."""
TWINS: Final = (LEADER, NOMINAL, NEWEST, CONSTANT, HINDSIGHT)
"""Forecasters with a twin; all others are peers."""


@dataclass(frozen=True, eq=False)
class Backtest:
    """Scored forecasts of one session, or of several together."""

    name: str
    plant: type[Plant]
    period: float
    """Sample time, s."""
    horizons: tuple[float, ...]
    """Horizons, s, from near to far."""
    confidence: float
    """Share of the samples that every band is to hold."""
    marked: tuple[Marked, ...]
    """Every forecast at every horizon, at the origins at which all forecasters could make one."""
    came: tuple[Window, ...] = ()
    """The samples, in stretches without gaps."""
    pictured: str = ""
    """Name of the session with these samples; empty: this one's."""
    shown: tuple[Forecast, ...] = ()
    """Consecutive forecasts of the leader, for a figure."""
    notes: tuple[str, ...] = ()
    """Sentences on what was left out and why."""
    last: Verdict | None = None
    """The session's last verdict; None without one, and for several sessions together."""
    summary: SessionSummary | None = None
    """What the twin's verdicts come down to, faults included; None for several sessions together."""

    @cached_property
    def cards(self) -> list[Card]:
        """The report cards."""
        return cards(self.marked)

    @property
    def at_horizons(self) -> dict[float, list[Card]]:
        """The cards of each horizon with scored forecasts, from near to far."""
        by_horizon: dict[float, list[Card]] = {}
        for horizon in self.horizons:
            cards_of_horizon = [card for card in self.cards if card.horizon == horizon]
            if cards_of_horizon:
                by_horizon[horizon] = cards_of_horizon
        return by_horizon

    @property
    def driven(self) -> bool:
        """Whether the loop is not known and inputs were given; inputs are then not scored."""
        return any(mark.marks.input is None for mark in self.marked)

    @property
    def origins(self) -> int:
        """Number of samples at which forecasts were made and scored at some horizon."""
        return len({(mark.session, mark.sample) for mark in self.marked})


def over_all(tests: Sequence[Backtest]) -> Backtest:
    """Combine several sessions of one plant; every forecast has the same weight."""
    first = tests[0]
    names = [test.name for test in tests]
    marked: list[Marked] = []
    for number, test in enumerate(tests, 1):
        distinct_name = (
            f"{test.name} ({number})" if names.count(test.name) > 1 else test.name
        )
        marked += [replace(mark, session=distinct_name) for mark in test.marked]
    return replace(
        first,
        name=f"all {len(tests)} sessions",
        marked=tuple(marked),
        pictured=first.name,
        last=None,
        summary=None,
        notes=tuple(f"{test.name}: {note}" for test in tests for note in test.notes),
    )


def document(backtest: Backtest, *, forecasts: bool = True) -> dict[str, Any]:
    """Report cards and, optionally, the marks of every forecast; NaN becomes None.

    Errors, ends, widths and scores are in units of the noise in the same document.
    """
    plant = backtest.plant
    tree: dict[str, Any] = {
        "name": backtest.name,
        "plant": plant.name,
        "confidence": backtest.confidence,
        "horizons": list(backtest.horizons),
        "noise": {"output": plant.output.noise, "input": plant.drive.noise},
        "origins": backtest.origins,
        "cards": [finite(asdict(card)) for card in backtest.cards],
        "notes": list(backtest.notes),
    }
    if forecasts:
        tree["forecasts"] = [
            {
                "session": mark.session,
                "sample": mark.sample,
                "horizon": mark.horizon,
                "who": mark.who,
                "candidate": mark.candidate,
                "error": mark.marks.error,
                **finite(asdict(mark.marks)),
            }
            for mark in backtest.marked
        ]
    return tree
