"""A table as samples of a plant: columns chosen by a map, converted to the plant's units, on one clock."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.dynamics.pace import time_constant
from twinmatch.errors import TwinmatchError
from twinmatch.importing.resampling import Gaps, Kind, Resampled, repeated, resample
from twinmatch.importing.tables import Table, split_title
from twinmatch.importing.times import Times, read_times, row_times
from twinmatch.sampling.channels import SamplingError
from twinmatch.sampling.names import LoopNames, accepted_names, by_signal
from twinmatch.sampling.sources import INPUT, OUTPUT, TIME, SignalMap, SignalSource
from twinmatch.sessions.files import RecordingError
from twinmatch.sessions.recording import EPOCH
from twinmatch.signals import FloatArray, Sample, Signals
from twinmatch.units import Conversion, conversion, measure

_ODD = 0.01
"""Up to this share of readings beyond the sensor's span, the sensor is suspected rather than the unit."""

_MARKS = (-999.0, -9999.0, -99999.0, -999.9, -999.99)
"""Numbers that loggers write where there is no value."""


class Mapped(NamedTuple):
    """Samples of a plant, and how they were obtained."""

    samples: list[Sample]
    period: float
    """Sampling period, s."""
    sources: Mapping[str, SignalSource]
    """By signal, with the titles as in the table."""
    has_reference: bool
    """Whether the table has set-points; without, every sample has the same meaningless references."""
    notes: list[str]
    """Sentences for the user."""


class PlantSignal(NamedTuple):
    """Properties of one of the plant's signals."""

    kind: Kind
    unit: str
    low: float = -math.inf
    high: float = math.inf


def with_plant_names(table: Table, plant: type[Plant], given: SignalMap) -> SignalMap:
    """The map, completed with columns that have the names of signals."""
    sources = dict(by_signal(plant, given.sources))
    taken = {table.find(place) for source in sources.values() for place in with_titles(table, source).places}
    titled: dict[str, list[str]] = {}
    for title in table.columns:
        titled.setdefault(split_title(title)[0].lower(), []).append(title)
    # The plant's own names first: a drive may be called output.
    for signal, names in sorted(accepted_names(plant).items(), key=lambda entry: len(entry[1]) == 1):
        for name in reversed(names) if signal not in sources else ():
            titles = titled.get(name.lower(), [])
            if len(titles) == 1 and titles[0] not in taken:
                sources[signal] = SignalSource((titles[0],))
                taken.add(titles[0])
                break
    return SignalMap(sources, given.plant, given.period)


def map_samples(
    table: Table,
    given: SignalMap,
    plant: type[Plant],
    *,
    longest: float | None = None,
    gaps: Gaps = "refuse",
) -> Mapped:
    """The samples of a plant from a table.

    Args:
        table: the table.
        given: its columns by signal.
        plant: what they are signals of.
        longest: longest step between rows that is interpolated, s; three usual ones if not given.
        gaps: treatment of longer steps, and of steps back; where they split the table, the samples' indices
            skip.

    Raises:
        RecordingError: a signal or column is missing, units do not fit, values are outside the plant's
            range, or a gap is too long.
    """
    sources = {
        signal: with_titles(table, source) for signal, source in by_signal(plant, given.sources).items()
    }
    signals, notes = _wanted(table, plant, replace(given, sources=sources))
    times = times_of(table, sources.get(TIME), given.period)
    values = {signal: _values(table, sources[signal], signal, known) for signal, known in signals.items()}
    whole = np.isfinite(times.seconds) & np.all([np.isfinite(v) for v in values.values()], axis=0)
    if whole.sum() < 2:
        signal = next(s for s in (TIME, *values) if not np.isfinite({TIME: times.seconds, **values}[s]).any())
        raise RecordingError(f"{table.path}: no row has a value of {signal}; map another column to it")
    if not whole.all():
        lost = np.flatnonzero(~whole)
        where = f"{table.row} {table.lines[int(lost[0])]}"
        notes.append(f"{lost.size} rows lack a value and are left out, the first in {where}.")
    kept = np.flatnonzero(whole)
    twice = repeated(kept, times.seconds, *values.values())
    if twice.size:
        where = f"{table.row} {table.lines[int(twice[0])]}"
        notes.append(f"{twice.size} rows repeat the row before and are left out, the first in {where}.")
        kept = np.setdiff1d(kept, twice)
    notes += [f"The dates are read as {times.order}."] if times.order else []
    for signal, known in signals.items():
        notes += check_range(table, signal, known, values[signal], kept)
    done = resample(
        times.seconds[kept],
        {signal: column[kept] for signal, column in values.items()},
        {signal: known.kind for signal, known in signals.items()},
        given.period,
        longest=longest,
        gaps=gaps,
        place=str(table.path),
        row=lambda i: f"{table.row} {table.lines[int(kept[i])]}",
    )
    if given.period is None:
        _require_pace(table, plant, done.period)
    notes.insert(0, done.sentence[0].upper() + done.sentence[1:] + ".")
    start = EPOCH if times.origin is None else round((times.origin + float(done.time[0])) * 1e9)
    samples = _samples(plant, done, start)
    has_reference = LoopNames.of(plant).references[0] in done.columns
    return Mapped(samples, done.period, sources, has_reference, notes)


