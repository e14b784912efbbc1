"""A table as samples of a plant: columns chosen by a map, converted to the plant's units, on one clock."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics import Plant
from twinmatch.dynamics.pace import time_constant
from twinmatch.errors import TwinmatchError
from twinmatch.importing.clocks import require_agreement, unlabelled_clocks
from twinmatch.importing.resampling import (
    Gaps,
    Kind,
    Resampled,
    complete_rows,
    longest_without_loss,
    repeated,
    resample,
    usual_period,
)
from twinmatch.importing.stacked import SeriesTable
from twinmatch.importing.tables import Table, split_title
from twinmatch.importing.times import Times, read_date_and_time, read_times, row_times
from twinmatch.sampling.channels import SamplingError, UnreadableError
from twinmatch.sampling.names import LoopNames, accepted_names, by_signal, turns_of
from twinmatch.sampling.sources import INPUT, OUTPUT, TIME, SignalMap, SignalSource
from twinmatch.sampling.turns import (
    all_beside,
    angle_words,
    counted_on,
    shown_turn,
    uncertain_gaps,
)
from twinmatch.sampling.written_numbers import written_number
from twinmatch.sessions.files import RecordingError
from twinmatch.sessions.recording import EPOCH
from twinmatch.signals import FloatArray, Sample, Signals
from twinmatch.units import Conversion, conversion, measure

_FEW_WORDS: Final = 6
"""Most different words of a column that stand for states of a drive."""

_FAILED_SENSOR_SHARE = 0.01
"""Largest share of readings beyond the sensor's span that is blamed on the sensor, not on a wrong unit."""

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


def with_plant_names(
    table: Table, plant: type[Plant], signal_map: SignalMap
) -> SignalMap:
    """The map, completed with columns that have the names of signals."""
    sources = dict(by_signal(plant, signal_map.sources))
    if isinstance(table, SeriesTable):
        sources.setdefault(TIME, SignalSource((table.time,)))
    used_titles: set[str] = set()
    for source in sources.values():
        used_titles.update(map(table.find, with_titles(table, source).places))
    titles_by_name = _titles_by_name(table)
    for signal, names in _own_names_first(accepted_names(plant)):
        if signal in sources:
            continue
        title = _only_free_title(titles_by_name, reversed(names), used_titles)
        if title is not None:
            sources[signal] = SignalSource((title,))
            used_titles.add(title)
    return SignalMap(sources, signal_map.plant, signal_map.period)


def _titles_by_name(table: Table) -> dict[str, list[str]]:
    """Titles of columns by their names in lower case, without units."""
    titles: dict[str, list[str]] = {}
    for title in table.columns:
        name, _ = split_title(title)
        titles.setdefault(name.lower(), []).append(title)
    return titles


def _own_names_first(
    names_by_signal: Mapping[str, Sequence[str]],
) -> list[tuple[str, Sequence[str]]]:
    """The signals with their names, those first that the plant calls otherwise, too.

    A plant may call its drive `output`: a column of that name is then the drive, not the output.
    """
    named_otherwise = [
        (signal, names) for signal, names in names_by_signal.items() if len(names) > 1
    ]
    others = [
        (signal, names) for signal, names in names_by_signal.items() if len(names) <= 1
    ]
    return named_otherwise + others


def _only_free_title(
    titles_by_name: Mapping[str, Sequence[str]],
    names: Iterable[str],
    used_titles: Container[str],
) -> str | None:
    """The title of the first of these names that exactly one column has, if that column is not used yet."""
    for name in names:
        titles = titles_by_name.get(name.lower(), ())
        if len(titles) == 1 and titles[0] not in used_titles:
            return titles[0]
    return None


