"""Resampling of rows with irregular times to a constant period.

A twin needs a constant sampling period. Loggers rarely keep one: a loop that sleeps between its cycles has
steps of 2.96 and 3.04 s, and rows are lost now and then. The value between two rows depends on the kind of
column:

    reading   a sensor's value, which changes continuously: linear interpolation between its neighbours
    held      an input that is held from its row to the next: its mean over the following period, so that the
              twin gets the same total input as the plant
    set       a set-point or a mode, for which a mean makes no sense: the value of the nearest row

Readings are not smoothed. If rows are much closer together than the period, most of them are not used.

A long gap is refused, or the recording is split there: the clock of each stretch starts at its first row,
because a logger may be restarted at any time, and the sample indices skip the missing periods, so that no
window spans the gap. So is a place where the logger's clock was set back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.sessions.files import RecordingError
from twinmatch.sessions.reader import ROUNDED, rounded_period
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

Kind = Literal["reading", "held", "set"]
"""Kind of a column, which determines its values between rows."""

Gaps = Literal["refuse", "split"]
"""Treatment of a gap that is too long to interpolate."""


class StepRules(Rule):
    """What steps between rows mean, in usual steps: the usual step is their median."""

    bridged: float = 3.0
    """Longest step that is interpolated by default: up to two lost rows."""
    without_loss: float = 1.5
    """Longer steps contain lost rows."""
    jitter: float = 0.1
    """Largest deviation of a step between ticks."""
    crowded: float = 0.5
    """Shortest period that can be requested, so that most ticks have their own row."""
    fewest_of_a_pace: int = 5
    """More steps that are too long may be a second pace of the logger."""
    share_of_a_pace: float = 0.02
    """Share of the steps from which on they are."""
    most_of_a_pace: float = 0.9
    """Share of them that a second pace has; the rest are gaps."""
    fine: float = 400.0
    """A time constant of more rows than this makes windows too short for the plant, and fits slow."""
    per_lag: float = 50.0
    """Samples per time constant that are proposed instead."""
    back: float = 0.1
    """Largest share of the steps that lead back where a clock was set; more are rows out of order."""


_STEPS: Final = StepRules()
_ON_CLOCK: Final = 1e-3
"""A row this close to its tick, as a share of the period, is used unchanged."""
_FEWEST_ROUNDED: Final = 20
"""Fewest steps from which on times that mostly repeat are taken as rounded ones."""
_DIGITS: Final = 9
"""Significant digits of the period of a regular recording."""


@dataclass(frozen=True, eq=False)
class Resampled:
    """Columns on one clock."""

    time: FloatArray
    """Times of the samples, s, on the rows' time axis; equidistant within a stretch, which starts at its
    first row; shape (M,)."""
    index: NDArray[np.int64]
    """Indices of the samples, from 0; at least one is skipped where a gap splits the rows; shape (M,)."""
    columns: Mapping[str, FloatArray]
    """By name, each of shape (M,)."""
    period: float
    """Sampling period, s."""
    rows: int
    """Number of input rows."""
    steps: tuple[float, float, float]
    """Shortest, median and longest step between rows within the stretches, s."""
    jitter: float
    """Distance of the rows from the nearest tick, root mean square, s."""
    bridged: tuple[int, ...]
    """Rows (from 0) after which lost rows are bridged: the step is longer than 1.5 usual ones."""
    gaps: tuple[float, ...]
    """Lengths of the gaps at which the recording is split, s, in order; negative where time goes back."""

    @property
    def stretches(self) -> list[slice]:
        """The stretches of samples without a gap, in their order."""
        ends = [
            0,
            *(np.flatnonzero(np.diff(self.index) != 1) + 1).tolist(),
            self.index.size,
        ]
        return [slice(*pair) for pair in pairwise(ends)]

    @property
    def moved(self) -> bool:
        """Whether values were interpolated; otherwise they are those of the rows."""
        return self.jitter > 0 or bool(self.bridged)

    @property
    def sentence(self) -> str:
        """Description of the resampling."""
        if not self.moved:
            return f"{self.rows} rows, one every {self.period:g} s{self._splits}"
        short, usual, long = self.steps
        text = (
            f"{self.rows} rows, {short:.3g} to {long:.3g} s apart (median {usual:.3g} s), resampled to a "
            f"period of {self.period:g} s; jitter {self.jitter:.2g} s (RMS)"
        )
        if self.bridged:
            places = (
                "one place" if len(self.bridged) == 1 else f"{len(self.bridged)} places"
            )
            text += f"; rows are missing at {places}"
        return text + self._splits

    @property
    def _splits(self) -> str:
        if not self.gaps:
            return ""
        causes = []
        if lengths := [gap for gap in self.gaps if gap >= 0]:
            causes.append(f"gaps of {_list(lengths)} s")
        if steps_back := [gap for gap in self.gaps if gap < 0]:
            causes.append(f"steps back of {_list(steps_back)} s")
        return f"; split into {len(self.gaps) + 1} stretches by {' and '.join(causes)}"


def _list(steps: list[float]) -> str:
    """The sizes of the first three steps."""
    return ", ".join(f"{abs(step):.4g}" for step in steps[:3]) + (
        ", …" if len(steps) > 3 else ""
    )


def complete_rows(*columns: FloatArray) -> NDArray[np.intp]:
    """The rows (from 0) in which every column has a value."""
    return np.flatnonzero(np.all([np.isfinite(column) for column in columns], axis=0))


def repeated(rows: NDArray[np.intp], *columns: FloatArray) -> NDArray[np.intp]:
    """The rows that repeat the row before in every column: loggers write some rows twice."""
    is_repeated = np.all([np.diff(column[rows]) == 0.0 for column in columns], axis=0)
    return np.asarray(rows[1:][is_repeated])


def resample(
    time: ArrayLike,
    columns: Mapping[str, ArrayLike],
    kinds: Mapping[str, Kind],
    period: float | None = None,
    *,
    longest: float | None = None,
    gaps: Gaps = "refuse",
    place: str = "recording",
    row: Callable[[int], str] = lambda i: f"row {i + 1}",
) -> Resampled:
    """Resample columns to a constant period, starting at the first row. Regular rows are not changed.

    Args:
        time: time of each row, s, from any origin; shape (N,).
        columns: by name, each of shape (N,).
        kinds: kind of each column, by the same names.
        period: sampling period, s; by default the mean step without lost rows. For irregular rows it is
            rounded as far as half a percent allows, so that two recordings of one logger have the same.
        longest: longest step between rows that is interpolated, s; three usual ones if not given.
        gaps: treatment of longer steps, and of steps back.
        place: start of the error message, such as `recording monday.csv`.
        row: returns the place of the i-th row (from 0) in the file, such as `line 12`.

    Raises:
        RecordingError: fewer than two rows, values that are not finite, time that stands still, or goes back
            where that is refused or happens often, a step that is too long, a period that is too short for
            the rows, or a column without a kind.
    """
    stamps, values = _checked(time, columns, kinds, place, row)
    steps = np.diff(stamps)
    _refuse_standing(stamps, place, row, split=gaps == "split")
    usual = usual_step(steps)
    limit = bridged_up_to(stamps, longest)
    is_bridged = (steps > 0) & (steps <= limit)
    cuts = np.flatnonzero(~is_bridged)
    if cuts.size and gaps == "refuse":
        _refuse_gap(stamps, cuts, limit, place, row)
    bridged_steps = steps[is_bridged]
    stretches = np.split(stamps, cuts + 1)
    if period is None:
        period = _default_period(stretches, bridged_steps, usual)
    elif not (np.isfinite(period) and period >= _STEPS.crowded * usual):
        raise RecordingError(
            f"{place}: a period of {period:g} s does not fit rows {usual:g} s apart; give at least half of "
            "that"
        )
    pieces = []
    squares = 0.0
    rows_of_stretches = np.split(np.arange(stamps.size), cuts + 1)
    for times, rows in zip(stretches, rows_of_stretches, strict=True):
        of_stretch = {name: column[rows] for name, column in values.items()}
        piece = _resampled_stretch(times, of_stretch, kinds, period)
        pieces.append(piece)
        squares += piece.squares
    clocks = [piece.clock for piece in pieces]
    resampled = {}
    for name in values:
        resampled[name] = np.concatenate([piece.columns[name] for piece in pieces])
    is_lost = (steps > _STEPS.without_loss * usual) & is_bridged
    return Resampled(
        time=np.concatenate(clocks),
        index=_indices(clocks, period),
        columns=resampled,
        period=period,
        rows=stamps.size,
        steps=(float(bridged_steps.min()), usual, float(bridged_steps.max())),
        jitter=period * float(np.sqrt(squares / stamps.size)),
        bridged=tuple(np.flatnonzero(is_lost).tolist()),
        gaps=tuple(steps[cuts].tolist()),
    )


class _ResampledStretch(NamedTuple):
    """Rows between two gaps, at a constant period."""

    clock: FloatArray
    """Their times, s."""
    columns: dict[str, FloatArray]
    squares: float
    """Sum over the rows of the squares of their distances from the clock, in periods; 0 where they were on it."""


def _resampled_stretch(
    times: FloatArray,
    columns: Mapping[str, FloatArray],
    kinds: Mapping[str, Kind],
    period: float,
) -> _ResampledStretch:
    """Rows without a gap at a constant period; those that have it already are not changed."""
    clock, on_clock = _clock(times, period)
    if on_clock:
        return _ResampledStretch(clock, dict(columns), 0.0)
    ticks = (times - clock[0]) / period
    resampled = {
        name: _RESAMPLERS[kinds[name]](times, column, clock, period)
        for name, column in columns.items()
    }
    squares = float(np.sum(np.square(ticks - np.rint(ticks))))
    return _ResampledStretch(clock, resampled, squares)


def period_of_ticks(
    time: FloatArray,
    columns: Mapping[str, FloatArray],
    *,
    place: str,
    row: Callable[[int], str],
) -> float:
    """Sampling period, s, of rows that are the ticks of a loop, so that they need no resampling.

    The arguments are those of `resample`.

    Raises:
        RecordingError: fewer than two rows, values that are not finite, or irregular or decreasing time.
    """
    _checked(time, columns, dict.fromkeys(columns, "reading"), place, row)
    _refuse_standing(time, place, row)
    steps = np.diff(time)
    usual = usual_step(steps)
    odd = np.flatnonzero(np.abs(steps - usual) > _STEPS.jitter * usual)
    if odd.size:
        first = int(odd[0])
        raise RecordingError(
            f"{place}: {steps[first]:g} s from {row(first)} to {row(first + 1)}, elsewhere {usual:g} s; "
            "split the recording there, or import it with a map of its columns, which resamples it"
        )
    return rounded_period(float(steps.mean()))


def bridged_up_to(stamps: FloatArray, longest: float | None = None) -> float:
    """The longest step between rows that is interpolated, s: the user's limit, or of usual steps.

    `stamps` are the increasing times of at least two rows, s.
    """
    return _STEPS.bridged * usual_step(np.diff(stamps)) if longest is None else longest


def longest_without_loss(stamps: FloatArray) -> float:
    """The longest step between rows of which none was lost, s; `stamps` are the times of the rows, s."""
    return _STEPS.without_loss * usual_step(np.diff(stamps))


def second_pace(stamps: FloatArray) -> float | None:
    """The step of a second pace of a logger, s, such as one a minute at rest beside one a second.

    It is the longest of many long steps; None if there are few. `stamps` are the times of the rows, s.
    """
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    longer = forward[forward > _STEPS.bridged * usual_step(steps)]
    if longer.size <= max(
        _STEPS.fewest_of_a_pace, _STEPS.share_of_a_pace * forward.size
    ):
        return None
    pace = float(np.quantile(longer, _STEPS.most_of_a_pace, method="lower"))
    return math.ceil(1.02 * pace) if pace > 10.0 else float(f"{1.05 * pace:.2g}")


def usual_period(lag: float, row_period: float) -> float:
    """A sampling period, s, for a plant with this time constant: that of the rows unless they are fine."""
    if lag <= _STEPS.fine * row_period:
        return row_period
    wanted = lag / _STEPS.per_lag
    decade = 10.0 ** math.floor(math.log10(wanted))
    return next(
        float(f"{step * decade:.1g}")
        for step in (5.0, 2.0, 1.0)
        if step * decade <= wanted
    )


def usual_step(steps: FloatArray) -> float:
    """The lower median of the steps forward, since the shorter of two different steps is the usual one; lost
    rows bias a mean. Infinite if there are none."""
    forward = steps[steps > 0]
    return float(np.quantile(forward, 0.5, method="lower")) if forward.size else np.inf


def _indices(clocks: list[FloatArray], period: float) -> NDArray[np.int64]:
    """Indices of the samples: consecutive within a stretch; missing periods between stretches are skipped."""
    indices = [np.arange(clocks[0].size)]
    for before, clock in pairwise(clocks):
        # a clock set back skips one, too
        increment = max(round(float(clock[0] - before[-1]) / period), 2)
        indices.append(indices[-1][-1] + increment + np.arange(clock.size))
    return np.concatenate(indices).astype(np.int64)


def _checked(
    time: ArrayLike,
    columns: Mapping[str, ArrayLike],
    kinds: Mapping[str, Kind],
    place: str,
    row: Callable[[int], str],
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Times and columns as arrays, once shapes, kinds and values are those that `resample` needs."""
    stamps = np.asarray(time, dtype=np.float64)
    values = {
        name: np.asarray(column, dtype=np.float64) for name, column in columns.items()
    }
    if stamps.ndim != 1 or stamps.size < 2:
        raise RecordingError(
            f"{place}: has {stamps.size} rows; at least two are needed"
        )
    for name, column in values.items():
        if name not in kinds or kinds[name] not in _RESAMPLERS:
            allowed = ", ".join(_RESAMPLERS)
            raise RecordingError(
                f"{place}: the kind of column {name} is missing; give one of {allowed}"
            )
        if column.shape != stamps.shape:
            msg = f"{place}: {name} has the shape {column.shape}, time {stamps.shape}; they must be equal"
            raise RecordingError(msg)
    for name, column in {"time": stamps, **values}.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            raise RecordingError(
                f"{place}: {name} in {row(int(bad[0]))} is {column[bad[0]]:g}; give a finite number or leave "
                "the row out"
            )
    return stamps, values