def _require_pace(table: Table, plant: type[Plant], period: float) -> None:
    slow = time_constant(plant)
    if 0.0 < slow < period:
        raise RecordingError(
            f"{table.path}: its rows are {period:g} s apart, but {plant.title} settles within {slow:.3g} s: "
            "nothing of that could be seen. If the times are in another unit, write 'time=COLUMN; unit=ms' "
            f"or the like; if they are right, give --period {period:g}"
        )


def with_titles(table: Table, source: SignalSource) -> SignalSource:
    """The source with the table's own titles; a single text with commas may be several columns."""
    places = source.places
    if len(places) == 1 and "," in places[0]:
        try:
            places = (table.find(places[0]),)
        except RecordingError:
            places = source.separate
    return replace(source, places=tuple(map(table.find, places)))


def require_columns(table: Table, given: SignalMap, needed: Sequence[str] = (OUTPUT, INPUT)) -> None:
    """Check that a map has these signals, and times or the distance of the rows.

    Raises:
        RecordingError: something is missing.
    """
    missing = [signal for signal in needed if signal not in given.sources]
    missing = missing if given.period is not None or TIME in given.sources else [TIME, *missing]
    if missing:
        msg = (
            f"{table.path}: no column is mapped to {' and none to '.join(missing)}; "
            f"add --map {' '.join(f'{signal}=COLUMN' for signal in missing)}; "
            f"its columns are {table.titles}"
        )
        rows = ". If the table has no times and its rows are equally far apart, give --period SECONDS instead"
        raise RecordingError(msg + (rows if TIME in missing else ""))


def _wanted(table: Table, plant: type[Plant], given: SignalMap) -> tuple[dict[str, PlantSignal], list[str]]:
    loop, sources = LoopNames.of(plant), given.sources
    require_columns(table, given, (*loop.outputs, *loop.inputs))
    outputs, signals = plant.outputs.values(), {}
    for name, y in zip(loop.outputs, outputs, strict=True):
        signals[name] = PlantSignal("reading", y.unit, *y.span)
    for name, u in zip(loop.inputs, plant.drives.values(), strict=True):
        signals[name] = PlantSignal("held", u.unit, *u.limits)
    closed = [name for name in loop.references if name in sources]
    if closed and len(closed) < len(loop.references):
        left = next(name for name in loop.references if name not in sources)
        raise RecordingError(f"--map: {closed[0]} is given, but not {left}; give all set-points, or none")
    for name, y in zip(closed, outputs, strict=False):
        signals[name] = PlantSignal("set", y.unit)
    notes = []
    for name, disturbance in plant.disturbances.items():
        if name in sources:
            signals[name] = PlantSignal("reading", disturbance.unit)
        else:
            value = f"{disturbance.default:g} {disturbance.unit}".strip()
            notes.append(f"{name} is not in the table: the plant's default, {value}, is used.")
    if not closed:
        notes.append(
            "The table has no set-point: the loop is treated as unknown, the twin is driven by the input."
        )
    return signals, notes


def times_of(table: Table, source: SignalSource | None, period: float | None) -> Times:
    """The times in a column of a table or, without one, those of rows equally far apart."""
    if source is None:
        return row_times(len(table.lines), period or 1.0)
    if len(source.places) > 1:
        raise RecordingError(f"--map time={source.text}: names several columns; give one for time")
    return read_times(table, source.places[0], source.unit, source.scale)


def _values(table: Table, source: SignalSource, signal: str, known: PlantSignal) -> FloatArray:
    """A signal in the plant's unit, shape (N,)."""
    changes = []
    for title in source.places:
        stated = table.unit(title)
        stated = stated if measure(stated).known else ""  # other text in brackets is a remark
        try:
            changes.append(source.change(signal, title, known.unit, stated))
        except SamplingError as error:
            raise RecordingError(f"{table.path}: {error}") from None
    return source.value([without_marks(table.values(title)) for title in source.places], changes)