def map_samples(
    table: Table,
    signal_map: SignalMap,
    plant: type[Plant],
    *,
    longest: float | None = None,
    gaps: Gaps = "refuse",
) -> Mapped:
    """The samples of a plant from a table.

    Args:
        table: the table.
        signal_map: its columns by signal.
        plant: what they are signals of.
        longest: longest step between rows that is interpolated, s; three usual ones if not given.
        gaps: treatment of longer steps, and of steps back; where they split the table, the samples' indices
            skip.

    Raises:
        RecordingError: a signal or column is missing, units do not fit, values are outside the plant's
            range, or a gap is too long.
    """
    sources = {
        signal: with_titles(table, source)
        for signal, source in by_signal(plant, signal_map.sources).items()
    }
    signals, notes = _signals_to_read(
        table, plant, replace(signal_map, sources=sources)
    )
    times = times_of(table, sources.get(TIME), signal_map.period)
    turns = turns_in(table.path, plant, sources)
    kinds = {signal: properties.kind for signal, properties in signals.items()}
    table, times = in_rows(table, sources, without_means_of(kinds, turns), times)
    possible_values, impossible_notes = _possible_values(table, sources, signals)
    values = _with_turns_counted(plant, possible_values, turns)
    rows, row_notes = _rows_with_values(table, times, values)
    notes += impossible_notes
    notes += row_notes
    notes += table.notes
    notes += notes_on_times(table, sources.get(TIME), times)
    for signal, properties in signals.items():
        notes += check_range(table, signal, properties, values[signal], rows)
    angles = _Angles(plant, table, times.seconds, rows)
    for signal, properties in signals.items():
        if signal in turns and signal not in LoopNames.of(plant).references:
            notes += angles.notes_on_gaps(signal, values[signal], turns[signal])
        elif properties.kind == "reading":
            notes += angles.notes_on_beginnings(
                signal, values[signal], properties.unit, sources[signal]
            )
    with _explained_by(impossible_notes):
        resampled = resample(
            times.seconds[rows],
            {signal: column[rows] for signal, column in values.items()},
            kinds,
            signal_map.period,
            longest=longest,
            gaps=gaps,
            place=str(table.path),
            row=lambda i: table.row_name(int(rows[i])),
        )
    if signal_map.period is None:
        _require_pace(table, plant, resampled.period)
        notes += _note_on_fine_rows(plant, resampled.period)
    how_resampled = resampled.sentence[0].upper() + resampled.sentence[1:] + "."
    return Mapped(
        _samples(plant, resampled, _start_of(resampled, times)),
        resampled.period,
        sources,
        LoopNames.of(plant).references[0] in resampled.columns,
        [how_resampled, *notes],
    )


def turns_in(
    path: Path, plant: type[Plant], sources: Mapping[str, SignalSource]
) -> Mapping[str, float]:
    """The turn of each signal of a recording that begins again after one.

    Raises:
        RecordingError: such a signal is the mean of several places.
    """
    try:
        return turns_of(plant, sources)
    except SamplingError as error:
        raise RecordingError(f"{path}: {error}") from None


def _possible_values(
    table: Table,
    sources: Mapping[str, SignalSource],
    signals: Mapping[str, PlantSignal],
) -> tuple[dict[str, FloatArray], list[str]]:
    """The values of signals in the plant's units, shape (N,) each, NaN where nothing can have read them; and notes on
    these."""
    values = {}
    notes = []
    for signal, properties in signals.items():
        converted = _values(table, sources[signal], signal, properties)
        values[signal] = without_impossible(converted, properties.unit)
        notes += notes_on_impossible(table, signal, converted, values[signal])
    return values, notes


@contextmanager
def _explained_by(notes: Sequence[str]) -> Iterator[None]:
    """Add notes to an error: values that were taken out may be its reason."""
    try:
        yield
    except RecordingError as error:
        in_brackets = [f"({note})" for note in notes]
        raise RecordingError(" ".join([str(error), *in_brackets])) from None


def _start_of(resampled: Resampled, times: Times) -> int:
    """The stamp of the first sample, ns since 1970."""
    if times.origin is None:
        return EPOCH
    return round((times.origin + float(resampled.time[0])) * 1e9)


class _Angles(NamedTuple):
    """Signals of a table, some of which begin again after a turn, in the rows that are used."""

    plant: type[Plant]
    table: Table
    seconds: FloatArray
    """Times of all rows, s."""
    rows: NDArray[np.intp]

    def notes_on_gaps(self, signal: str, counted: FloatArray, turn: float) -> list[str]:
        """A note on gaps in which a signal may have moved by more than half a turn; `counted` has all rows."""
        seconds = self.seconds[self.rows]
        steps = np.abs(np.diff(seconds))
        gaps = np.flatnonzero(steps > longest_without_loss(seconds)).tolist()
        uncertain = uncertain_gaps(seconds, counted[self.rows], turn, gaps)
        if not uncertain:
            return []
        first = uncertain[0]
        further = f" (and in {len(uncertain) - 1} more)" if len(uncertain) > 1 else ""
        return [
            f"{signal} may have moved by more than half a turn in the {steps[first]:.4g} s behind "
            f"{self.table.row_name(int(self.rows[first]))}{further}, as fast as it moves elsewhere: the shorter "
            "way is taken."
        ]

    def notes_on_beginnings(
        self, signal: str, values: FloatArray, unit: str, source: SignalSource
    ) -> list[str]:
        """A note on a signal that begins again after a turn, though neither plant file nor map say so."""
        name = " ".join((signal, *source.places))
        turn = shown_turn(values[self.rows], unit, name)
        if turn <= 0.0:
            return []
        is_disturbance = signal in self.plant.disturbances
        return [note_on_turn(signal, turn, is_disturbance=is_disturbance)]