def _refuse_standing(
    stamps: FloatArray, place: str, row: Callable[[int], str], *, split: bool = False
) -> None:
    """Refuse time that stands still or goes back; with `split`, it may go back now and then."""
    steps = np.diff(stamps)
    may_go_back = split and (steps < 0).sum() <= _STEPS.back * steps.size
    refused = np.flatnonzero(steps == 0 if may_go_back else steps <= 0)
    if refused.size:
        first = int(refused[0])
        rows_per_time = np.median(np.unique(stamps, return_counts=True)[1])
        is_rounded = (
            rows_per_time > 1
            and steps.size >= _FEWEST_ROUNDED
            and not (steps < 0).any()
        )
        if is_rounded:
            mean = float(f"{usual_step(steps) / rows_per_time:.3g}")
            raise RecordingError(
                f"{place}: {row(first)} and {row(first + 1)} have the same time, {stamps[first]:.12g} s, and "
                f"so on: the times have too few digits for rows about {mean:g} s apart; record more digits, "
                f"or map no time and give --period {mean:g}"
            )
        remedy = "sort the rows, and keep one per time"
        if steps[first] < 0 and not split:
            remedy = "if a clock was set back there, import it with --gaps split; otherwise sort the rows"
        raise RecordingError(
            f"{place}: time does not advance from {stamps[first]:.12g} s in {row(first)} to "
            f"{stamps[first + 1]:.12g} s in {row(first + 1)}; {remedy}"
        )


