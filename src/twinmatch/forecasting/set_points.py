"""Set-points of a forecast: constant, planned or recorded; inputs if the loop is not known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.dynamics import Drive, Output
from twinmatch.forecasting.forecast import ForecastError
from twinmatch.signals import FloatArray

_SLACK = 1e-9
"""Relative tolerance of a row's time: 3 × 0.1 s is not exactly 0.3 s."""

Row = str | Sequence[float | str]


@dataclass(frozen=True)
class SetPoints:
    """Rows of time and set-point (or input), relative to now; the last one is held.

    Raises:
        ForecastError: unequal numbers of times and set-points, a value that is not finite, a time in the past
            or out of order, or a set-point outside the plant's range.
    """

    before: float
    """Present set-point, which holds until the first row; in the plant's unit."""
    times: tuple[float, ...] = ()
    """Seconds from now, in increasing order."""
    levels: tuple[float, ...] = ()
    """Set-points from these times on, or, with ramps, reached at these times."""
    ramps: bool = False
    """Whether the set-point moves linearly from row to row, beginning now; otherwise it steps."""
    signal: Output | Drive | None = None
    """The plant's output or drive, which gives the range of set-points or inputs; None: no limits."""

    def __post_init__(self) -> None:
        if len(self.times) != len(self.levels):
            raise ForecastError(
                f"profile: {len(self.times)} times and {len(self.levels)} {self.kind}s are given; give one "
                f"{self.kind} per time"
            )
        self._check_level(f"the {self.kind} now", self.before)
        before = -math.inf
        for number, (time, level) in enumerate(
            zip(self.times, self.levels, strict=True), 1
        ):
            if not math.isfinite(time):
                raise ForecastError(
                    f"profile: row {number}: the time is {time:g} s; give a finite time"
                )
            if time < 0:
                msg = f"profile: row {number}: {time:g} s lies in the past; give seconds ahead of now"
                raise ForecastError(msg)
            if time <= before:
                raise ForecastError(
                    f"profile: row {number}: its time {time:g} s is not after the {before:g} s of the row "
                    "before; give increasing times"
                )
            self._check_level(f"row {number}: the {self.kind}", level)
            before = time

    @property
    def kind(self) -> str:
        """The kind of the levels."""
        return "input" if isinstance(self.signal, Drive) else "set-point"

    def _check_level(self, what: str, level: float) -> None:
        low, high, unit = _range_of(self.signal)
        if not math.isfinite(level):
            raise ForecastError(f"profile: {what} is {level:g}; give a finite number")
        if not low <= level <= high:
            raise ForecastError(
                f"profile: {what} is {_with_unit(level, unit)}; give one from {low:g} to "
                f"{_with_unit(high, unit)}, the range of the plant's {self.kind}s"
            )

    @classmethod
    def constant(cls, level: float, signal: Output | Drive | None = None) -> SetPoints:
        """One constant set-point.

        Raises:
            ForecastError: as the class.
        """
        return cls(float(level), signal=signal)

    @classmethod
    def planned(
        cls,
        rows: Sequence[Row],
        before: float,
        *,
        ramps: bool = False,
        signal: Output | Drive | None = None,
    ) -> SetPoints:
        """A profile from rows of time (s from now) and set-point: pairs of numbers or texts, or CSV lines.

        A first line of words is a header; empty lines and those that begin with # are ignored.

        Raises:
            ForecastError: a row is not a pair of numbers, there is no row, or as the class.
        """
        pairs: list[tuple[float, float]] = []
        may_be_header = True
        for number, row in enumerate(rows, 1):
            cells = _cells(row)
            if not cells or cells[0].startswith("#"):
                continue
            values = [_number_in(cell) for cell in cells]
            if may_be_header and len(cells) == 2 and values == [None, None]:
                may_be_header = False
                continue
            may_be_header = False
            if len(values) != 2 or values[0] is None or values[1] is None:
                raise ForecastError(
                    f"profile: line {number}: {', '.join(cells)!r} is not a pair of numbers; give the time "
                    "in s ahead and the set-point"
                )
            pairs.append((values[0], values[1]))
        if not pairs:
            raise ForecastError(
                "profile: it has no row; give at least one pair of time and set-point"
            )
        times, levels = zip(*pairs, strict=True)
        return cls(float(before), times, levels, ramps, signal)

    @classmethod
    def recorded(cls, reference: ArrayLike, period: float) -> SetPoints:
        """Recorded set-points, one per sample, beginning with the newest sample's; period in s.

        Recorded set-points are not checked against the plant's range.

        Raises:
            ForecastError: there is none, or one is not finite.
        """
        values = np.array(reference, dtype=np.float64).ravel().tolist()
        if not values:
            raise ForecastError(
                "profile: there is no set-point; give at least that of the newest sample"
            )
        return cls(
            values[0],
            tuple(k * period for k in range(1, len(values))),
            tuple(values[1:]),
        )

    def ahead(self, period: float, size: int) -> FloatArray:
        """Set-points of the next samples, shape (size,); the first is one period (s) ahead.

        Raises:
            ForecastError: the period is not positive, or there is no sample.
        """
        if not (math.isfinite(period) and period > 0 and size > 0):
            msg = f"profile: {size} samples every {period:g} s requested; give positive numbers"
            raise ForecastError(msg)
        time = period * np.arange(1, size + 1, dtype=np.float64)
        if self.ramps:
            return np.interp(time, (0.0, *self.times), (self.before, *self.levels))
        levels_begun = np.searchsorted(
            self.times, time + _SLACK * np.maximum(time, 1.0), side="right"
        )
        return np.array((self.before, *self.levels), dtype=np.float64)[levels_begun]

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on set-points that are allowed but outside the usual range."""
        if not isinstance(self.signal, Output) or self.signal.set_points is None:
            return ()
        low, high = self.signal.set_points
        beyond = [
            level for level in (self.before, *self.levels) if not low <= level <= high
        ]
        if not beyond:
            return ()
        unit = self.signal.unit
        return (
            f"A set-point of {beyond[0]:g} {unit} is outside the usual range of {low:g} to {high:g} {unit}.",
        )


def _range_of(signal: Output | Drive | None) -> tuple[float, float, str]:
    """Lowest and highest input or set-point that a plant takes, and the unit.

    Set-points are limited by the safe range or, where that has no limit, by the usual one.
    """
    if signal is None:
        return -math.inf, math.inf, ""
    if isinstance(signal, Drive):
        return (*signal.limits, signal.unit)
    low, high = signal.safe
    usual_low, usual_high = signal.set_points or signal.span
    return (
        low if math.isfinite(low) else usual_low,
        high if math.isfinite(high) else usual_high,
        signal.unit,
    )


def _with_unit(value: float, unit: str) -> str:
    return f"{value:g} {unit}".rstrip()


def _cells(row: Row) -> list[str]:
    """The cells of a line of CSV, or of a row that is split already, as texts."""
    if isinstance(row, str):
        text = row.replace(";", ",").replace("\t", ",").strip()
        return [cell.strip() for cell in text.split(",")] if text else []
    return [str(cell).strip() for cell in row]


def _number_in(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