def note_on_turn(signal: str, turn: float, *, is_disturbance: bool) -> str:
    """What to write of a signal that begins again after a turn."""
    where = f"'{signal}=COLUMN; turn={turn:.6g}' in the map"
    if not is_disturbance:
        where = f"turn={turn:.6g} in the plant file's Output, or {where}"
    return (
        f"{angle_words(signal, turn)}, which no plant can follow: write {where}, "
        "and its turns are counted."
    )


def _rows_with_values(
    table: Table, times: Times, values: Mapping[str, FloatArray]
) -> tuple[NDArray[np.intp], list[str]]:
    """The rows that have a time and all values and do not repeat the row before, and notes on the others.

    Raises:
        RecordingError: fewer than two rows have a time and all values.
    """
    columns = {TIME: times.seconds, **values}
    rows = complete_rows(*columns.values())
    if rows.size < 2:
        signal = next(
            name for name, column in columns.items() if not np.isfinite(column).any()
        )
        raise RecordingError(
            f"{table.path}: no row has a value of {signal}; map another column to it"
        )
    notes = []
    incomplete = np.setdiff1d(np.arange(times.seconds.size), rows)
    if incomplete.size:
        first = table.row_name(int(incomplete[0]))
        notes.append(
            f"{incomplete.size} rows lack a value and are left out, the first in {first}."
        )
    repeats = repeated(rows, *columns.values())
    if repeats.size:
        first = table.row_name(int(repeats[0]))
        notes.append(
            f"{repeats.size} rows repeat the row before and are left out, the first in {first}."
        )
        rows = np.setdiff1d(rows, repeats)
    return rows, notes


def _require_pace(table: Table, plant: type[Plant], period: float) -> None:
    """Refuse rows so far apart that the plant settles between two of them: the times are in another unit."""
    settles_in = time_constant(plant)
    if 0.0 < settles_in < period:
        raise RecordingError(
            f"{table.path}: its rows are {period:g} s apart, but {plant.title} settles within "
            f"{settles_in:.3g} s: nothing of that could be seen. If the times are in another unit, write "
            f"'time=COLUMN; unit=ms' or the like; if they are right, give --period {period:g}"
        )


def _note_on_fine_rows(plant: type[Plant], period: float) -> list[str]:
    """A note on rows much closer together than the plant needs."""
    settles_in = time_constant(plant)
    wanted = usual_period(settles_in, period)
    if wanted == period:
        return []
    return [
        f"The rows are {period:g} s apart, but {plant.title} settles within {settles_in:.3g} s: --period "
        f"{wanted:g} would do; windows of as many samples then last long enough, and fits are faster."
    ]


def with_titles(table: Table, source: SignalSource) -> SignalSource:
    """The source with the table's own titles; a single text with commas may be several columns."""
    places = source.places
    if len(places) == 1 and "," in places[0]:
        try:
            places = (table.find(places[0]),)
        except RecordingError:
            places = source.separate
    return replace(source, places=tuple(map(table.find, places)))


def require_columns(
    table: Table, signal_map: SignalMap, needed: Sequence[str] = (OUTPUT, INPUT)
) -> None:
    """Check that a map has these signals, and times or the distance of the rows.

    Raises:
        RecordingError: something is missing.
    """
    missing = [signal for signal in needed if signal not in signal_map.sources]
    if signal_map.period is None and TIME not in signal_map.sources:
        missing = [TIME, *missing]
    if missing:
        msg = (
            f"{table.path}: no column is mapped to {' and none to '.join(missing)}; "
            f"add --map {' '.join(f'{signal}=COLUMN' for signal in missing)}; "
            f"its columns are {table.titles}{_words_in(table)}"
        )
        without_times = ". If the table has no times and its rows are equally far apart, give --period SECONDS instead"
        raise RecordingError(msg + (without_times if TIME in missing else ""))