def without_marks(values: FloatArray) -> FloatArray:
    """A column with nan where a logger wrote -999 or the like for "no value", shape (N,).

    It is a mark where no other reading comes near it.
    """
    known = values[np.isfinite(values)]
    marks = np.isin(known, _MARKS)
    readings = known[~marks]
    if not marks.any() or not readings.size or readings.min() < 0.5 * float(known[marks].max()):
        return values
    return np.where(np.isin(values, _MARKS), np.nan, values)


def check_range(
    table: Table, signal: str, known: PlantSignal, values: FloatArray, kept: np.ndarray | None = None
) -> list[str]:
    """Refuse values outside the plant's range; keep a few odd readings as those of a failed sensor, which the
    health monitor detects.

    The values are in the plant's unit, shape (N,); `kept` are the rows that are used, all if not given.

    Returns:
        A note on odd readings.

    Raises:
        RecordingError: values are outside the range.
    """
    kept = np.arange(values.size) if kept is None else kept
    slack = 1e-9 * max(abs(known.low), abs(known.high)) if math.isfinite(known.high - known.low) else 0.0
    outside = kept[(values[kept] < known.low - slack) | (values[kept] > known.high + slack)]
    if not outside.size:
        return []
    first = int(outside[0])
    others = f" (and in {outside.size - 1} more)" if outside.size > 1 else ""
    what = "limits of its drive" if known.kind == "held" else "span of its output"
    words = (
        f"{signal} is {values[first]:g} {known.unit}{others}, beyond the {what}, "
        f"{known.low:g} to {known.high:g}"
    )
    if known.kind == "reading" and outside.size <= _ODD * kept.size:
        return [f"In {table.row} {table.lines[first]}, {words}; kept as readings of a failed sensor."]
    raise RecordingError(f"{table.place(first)}: {words}; {_hint(signal, known, values[kept])}")


def _hint(signal: str, known: PlantSignal, values: FloatArray) -> str:
    for unit in ("K", "degF", "mV", "mA", "mW", "kW", "ms", "min", ""):
        try:
            change = conversion(unit, known.unit)
        except TwinmatchError:
            continue
        with np.errstate(over="ignore"):
            within = values * change.scale + change.offset
        if change != Conversion() and ((within >= known.low) & (within <= known.high)).all():
            return f"if the column is in {unit or 'parts of one'}, write '{signal}=COLUMN; unit={unit or 1}'"
    for scale in (0.01, 100.0, 1e-3, 1e3, 100 / 255, 1 / 255):
        with np.errstate(over="ignore"):  # of damaged files
            within = values * scale
        if within.max() > 0.2 * known.high and ((within >= known.low) & (within <= known.high)).all():
            return f"if it is in another unit, write '{signal}=COLUMN; scale={scale:.6g}'"
    return "map another column, give its unit, or widen the plant's range if the values are right"


def _samples(plant: type[Plant], done: Resampled, start: int) -> list[Sample]:
    columns, size, loop = done.columns, done.index.size, LoopNames.of(plant)
    # Without set-points the twin is driven by the inputs and ignores the references, which must be finite.
    usual = {name: columns[y][0] for name, y in zip(loop.references, loop.outputs, strict=True)}
    usual |= {name: d.default for name, d in plant.disturbances.items()}

    def rows(names: Sequence[str]) -> list[Signals]:
        each = [columns[name] if name in columns else np.full(size, usual[name]) for name in names]
        return list(map(tuple, np.array(each).reshape(len(each), size).T.tolist()))

    stamps, late = np.empty(size, dtype=np.int64), 0
    for stretch in done.stretches:
        first = stretch.start
        begin = start + round(float(done.time[first] - done.time[0]) * 1e9) + late
        if first and begin <= stamps[first - 1]:  # after a clock was set back, the session's does not go back
            missing = int(done.index[first] - done.index[first - 1])
            behind = int(stamps[first - 1]) + round(missing * done.period * 1e9) - begin
            begin, late = begin + behind, late + behind
        stamps[stretch] = [begin + round(k * done.period * 1e9) for k in range(stretch.stop - first)]
    signals = [*map(rows, loop), rows(list(plant.disturbances))]
    return [Sample(*row) for row in zip(done.index.tolist(), stamps.tolist(), *signals, strict=True)]