def _refuse_gap(
    stamps: FloatArray,
    cuts: NDArray[np.intp],
    limit: float,
    place: str,
    row: Callable[[int], str],
) -> None:
    """Refuse the steps after these rows (times `stamps`, s), which are longer than `limit`."""
    first = int(cuts[0])
    further = f" (and {cuts.size - 1} more)" if cuts.size > 1 else ""
    step = stamps[first + 1] - stamps[first]
    gap = f"{place}: a gap of {step:.4g} s after {row(first)}{further}"
    gap += f"; steps of up to {limit:.4g} s are bridged"
    pace = second_pace(stamps)
    if pace is not None:
        raise RecordingError(
            f"{gap}: the rows seem to have a second pace; bridge it (--bridge {pace:g}), and split the "
            "recording at what is longer (--gaps split)"
        )
    raise RecordingError(
        f"{gap}: split the recording at longer ones (--gaps split), or bridge them too (--bridge SECONDS)"
    )


def _default_period(
    stretches: list[FloatArray], steps: FloatArray, usual: float
) -> float:
    """The roundest period that the rows keep exactly, or else the roundest within `ROUNDED` of their mean.

    `steps` are those between rows within the stretches, s; those with lost rows count as several periods.
    """
    periods = float(np.sum(np.rint(steps / usual)))
    mean = sum(float(stretch[-1] - stretch[0]) for stretch in stretches) / periods
    rounded = (float(f"{mean:.{digits}g}") for digits in range(1, _DIGITS + 1))
    near = [period for period in rounded if abs(period - mean) <= ROUNDED * mean]
    exact = (period for period in near if _all_on_clock(stretches, period))
    return next(exact, near[0])