def _words_in(table: Table) -> str:
    """What to map for columns of words, such as HEAT and IDLE, in words; empty if there are none."""
    hints = []
    for title, cells in table.texts.items():
        words = sorted({text.strip() for text in cells.values()} - {""})
        if not 1 <= len(words) <= _FEW_WORDS:
            continue
        unknown = []
        for word in words:
            try:
                written_number(word)
            except UnreadableError:
                unknown.append(word)
        place = "; ".join([title, *(f"{word}=NUMBER" for word in unknown)])
        hints.append(
            f"{title!r} holds words ({', '.join(words)}), and is mapped as 'SIGNAL={place}'"
        )
    return "".join(f"; {hint}" for hint in hints)


def _signals_to_read(
    table: Table, plant: type[Plant], signal_map: SignalMap
) -> tuple[dict[str, PlantSignal], list[str]]:
    """The plant's signals that are taken from the table, and notes on those that are not there.

    Raises:
        RecordingError: a column that is needed is not mapped.
    """
    loop = LoopNames.of(plant)
    sources = signal_map.sources
    require_columns(table, signal_map, (*loop.outputs, *loop.inputs))
    outputs = plant.outputs.values()
    signals = {}
    notes = []
    for name, output in zip(loop.outputs, outputs, strict=True):
        signals[name] = PlantSignal("reading", output.unit, *output.readable)
    for name, drive in zip(loop.inputs, plant.drives.values(), strict=True):
        signals[name] = PlantSignal("held", drive.unit, *drive.limits)
    has_references = _has_references(loop, sources)
    if has_references:
        for name, output in zip(loop.references, outputs, strict=False):
            signals[name] = PlantSignal("set", output.unit)
    for name, disturbance in plant.disturbances.items():
        if name in sources:
            signals[name] = PlantSignal("reading", disturbance.unit)
        else:
            value = f"{disturbance.default:g} {disturbance.unit}".strip()
            notes.append(
                f"{name} is not in the table: the plant's default, {value}, is used."
            )
    if not has_references:
        notes.append(
            "The table has no set-point: the loop is treated as unknown, the twin is driven by the input."
        )
    return signals, notes


def _has_references(loop: LoopNames, sources: Mapping[str, SignalSource]) -> bool:
    """Whether all set-points are mapped.

    Raises:
        RecordingError: some are, others not.
    """
    mapped = [name for name in loop.references if name in sources]
    missing = [name for name in loop.references if name not in sources]
    if mapped and missing:
        raise RecordingError(
            f"--map: {mapped[0]} is given, but not {missing[0]}; give all set-points, or none"
        )
    return bool(mapped)


def times_of(table: Table, source: SignalSource | None, period: float | None) -> Times:
    """The times in a column of a table, or of a date and a time of day in two; without one, those of rows
    equally far apart.

    Raises:
        RecordingError: they cannot be read, or another clock of the table disagrees.
    """
    if source is None:
        return row_times(len(table.lines), period or 1.0)
    if len(source.places) == 2:
        return read_date_and_time(table, *source.places)
    if len(source.places) > 2:
        raise RecordingError(
            f"--map time={source.text}: names several columns; give one for time, or one for the date and "
            "one for the time of day"
        )
    times = read_times(table, source.places[0], source.unit, source.scale)
    if _is_unconfirmed(source):
        require_agreement(table, source.places[0], times)
    return times


def in_rows(
    table: Table,
    sources: Mapping[str, SignalSource],
    kinds: Mapping[str, Kind],
    times: Times,
) -> tuple[Table, Times]:
    """The table and its times with all signals in each row; of stacked series, those of the first signal.

    `kinds` has the signals that are read, and what is between two values of each; the first is an output.
    """
    if not isinstance(table, SeriesTable):
        return table, times
    kinds_by_title = {}
    for signal, kind in kinds.items():
        for title in sources[signal].places:
            if title not in table.places_of:
                raise RecordingError(
                    f"{table.path}: {title!r} is none of its series; {signal} needs one"
                )
            kinds_by_title[title] = kind
    return table.at_rows_of(next(iter(kinds_by_title)), kinds_by_title, times)


