"""Puts rows that come at irregular times on one clock.

A twin steps from sample to sample in equal periods. Loggers seldom keep such a clock: a loop that sleeps
between its turns has steps of 2.96 and 3.04 s, and now and then a row is lost. What belongs between two rows
depends on what a column is:

    reading   a sensor's value, which changes all the time: linear between the rows before and after
    held      an input that stands from its row until the next: its mean over the period that follows, so
              that the plant is given what it was given, however the rows lie about the clock
    set       a set-point or a mode, of which no mean makes sense: that of the nearest row

Readings are not smoothed. Where rows come much faster than the period, most of them are not used.

Nothing is known of a long gap. It is refused, or the recording is split there: each stretch has a clock that
begins with its own first row, because a logger may be started again at any moment, and the samples are
numbered on by the periods that are missing, so that no window reaches across.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinmatch.sessions.between_rows import MOVES, Kind
from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.resampled import Resampled
from twinmatch.signals import FloatArray

__all__ = ["Gaps", "bridged_up_to", "resample"]

Gaps = Literal["refuse", "split"]
"""What becomes of a gap that is too long to bridge."""

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
    """Put columns on one clock that begins with the first row. Rows on such a clock stay as they are.

    Args:
        time: when each row was taken, s, from any beginning; shape (N,).
        columns: by name, each of shape (N,).
        kinds: what each column is, by the same names.
        period: of the clock, s; if not given, the mean step where no row is lost. Rows that keep no clock
            are put on the roundest one within half a percent of that, so that two recordings of one logger
            have the same.
        longest: step from row to row that may be bridged, s; three usual ones if not given.
        gaps: what becomes of longer steps.
        place: begins the message of an error, such as `recording monday.csv`.
        row: names the place of the i-th row (from 0) as the file's owner counts.

    Raises:
        RecordingError: fewer than two rows, values that are not finite, time that does not advance, a step
            that is too long to bridge, a period that is too short for the rows, or a column without a kind.
    """
    stamps, values = _checked(time, columns, kinds, place, row)
    steps = np.diff(stamps)
    _refuse_standing(stamps, place, row)
    usual = _usual_step(steps)
    limit = bridged_up_to(stamps, longest)
    cuts = np.flatnonzero(steps > limit)
    if cuts.size and gaps == "refuse":
        _refuse_gap(steps, cuts, limit, place, row)
    kept = steps[steps <= limit]
    stretches = np.split(stamps, cuts + 1)
    if period is None:
        ticks = float(np.sum(np.rint(kept / usual)))  # periods, those of lost rows among them
        period = _period(stretches, sum(float(part[-1] - part[0]) for part in stretches) / ticks)
    elif not (np.isfinite(period) and period >= _CROWDED * usual):
        msg = (
            f"{place}: a period of {period:g} s is asked for; its rows are {usual:g} s apart, so give at "
            "least half of that"
        )
        raise RecordingError(msg)
    clocks, found, squares = [], [], 0.0
    for part, rows in zip(stretches, np.split(np.arange(stamps.size), cuts + 1), strict=True):
        clock, bare = _clock(part, period)
        pieces = {name: column[rows] for name, column in values.items()}
        if not bare:
            places = (part - clock[0]) / period
            squares += float(np.sum(np.square(places - np.rint(places))))
            pieces = {name: MOVES[kinds[name]](part, v, clock, period) for name, v in pieces.items()}
        clocks.append(clock)
        found.append(pieces)
    return Resampled(
        time=np.concatenate(clocks),
        index=_numbers(clocks, period),
        columns={name: np.concatenate([pieces[name] for pieces in found]) for name in values},
        period=period,
        rows=stamps.size,
        steps=(float(kept.min()), usual, float(kept.max())),
        jitter=period * float(np.sqrt(squares / stamps.size)),
        bridged=tuple(np.flatnonzero((steps > _USUAL * usual) & (steps <= limit)).tolist()),
        gaps=tuple(steps[cuts].tolist()),
    )


def bridged_up_to(stamps: FloatArray, longest: float | None = None) -> float:
    """The longest step from row to row that is bridged, s.

    Args:
        stamps: when the rows were taken, s; growing, shape (N,), N at least two.
        longest: what the user allows, s.
    """
    return _BRIDGED * _usual_step(np.diff(stamps)) if longest is None else longest


def _usual_step(steps: FloatArray) -> float:
    """Of two different steps the shorter is the usual; a mean would be drawn by each lost row."""
    return float(np.quantile(steps, 0.5, method="lower"))


def _numbers(clocks: list[FloatArray], period: float) -> NDArray[np.int64]:
    """Of the samples: counted on through each stretch, and by the missing periods from one to the next."""
    numbers = [np.arange(clocks[0].size)]
    for before, clock in pairwise(clocks):
        missing = max(round(float(clock[0] - before[-1]) / period), 2)
        numbers.append(numbers[-1][-1] + missing + np.arange(clock.size))
    return np.concatenate(numbers).astype(np.int64)


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
        if name not in kinds or kinds[name] not in MOVES:
            known = ", ".join(MOVES)
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


def _refuse_standing(stamps: FloatArray, place: str, row: Callable[[int], str]) -> None:
    back = np.flatnonzero(np.diff(stamps) <= 0)
    if back.size:
        at = int(back[0])
        msg = (
            f"{place}: time does not advance from {stamps[at]:.12g} s in {row(at)} to "
            f"{stamps[at + 1]:.12g} s in {row(at + 1)}; sort the rows, and keep one of each time"
        )
        raise RecordingError(msg)


def _refuse_gap(
    steps: FloatArray, cuts: NDArray[np.intp], limit: float, place: str, row: Callable[[int], str]
) -> None:
    at = int(cuts[0])
    others = f" (and {cuts.size - 1} more)" if cuts.size > 1 else ""
    msg = (
        f"{place}: a gap of {steps[at]:.4g} s after {row(at)}{others}; steps of up to {limit:.4g} s are "
        "bridged: split the recording at longer ones (--gaps split), or bridge them too (--bridge SECONDS)"
    )
    raise RecordingError(msg)


def _period(stretches: list[FloatArray], mean: float) -> float:
    """The clock's period where none is given, from the mean period of the rows: the roundest that they keep,
    else the roundest."""
    rounded = (float(f"{mean:.{digits}g}") for digits in range(1, _DIGITS + 1))
    near = [period for period in rounded if abs(period - mean) <= _ROUNDED * mean]
    return next((period for period in near if all(_clock(s, period)[1] for s in stretches)), near[0])


def _clock(stamps: FloatArray, period: float) -> tuple[FloatArray, bool]:
    """The ticks, and whether the rows lie on them."""
    ticks = round(float(np.floor((stamps[-1] - stamps[0]) / period + _ON_CLOCK))) + 1
    clock = stamps[0] + period * np.arange(ticks)
    bare = clock.size == stamps.size and bool(np.all(np.abs(stamps - clock) <= _ON_CLOCK * period))
    return clock, bare
