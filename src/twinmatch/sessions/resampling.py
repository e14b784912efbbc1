"""Puts rows that come at irregular times on one clock.

A twin steps from sample to sample in equal periods. Loggers seldom keep such a clock: a loop that sleeps
between its turns has steps of 2.96 and 3.04 s, and now and then a row is lost. What belongs between two rows
depends on what a column is:

    reading   a sensor's value, which changes all the time: linear between the rows before and after
    held      an input that stands from its row until the next: its mean over the period that follows, so
              that the plant is given what it was given, however the rows lie about the clock
    set       a set-point or a mode, of which no mean makes sense: that of the nearest row

Readings are not smoothed. Where rows come much faster than the period, most of them are not used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.sessions.errors import RecordingError
from twinmatch.signals import FloatArray

__all__ = ["Kind", "Resampled", "resample"]

Kind = Literal["reading", "held", "set"]
"""What a column is, and so what belongs between its rows."""

_ON_CLOCK: Final = 1e-3
"""Part of a period by which a row may miss its tick and still be taken as it is."""
_BRIDGED: Final = 3.0
"""Steps that are bridged where nothing else is said, in usual steps: up to two lost rows."""
_USUAL: Final = 1.5
"""Steps longer than so many medians have lost rows in them."""
_ROUNDED: Final = 5e-3
"""Part by which a period may be rounded; what is between the rows follows their own times all the same."""
_DIGITS: Final = 9
"""To which the period of a regular recording is kept."""
_CROWDED: Final = 0.5
"""Shortest period that can be asked for, in usual steps: most ticks need a row of their own."""


@dataclass(frozen=True, eq=False)
class Resampled:
    """Columns on one clock."""

    time: FloatArray
    """Of the samples, s, as the rows count it; equally far apart, from the first row on; shape (M,)."""
    columns: Mapping[str, FloatArray]
    """By name, each of shape (M,)."""
    period: float
    """Seconds from sample to sample."""
    rows: int
    """How many there were."""
    steps: tuple[float, float, float]
    """Seconds from row to row: the shortest, the median and the longest."""
    jitter: float
    """How far a row lay from the nearest tick of the clock, root mean square, s."""
    bridged: tuple[int, ...]
    """Rows (from 0) behind which others are missing: steps longer than one and a half of the usual."""

    @property
    def moved(self) -> bool:
        """Whether the values were put elsewhere; otherwise they are those of the rows."""
        return self.jitter > 0

    @property
    def sentence(self) -> str:
        """What was done, in plain words."""
        if not self.moved:
            return f"{self.rows} rows, one every {self.period:g} s"
        short, usual, long = self.steps
        text = (
            f"{self.rows} rows {short:.3g} to {long:.3g} s apart (half of them up to {usual:.3g} s) put on a "
            f"clock of {self.period:g} s; they lie {self.jitter:.2g} s beside it (RMS)"
        )
        if self.bridged:
            places = "one place" if len(self.bridged) == 1 else f"{len(self.bridged)} places"
            text += f"; rows are missing in {places}"
        return text


def resample(
    time: ArrayLike,
    columns: Mapping[str, ArrayLike],
    kinds: Mapping[str, Kind],
    period: float | None = None,
    *,
    longest: float | None = None,
    place: str = "recording",
    row: Callable[[int], str] = lambda i: f"row {i + 1}",
) -> Resampled:
    """Put columns on one clock that begins with the first row. Rows on such a clock stay as they are.

    Args:
        time: when each row was taken, s, from any beginning; shape (N,).
        columns: by name, each of shape (N,).
        kinds: what each column is, by the same names.
        period: of the clock, s; if not given, the mean step where no row is lost. Rows that keep no clock
            are put on the roundest one within half a percent of that, so that two recordings of one logger
            have the same.
        longest: step from row to row that may be bridged, s; three usual ones if not given.
        place: begins the message of an error, such as `recording monday.csv`.
        row: names the place of the i-th row (from 0) as the file's owner counts.

    Raises:
        RecordingError: fewer than two rows, values that are not finite, time that does not advance, a step
            that is too long to bridge, a period that is too short for the rows, or a column without a kind.
    """
    stamps, values = _checked(time, columns, kinds, place, row)
    steps = np.diff(stamps)
    # Of two different steps the shorter is the usual; a mean would be drawn by each lost row.
    usual = float(np.quantile(steps, 0.5, method="lower"))
    limit = _BRIDGED * usual if longest is None else longest
    _refuse_gaps(stamps, limit, place, row)
    if period is None:
        kept = float(np.sum(np.rint(steps / usual)))  # periods, those of lost rows among them
        period = _period(stamps, float(stamps[-1] - stamps[0]) / kept)
    elif not (np.isfinite(period) and period >= _CROWDED * usual):
        msg = (
            f"{place}: a period of {period:g} s is asked for; its rows are {usual:g} s apart, so give at "
            "least half of that"
        )
        raise RecordingError(msg)
    clock, bare = _clock(stamps, period)
    jitter = 0.0
    if not bare:
        places = (stamps - clock[0]) / period
        jitter = float(period * np.sqrt(np.mean(np.square(places - np.rint(places)))))
        values = {name: _MOVES[kinds[name]](stamps, v, clock, period) for name, v in values.items()}
    return Resampled(
        time=clock,
        columns=values,
        period=period,
        rows=stamps.size,
        steps=(float(steps.min()), usual, float(steps.max())),
        jitter=jitter,
        bridged=tuple(np.flatnonzero(steps > _USUAL * usual).tolist()),
    )


def _checked(
    time: ArrayLike,
    columns: Mapping[str, ArrayLike],
    kinds: Mapping[str, Kind],
    place: str,
    row: Callable[[int], str],
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Time and columns as arrays of one length, all of it finite."""
    stamps = np.asarray(time, dtype=np.float64)
    values = {name: np.asarray(column, dtype=np.float64) for name, column in columns.items()}
    if stamps.ndim != 1 or stamps.size < 2:
        raise RecordingError(f"{place}: has {stamps.size} rows; at least two are needed")
    for name, column in values.items():
        if name not in kinds or kinds[name] not in _MOVES:
            known = ", ".join(_MOVES)
            raise RecordingError(f"{place}: say for column {name} which it is of: {known}")
        if column.shape != stamps.shape:
            msg = f"{place}: {name} has the shape {column.shape}, time {stamps.shape}; they must be equal"
            raise RecordingError(msg)
    for name, column in {"time": stamps, **values}.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if bad.size:
            msg = (
                f"{place}: {name} in {row(int(bad[0]))} is {column[bad[0]]:g}; give a finite number or leave "
                "the row out"
            )
            raise RecordingError(msg)
    return stamps, values