def without_means_of(
    kinds: Mapping[str, Kind], begin_again: Container[str]
) -> dict[str, Kind]:
    """What is between two values of each signal, as long as the turns of some are not counted: between 359 and
    1 there is no mean of them."""
    return {
        signal: "set" if signal in begin_again else kind
        for signal, kind in kinds.items()
    }


def _with_turns_counted(
    plant: type[Plant], values: Mapping[str, FloatArray], turns: Mapping[str, float]
) -> dict[str, FloatArray]:
    """The signals in the plant's unit, shape (N,) each, with their turns; set-points in those of their outputs."""
    loop = LoopNames.of(plant)
    counted = dict(values)
    for signal, turn in turns.items():
        if signal in values and signal not in loop.references:
            counted[signal] = counted_on(values[signal], turn)
    for reference, output in zip(loop.references, loop.outputs, strict=False):
        if reference in values and reference in turns:
            counted[reference] = all_beside(
                values[reference], counted[output], turns[reference]
            )
    return counted


def _is_unconfirmed(source: SignalSource) -> bool:
    """Whether nobody has said what a column of times counts."""
    return len(source.places) == 1 and not source.unit and source.scale == 1.0


def notes_on_times(
    table: Table, source: SignalSource | None, times: Times
) -> list[str]:
    """Notes on how times were read, and on a second clock that nobody can judge."""
    notes = []
    if times.order:
        notes.append(f"The dates are read as {times.order}.")
    if source is not None and _is_unconfirmed(source):
        notes += unlabelled_clocks(table, source.places[0], times)
    return notes


def _values(
    table: Table, source: SignalSource, signal: str, plant_signal: PlantSignal
) -> FloatArray:
    """A signal in the plant's unit, shape (N,)."""
    changes = []
    for title in source.places:
        stated = table.unit(title)
        # other text in brackets is a remark
        stated = stated if measure(stated).known else ""
        try:
            changes.append(source.change(signal, title, plant_signal.unit, stated))
        except SamplingError as error:
            raise RecordingError(f"{table.path}: {error}") from None
    values = source.value(
        [without_marks(table.values(title)) for title in source.places], changes
    )
    return np.append(values[1:], values[-1:]) if source.interval == "before" else values


def without_marks(values: FloatArray) -> FloatArray:
    """A column with nan where a logger wrote -999 or the like for "no value", shape (N,).

    Such a number is a mark if no other reading comes near it: none is less than half of it.
    """
    finite = values[np.isfinite(values)]
    is_mark = np.isin(finite, _MARKS)
    if not is_mark.any() or is_mark.all():
        return values
    least_reading = finite[~is_mark].min()
    if least_reading < 0.5 * float(finite[is_mark].max()):
        return values
    return np.where(np.isin(values, _MARKS), np.nan, values)


def without_impossible(values: FloatArray, unit: str) -> FloatArray:
    """A column of temperatures with nan below absolute zero, which nothing measures, shape (N,).

    In kelvin it may be a difference of temperatures, which is kept.
    """
    if not measure(unit).offset:
        return values
    kelvin = conversion(unit, "K")
    with np.errstate(invalid="ignore", over="ignore"):
        is_impossible = values * kelvin.scale + kelvin.offset < 0.0
    return np.where(is_impossible, np.nan, values)


def notes_on_impossible(
    table: Table, signal: str, before: FloatArray, after: FloatArray
) -> list[str]:
    """A note on values that `without_impossible` has taken out of a signal, shape (N,) each."""
    rows = np.flatnonzero(np.isfinite(before) & np.isnan(after))
    if not rows.size:
        return []
    first = int(rows[0])
    return [
        f"{signal} is below absolute zero in {rows.size} rows, {before[first]:g} in {table.row_name(first)} "
        "first: nothing has read that."
    ]


