"""Signals of a bag, each with its own times, as a table with one row per reading of the output.

The row of a reading has the latest set-point before it, the mean of the input from this reading to the next
(zero-order hold), and measured disturbances, interpolated linearly. `map_samples` then treats the table like
any other.

Times are those of the message headers where there are any, otherwise those at which the bag was recorded.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.sessions.bags import Bag, Series, open_bag
from twinmatch.sessions.column_map import ColumnMap, Source
from twinmatch.sessions.errors import RecordingError
from twinmatch.sessions.files import ProgressCallback, part_of
from twinmatch.sessions.mapped import Mapped, by_signal, map_samples
from twinmatch.sessions.resampling import Gaps, bridged_up_to
from twinmatch.sessions.sampling import INPUT, OUTPUT, REFERENCE, Wire
from twinmatch.sessions.sampling.usual_units import usual_unit
from twinmatch.sessions.tables import Table
from twinmatch.signals import FloatArray

__all__ = ["map_bag"]

TIME: Final = "time"
_ASTRAY: Final = 1.0
"""If headers and the bag's clock differ by more, s, the headers are of another clock."""


class _Signal(NamedTuple):
    time: FloatArray
    """s since 1970, increasing, shape (N,)."""
    values: FloatArray


def map_bag(
    path: Path,
    given: ColumnMap,
    plant: type[Plant],
    *,
    longest: float | None = None,
    gaps: Gaps = "refuse",
    progress: ProgressCallback | None = None,
) -> Mapped:
    """The samples of a plant from a bag.

    Args:
        path: folder of the bag.
        given: topics and fields by signal.
        plant: the plant that the signals belong to.
        longest: longest step between readings that is interpolated, s; three usual ones if not given.
        gaps: treatment of longer steps.
        progress: called with the number of messages read and their total.

    Raises:
        RecordingError: as `open_bag`, `Bag.series` and `map_samples`; a signal that is not mapped.
    """
    sources = by_signal(plant, given.sources)
    if TIME in sources:
        raise RecordingError("--map time: a bag has the times of its messages; leave it out")
    for name in (OUTPUT, INPUT):
        if name not in sources:
            msg = f"{path}: no topic is mapped to {name}; add --map {name}=TOPIC:FIELD (--list shows them)"
            raise RecordingError(msg)
    with open_bag(path) as bag:
        signals, units, notes = _read(bag, sources, progress)
    columns, left_out = _rows(signals, longest)
    if columns[TIME].size < 2:
        msg = f"{path}: fewer than two readings of {sources[OUTPUT].text} follow the first input; check --map"
        raise RecordingError(msg)
    if left_out:
        notes.append(f"The first {left_out} readings precede the first input or set-point and are left out.")
    table = Table(path, columns, range(left_out + 1, left_out + 1 + columns[TIME].size), "reading")
    named = {TIME: Source((TIME,), "s")}
    named |= {n: Source((n,), s.unit or units[n], s.scale, s.offset) for n, s in sources.items()}
    found = map_samples(table, ColumnMap(named, given.plant, given.period), plant, longest=longest, gaps=gaps)
    return found._replace(sources=sources, notes=[*found.notes, *notes])


def _read(
    bag: Bag, sources: Mapping[str, Source], progress: ProgressCallback | None
) -> tuple[dict[str, _Signal], dict[str, str], list[str]]:
    """Signals with their times, the units of their message types, and notes."""
    wires = {name: Wire.of(name, s.columns, s.unit, s.scale, s.offset) for name, s in sources.items()}
    series = {
        name: bag.series(wire.channels, progress=part_of(progress, number, len(wires)))
        for number, (name, wire) in enumerate(wires.items())
    }
    offsets = [
        f"{wires[name].channels[0].topic} by {off:.3g} s"
        for name, held in series.items()
        if (off := max(map(_clock_offset, held))) > _ASTRAY
    ]
    notes = []
    if offsets:
        notes.append(
            f"The headers have another clock ({', '.join(offsets)}); the times of the bag are used instead."
        )
    signals = {name: _joined(bag.path, name, held, bool(offsets)) for name, held in series.items()}
    # A signal with a scale in the map is not in the unit of its message type.
    bare = {name: (s.scale, s.offset) == (1.0, 0.0) for name, s in sources.items()}
    units = {n: usual_unit(held[0].kind, held[0].path) if bare[n] else "" for n, held in series.items()}
    return signals, units, notes


def _clock_offset(series: Series) -> float:
    """Median distance of the headers from the bag's clock, s; 0 without headers."""
    apart = np.abs(series.logged - series.stamped)
    return float(np.median(apart[np.isfinite(apart)])) if np.isfinite(apart).any() else 0.0


def _joined(path: Path, name: str, series: list[Series], logged: bool) -> _Signal:
    """The mean of a signal's channels, at the times of the first."""
    found = [_growing(path, name, one, logged) for one in series]
    first = found[0]
    values = [first.values, *(np.interp(first.time, other.time, other.values) for other in found[1:])]
    return _Signal(first.time, np.mean(values, axis=0))


def _growing(path: Path, name: str, series: Series, logged: bool) -> _Signal:
    time = series.logged if logged else np.where(np.isfinite(series.stamped), series.stamped, series.logged)
    kept = np.isfinite(series.values)
    if not kept.any():
        raise RecordingError(f"{path}: no message of {name} has a number; map another field")
    time, values = time[kept], series.values[kept]
    # Messages are sorted by time, since some arrive out of order; of several at one time the last is kept.
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    last = np.append(np.diff(time) > 0, True)
    return _Signal(time[last], values[last])


def _rows(signals: Mapping[str, _Signal], longest: float | None) -> tuple[dict[str, FloatArray], int]:
    """Columns of a table by signal, and the number of readings left out before its first row."""
    output = signals[OUTPUT]
    starts = [signals[name].time[0] for name in (INPUT, REFERENCE) if name in signals]
    begin = int(np.searchsorted(output.time, max(starts)))
    time = output.time[begin:]
    columns = {TIME: time, OUTPUT: output.values[begin:]}
    if time.size:
        for name, signal in signals.items():
            if name == INPUT:
                columns[name] = _means(signal, time, longest)
            elif name == REFERENCE:
                columns[name] = signal.values[np.searchsorted(signal.time, time, side="right") - 1]
            elif name != OUTPUT:
                columns[name] = np.interp(time, signal.time, signal.values)
    return columns, begin


def _means(signal: _Signal, time: FloatArray, longest: float | None) -> FloatArray:
    """Mean of the held signal from each time to the next; before a gap and at the end, over a median step."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    ends = np.append(time[1:], time[-1] + usual)
    if steps.size:
        wide = np.flatnonzero(steps > bridged_up_to(time, longest))
        ends[wide] = time[wide] + usual
    edges = np.union1d(signal.time, np.concatenate([time, ends]))
    held = signal.values[np.maximum(np.searchsorted(signal.time, edges, side="right") - 1, 0)]
    integral = np.concatenate([[0.0], np.cumsum(held[:-1] * np.diff(edges))])
    total = np.interp(ends, edges, integral) - np.interp(time, edges, integral)
    widths = ends - time
    before = signal.values[np.maximum(np.searchsorted(signal.time, time, side="right") - 1, 0)]
    means = np.divide(total, widths, out=before.copy(), where=widths > 0)
    return np.asarray(np.clip(means, signal.values.min(), signal.values.max()), dtype=np.float64)
