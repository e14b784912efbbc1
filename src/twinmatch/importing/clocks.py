"""Several clocks in one table: where two disagree, one counts in another unit than it says.

A logger that counts milliseconds under the label `s` makes a plant a thousand times too slow. A second column
of times shows it, but not which of them is right: the user decides. A number of the row is not a clock.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.importing.tables import Table, split_title
from twinmatch.importing.times import Times, is_since_1970, read_times, unit_in
from twinmatch.sessions.files import RecordingError
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

__all__ = ["is_record_number", "require_agreement", "unlabelled_clocks"]


class _Agreement(Rule):
    """When two clocks agree."""

    ratio: float = 1.1
    """Largest ratio of the times that pass by them: no clock is wrong by a tenth."""
    unit: float = 1.1
    """Largest ratio of the true unit to a usual one, for a proposal."""
    rising: float = 0.9
    """Least share of rows in which a column of numbers rises, to be a clock."""


_AGREEMENT: Final = _Agreement()
_NAME: Final = re.compile(
    r"^t$|^ms$|time|stamp|elapsed|millis|micros|uptime|^sec|clock", re.IGNORECASE
)
_UNITS: Final = {
    "ns": 1e-9,
    "us": 1e-6,
    "ms": 1e-3,
    "s": 1.0,
    "min": 60.0,
    "h": 3600.0,
    "d": 86400.0,
}
"""Usual units of time, s."""
_COUNTED: Final = r"rec|record|row|sample|scan|point|reading|entry|line|data"
_NUMBER: Final = r"no|nr|num|number|idx|index|id|count|counter|#"
_RECORD: Final = re.compile(
    rf"({_COUNTED}|{_NUMBER}|seq|sequence|[kni]|unnamed: 0|column 1)\.?|({_COUNTED})[ _.]*({_NUMBER})\.?",
    re.IGNORECASE,
)
"""Names of columns that count the rows."""


def is_record_number(name: str, values: FloatArray) -> bool:
    """Whether numbers that rise in each row count the rows: their column has such a name, and they are whole.

    `name` is its title without a unit, `values` are its numbers, shape (N,).
    """
    return _RECORD.fullmatch(name.strip()) is not None and bool(
        (values == np.rint(values)).all()
    )


class _Clock(NamedTuple):
    """A column of times."""

    title: str
    seconds: FloatArray
    """Shape (N,); nan without a time."""
    is_labelled: bool
    """Whether a unit, or the form of its times, says what it counts."""


def require_agreement(table: Table, title: str, times: Times) -> None:
    """Refuse times by which more or less passes than by another column with a unit.

    Args:
        table: the table.
        title: the column of `times`, whose unit nobody has confirmed.
        times: as read from it.

    Raises:
        RecordingError: two clocks disagree; the message tells how to say which is right.
    """
    for clock in _other_clocks(table, title):
        if not clock.is_labelled:
            continue
        ratio = _ratio(times.seconds, clock.seconds)
        if ratio is not None:
            raise RecordingError(
                f"{table.path}: {_disagreement(table, title, times, clock, ratio)}"
            )


def unlabelled_clocks(table: Table, title: str, times: Times) -> list[str]:
    """Notes on other columns of times without a unit by which another time passes than by this one."""
    notes = []
    for clock in _other_clocks(table, title):
        ratio = None if clock.is_labelled else _ratio(times.seconds, clock.seconds)
        if ratio is not None:
            notes.append(
                f"Two clocks: {_disagreement(table, title, times, clock, ratio)}."
            )
    return notes


def _disagreement(
    table: Table, title: str, times: Times, clock: _Clock, ratio: float
) -> str:
    rows = f"by {title!r} the rows are {_step(times.seconds):.4g} s apart, by {clock.title!r}"
    label = table.unit(title) or unit_in(title) or "s"
    true_unit = _unit_of(_UNITS.get(label.lower(), 1.0) / ratio)
    guess = (
        f"if {title!r} counts {true_unit}, write 'time={title}; unit={true_unit}'; "
        if true_unit
        else ""
    )
    return (
        f"{rows} {_step(clock.seconds):.4g} s; {guess}if it is right, write 'time={title}; unit={label}'; "
        f"to use the other, write 'time={clock.title}'"
    )


def _unit_of(seconds: float) -> str:
    """The usual unit of about this size, s; empty if none is near."""
    for unit, size in _UNITS.items():
        if 1.0 / _AGREEMENT.unit < seconds / size < _AGREEMENT.unit:
            return unit
    return ""


def _step(seconds: FloatArray) -> float:
    """Mean step between rows, s."""
    finite = seconds[np.isfinite(seconds)]
    return float(np.ptp(finite)) / max(finite.size - 1, 1)


def _ratio(seconds: FloatArray, others: FloatArray) -> float | None:
    """How much more time passes by one clock than by another; None if they agree, or too little passes."""
    both = np.isfinite(seconds) & np.isfinite(others)
    if both.sum() < 3:
        return None
    steps = np.diff(seconds[both])
    other_steps = np.diff(others[both])
    passed = float(steps[steps > 0].sum())
    other_passed = float(other_steps[other_steps > 0].sum())
    if min(passed, other_passed) <= 0.0:
        return None
    coarse = 2.0 * max(_usual_move(steps), _usual_move(other_steps))
    if abs(passed - other_passed) <= coarse < max(passed, other_passed) / 2:
        return None
    ratio = passed / other_passed
    return None if 1.0 / _AGREEMENT.ratio < ratio < _AGREEMENT.ratio else ratio


def _usual_move(steps: FloatArray) -> float:
    """Usual step of those that are not zero, s: a clock may show whole minutes."""
    return float(np.median(steps[steps > 0]))


def _other_clocks(table: Table, title: str) -> list[_Clock]:
    clocks = []
    for other in table.columns:
        clock = None if other == title else _clock(table, other)
        if clock is not None:
            clocks.append(clock)
    return clocks


def _clock(table: Table, title: str) -> _Clock | None:
    """A column as a clock; None if it is none."""
    name, _ = split_title(title)
    has_texts = bool(table.texts.get(title))
    if not has_texts and _NAME.search(name) is None:
        return None
    try:
        seconds = read_times(table, title).seconds
    except TwinmatchError:
        return None
    finite = seconds[np.isfinite(seconds)]
    steps = np.diff(finite)
    if finite.size < 3 or (steps < 0).any() or not (steps > 0).any():
        return None
    if has_texts:
        is_day_only = bool((finite % 86400.0 == finite[0] % 86400.0).all())
        return None if is_day_only else _Clock(title, seconds, is_labelled=True)
    if np.mean(steps > 0) < _AGREEMENT.rising:
        return None
    has_unit = bool(table.unit(title) or unit_in(title))
    return _Clock(
        title, seconds, is_labelled=has_unit or is_since_1970(table.columns[title])
    )