def check_range(
    table: Table,
    signal: str,
    plant_signal: PlantSignal,
    values: FloatArray,
    used_rows: np.ndarray | None = None,
) -> list[str]:
    """Refuse values outside the plant's range; keep a few odd readings as those of a failed sensor, which the
    health monitor detects.

    The values are in the plant's unit, shape (N,); `used_rows` is None if all are used.

    Returns:
        A note on odd readings.

    Raises:
        RecordingError: values are outside the range.
    """
    if used_rows is None:
        used_rows = np.arange(values.size)
    low = plant_signal.low
    high = plant_signal.high
    slack = 1e-9 * max(abs(low), abs(high)) if math.isfinite(high - low) else 0.0
    outside = used_rows[
        (values[used_rows] < low - slack) | (values[used_rows] > high + slack)
    ]
    if not outside.size:
        return []
    first = int(outside[0])
    further = f" (and in {outside.size - 1} more)" if outside.size > 1 else ""
    bounds = (
        "limits of its drive" if plant_signal.kind == "held" else "span of its output"
    )
    words = (
        f"{signal} is {values[first]:g} {plant_signal.unit}{further}, beyond the {bounds}, "
        f"{low:g} to {high:g}"
    )
    if (
        plant_signal.kind == "reading"
        and outside.size <= _FAILED_SENSOR_SHARE * used_rows.size
    ):
        return [
            f"In {table.row_name(first)}, {words}; kept as readings of a failed sensor."
        ]
    raise RecordingError(
        f"{table.place(first)}: {words}; {_hint(signal, plant_signal, values[used_rows])}"
    )


def _all_in_range(values: FloatArray, plant_signal: PlantSignal) -> bool:
    return bool(((values >= plant_signal.low) & (values <= plant_signal.high)).all())


def _hint(signal: str, plant_signal: PlantSignal, values: FloatArray) -> str:
    """What to write into the map: the first unit or factor with which all values are in the plant's range."""
    for unit in ("K", "degF", "mV", "mA", "mW", "kW", "ms", "min", ""):
        try:
            change = conversion(unit, plant_signal.unit)
        except TwinmatchError:
            continue
        with np.errstate(over="ignore"):
            converted = values * change.scale + change.offset
        if change != Conversion() and _all_in_range(converted, plant_signal):
            return f"if the column is in {unit or 'parts of one'}, write '{signal}=COLUMN; unit={unit or 1}'"
    for scale in (0.01, 100.0, 1e-3, 1e3, 100 / 255, 1 / 255):
        with np.errstate(over="ignore"):  # of damaged files
            converted = values * scale
        if converted.max() > 0.2 * plant_signal.high and _all_in_range(
            converted, plant_signal
        ):
            return (
                f"if it is in another unit, write '{signal}=COLUMN; scale={scale:.6g}'"
            )
    return "map another column, give its unit, or widen the plant's range if the values are right"


def _samples(plant: type[Plant], resampled: Resampled, start: int) -> list[Sample]:
    """Samples whose first is stamped `start`, ns since 1970."""
    loop = LoopNames.of(plant)
    columns = dict(resampled.columns)
    # Without set-points the twin is driven by the inputs and ignores the references, which must be finite.
    for reference, output in zip(loop.references, loop.outputs, strict=True):
        columns.setdefault(reference, np.full(resampled.index.size, columns[output][0]))
    for name, disturbance in plant.disturbances.items():
        columns.setdefault(name, np.full(resampled.index.size, disturbance.default))
    size = resampled.index.size
    rows = zip(
        resampled.index.tolist(),
        _stamps(resampled, start).tolist(),
        *(_rows(columns, names, size) for names in loop),
        _rows(columns, list(plant.disturbances), size),
        strict=True,
    )
    return [Sample(*row) for row in rows]


def _rows(
    columns: Mapping[str, FloatArray], names: Sequence[str], size: int
) -> list[Signals]:
    """The values of these columns by row; `size` is the number of rows, also of no columns."""
    values = np.array([columns[name] for name in names]).reshape(len(names), size)
    return list(map(tuple, values.T.tolist()))


def _stamps(resampled: Resampled, start: int) -> NDArray[np.int64]:
    """Stamps of the samples, ns since 1970, shape (M,).

    After a clock was set back, that of the session does not go back: the stretch begins as many periods after
    the one before as the indices skip, and all later ones are put off as much.
    """
    period = resampled.period
    stamps = np.empty(resampled.index.size, dtype=np.int64)
    put_off = 0
    for stretch in resampled.stretches:
        first = stretch.start
        begin = (
            start
            + round(float(resampled.time[first] - resampled.time[0]) * 1e9)
            + put_off
        )
        if first and begin <= stamps[first - 1]:
            skipped = int(resampled.index[first] - resampled.index[first - 1])
            follows = int(stamps[first - 1]) + round(skipped * period * 1e9)
            put_off += follows - begin
            begin = follows
        stamps[stretch] = [
            begin + round(k * period * 1e9) for k in range(stretch.stop - first)
        ]
    return stamps
