"""When the output will be somewhere, and when to begin, in lines and for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from twinmatch.dynamics import Plant
from twinmatch.forecasting import Arrival, Moment
from twinmatch.offline.clock_times import clock_words


def arrival_words(answer: Arrival, plant: type[Plant], stamp: int, *, closed: bool) -> list[str]:
    """The answer in lines; `stamp` is that of the newest sample, ns, and `closed` says whether the loop is
    known."""
    unit = plant.output.unit if closed else plant.drive.unit
    kind = "set-point" if closed else "input"
    goal = _amount(answer.level, plant.output.unit)
    held = f"{kind} of {_amount(answer.standing, unit)} held"
    lines = [f"{goal}: {_when(answer.held, answer.looked, stamp)} with its {held}"]
    if answer.move != answer.standing:
        moved = _when(answer.moved, answer.looked, stamp)
        lines.append(f"{goal}: {moved} with {_amount(answer.move, unit)} from now on")
    if answer.beginning is None or answer.by is None:
        return lines
    target = _time(answer.by, stamp)
    begin = f"give {_amount(answer.move, unit)}"
    if answer.beginning.safe is not None and answer.beginning.expected is not None:
        mean = _time(answer.beginning.expected, stamp)
        lines.append(
            f"to be there {target}: {begin} {_time(answer.beginning.safe, stamp)}; {mean} in the mean"
        )
    elif answer.beginning.expected is not None:
        mean = _time(answer.beginning.expected, stamp)
        lines.append(
            f"to be there {target}: {begin} at once; {mean} in the mean, but the band may arrive later"
        )
    else:
        lines.append(f"not there {target}, even with {_amount(answer.move, unit)} from now on")
    return lines


def arrival_document(answer: Arrival) -> dict[str, Any]:
    """All of it for JSON."""
    return asdict(answer) | {"notes": list(answer.notes)}


def _when(moment: Moment, looked: float, stamp: int) -> str:
    if moment.expected is None:
        if moment.earliest is None:
            return f"not within {looked:g} s"
        soonest = _time(moment.earliest, stamp)
        return f"not within {looked:g} s by the mean, by the band {soonest} at the earliest"
    latest = "later" if moment.latest is None else f"{moment.latest:g}"
    earliest = moment.expected if moment.earliest is None else moment.earliest
    return f"first {_time(moment.expected, stamp)} ({earliest:g} to {latest} s)"


def _time(seconds: float, stamp: int) -> str:
    clock = clock_words(stamp, seconds)
    return f"after {seconds:g} s" + (f", at {clock}" if clock else "")


def _amount(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()