def _all_on_clock(stretches: list[FloatArray], period: float) -> bool:
    for stretch in stretches:
        _, on_clock = _clock(stretch, period)
        if not on_clock:
            return False
    return True


def _clock(stamps: FloatArray, period: float) -> tuple[FloatArray, bool]:
    """The ticks from the first row on, s, and whether the rows are on them."""
    ticks = round(float(np.floor((stamps[-1] - stamps[0]) / period + _ON_CLOCK))) + 1
    clock = stamps[0] + period * np.arange(ticks)
    on_clock = clock.size == stamps.size and bool(
        np.all(np.abs(stamps - clock) <= _ON_CLOCK * period)
    )
    return clock, on_clock


def _resampled_reading(
    stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float
) -> FloatArray:
    """A column at the ticks of a clock, linear between its rows."""
    return np.asarray(np.interp(clock, stamps, values), dtype=np.float64)


def _resampled_held(
    stamps: FloatArray, values: FloatArray, clock: FloatArray, period: float
) -> FloatArray:
    """The mean of a column that is held from row to row, over the period after each tick."""
    return held_means(stamps, values, clock, clock + period, period)


def held_means(
    stamps: FloatArray,
    values: FloatArray,
    begins: FloatArray,
    ends: FloatArray,
    widths: FloatArray | float,
) -> FloatArray:
    """Means of a held input from `begins` to `ends`, so many s (`widths`) later, each of shape (M,).

    `values` apply from `stamps` (s, increasing, shape (N,)) on, each until the next, the last for ever. The
    means are differences of the integral, which is linear between the stamps.
    """
    last_end = max(stamps[-1], begins[-1]) + np.ravel(widths)[-1]
    edges = np.append(stamps, last_end)
    integral = np.concatenate([[0.0], np.cumsum(values * np.diff(edges))])
    until_end = np.interp(ends, edges, integral)
    until_begin = np.interp(begins, edges, integral)
    means = (until_end - until_begin) / widths
    # Rounding errors of the differences must not exceed a limit of the input.
    return np.asarray(np.clip(means, values.min(), values.max()), dtype=np.float64)


def _resampled_set(
    stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float
) -> FloatArray:
    """The value of the row that is nearest to each tick."""
    between = (stamps[1:] + stamps[:-1]) / 2
    return np.asarray(
        values[np.searchsorted(between, clock, side="left")], dtype=np.float64
    )


_RESAMPLERS: Final[
    Mapping[Kind, Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]]
] = {
    "reading": _resampled_reading,
    "held": _resampled_held,
    "set": _resampled_set,
}
