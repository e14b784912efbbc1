"""A first proposal for a plant of which nothing is recorded: what its owner knows without a measurement."""

from __future__ import annotations

import re
from typing import Final

from twinmatch.adding.proposal import Proposal, rounded
from twinmatch.adding.table_signals import Signal
from twinmatch.errors import TwinmatchError
from twinmatch.units import is_unit

_SIGNAL: Final = re.compile(
    r"\s*(?P<name>[^\W\d]\w*)\s*(?:\[(?P<unit>[^\]]*)\])?\s+(?P<low>\S+)\s+to\s+(?P<high>\S+)\s*"
)
_FULL: Final = 0.7
"""Share of the way from the reading now to the far end of the range that a full drive is taken to bring."""
_SAMPLES: Final = 120.0
"""Samples in the time constant."""
_NOISE: Final = 0.001
"""Noise of a sensor, as a share of its range."""


class BlankError(TwinmatchError):
    """What is said of a plant without a recording cannot be used."""


def signal_said(text: str, option: str) -> Signal:
    """A signal written as `name [unit] LOW to HIGH`.

    Raises:
        BlankError: it is written otherwise, the unit is not known, or the range is empty.
    """
    match = _SIGNAL.fullmatch(text)
    example = "give a name, its unit and its range, such as 'temperature [°C] 10 to 95'"
    if match is None:
        raise BlankError(
            f"new-plant: {option} {text[:80]!r} is not a signal; {example}"
        )
    unit = (match["unit"] or "").strip()
    try:
        low = float(match["low"])
        high = float(match["high"])
    except ValueError:
        raise BlankError(
            f"new-plant: {option} {text[:80]!r} has an end that is not a number; {example}"
        ) from None
    if not low < high < float("inf") or low == float("-inf"):
        raise BlankError(
            f"new-plant: {option}: {low:g} to {high:g} is not a range; give the lower end first"
        )
    if not is_unit(unit):
        raise BlankError(
            f"new-plant: {option}: {unit!r} is not a known unit; leave it out, or write another one"
        )
    return Signal(match["name"].lower(), unit, low, high)


def blank(
    measured: Signal, moved: Signal, lag: float, now: float | None = None
) -> Proposal:
    """A proposal from two signals, the time in which two thirds of a change have happened, s, and the reading
    now, with the drive at rest.

    Raises:
        BlankError: the reading is outside the range.
    """
    reading = (
        measured.low + 0.1 * (measured.high - measured.low) if now is None else now
    )
    if not measured.low <= reading <= measured.high:
        raise BlankError(
            f"new-plant: --now is {reading:g}; give a reading within {measured.low:g} to {measured.high:g}"
        )
    drive_rest = min(max(0.0, moved.low), moved.high)
    reach = max(moved.high - drive_rest, drive_rest - moved.low)
    gain = _FULL * max(measured.high - reading, reading - measured.low) / reach
    return Proposal(
        output=measured,
        input=moved,
        disturbances=(),
        noise=rounded(_NOISE * (measured.high - measured.low)),
        period=rounded(lag / _SAMPLES),
        gain=rounded(gain),
        lag=rounded(lag),
        rest=rounded(reading, 4),
        sources={},
        assumed=True,
    )