def _refuse_gaps(stamps: FloatArray, longest: float, place: str, row: Callable[[int], str]) -> None:
    steps = np.diff(stamps)
    back = np.flatnonzero(steps <= 0)
    if back.size:
        at = int(back[0])
        msg = (
            f"{place}: time does not advance from {stamps[at]:.12g} s in {row(at)} to "
            f"{stamps[at + 1]:.12g} s in {row(at + 1)}; sort the rows, and keep one of each time"
        )
        raise RecordingError(msg)
    wide = np.flatnonzero(steps > longest)
    if wide.size:
        at = int(wide[0])
        others = f" (and {wide.size - 1} more)" if wide.size > 1 else ""
        msg = (
            f"{place}: a gap of {steps[at]:.4g} s after {row(at)}{others}; split the file there, or allow "
            f"steps of that length to be bridged (up to {longest:.4g} s are)"
        )
        raise RecordingError(msg)


def _period(stamps: FloatArray, mean: float) -> float:
    """The clock's period where none is given, from the mean period of the rows: the roundest that they keep,
    else the roundest."""
    rounded = (float(f"{mean:.{digits}g}") for digits in range(1, _DIGITS + 1))
    near = [period for period in rounded if abs(period - mean) <= _ROUNDED * mean]
    return next((period for period in near if _clock(stamps, period)[1]), near[0])


def _clock(stamps: FloatArray, period: float) -> tuple[FloatArray, bool]:
    """The ticks, and whether the rows lie on them."""
    ticks = round(float(np.floor((stamps[-1] - stamps[0]) / period + _ON_CLOCK))) + 1
    clock = stamps[0] + period * np.arange(ticks)
    bare = clock.size == stamps.size and bool(np.all(np.abs(stamps - clock) <= _ON_CLOCK * period))
    return clock, bare


def _reading(stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float) -> FloatArray:
    return np.asarray(np.interp(clock, stamps, values), dtype=np.float64)


def _held(stamps: FloatArray, values: FloatArray, clock: FloatArray, period: float) -> FloatArray:
    """What has been given up to a time is a line from row to row; a mean is a difference of two such sums."""
    ends = np.append(stamps, max(stamps[-1], clock[-1]) + period)  # the last row's value stands on
    given = np.concatenate([[0.0], np.cumsum(values * np.diff(ends))])
    means = (np.interp(clock + period, ends, given) - np.interp(clock, ends, given)) / period
    # Differences of sums are off in the last digits, and a limit of the input must not be passed by them.
    return np.asarray(np.clip(means, values.min(), values.max()), dtype=np.float64)


def _set(stamps: FloatArray, values: FloatArray, clock: FloatArray, _period: float) -> FloatArray:
    between = (stamps[1:] + stamps[:-1]) / 2
    return np.asarray(values[np.searchsorted(between, clock, side="left")], dtype=np.float64)


_MOVES: Final[Mapping[Kind, Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]]] = {
    "reading": _reading,
    "held": _held,
    "set": _set,
}
