"""A first-order model of an unknown plant, estimated from a table of its signals.

Gain and lag are those of the difference equation y[k+1] − y[k] = a + b·y[k] + c·u[k] (and
disturbances), by least squares over blocks of samples long enough to move further than the noise.
"""

from __future__ import annotations

import keyword
import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from twinmatch.adding.blocks import models_of_blocks
from twinmatch.adding.held_input import begun_at_rest, is_held
from twinmatch.adding.noise import noise_of
from twinmatch.dynamics import Plant
from twinmatch.importing.mapped import (
    in_rows,
    notes_on_impossible,
    notes_on_times,
    require_columns,
    times_of,
    with_titles,
    without_impossible,
    without_marks,
)
from twinmatch.importing.resampling import (
    Kind,
    Resampled,
    complete_rows,
    repeated,
    resample,
    second_pace,
    usual_period,
)
from twinmatch.importing.tables import Table, split_title
from twinmatch.importing.times import Times
from twinmatch.sampling.sources import SignalMap, SignalSource
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray
from twinmatch.units import is_unit, measure

_SPIKE: Final = 10.0
"""Distance from the median of its neighbours, in noises, from which a reading is a spike."""
_FEWEST_BLOCKS: Final = 20
"""Fewest blocks of rows from which a model is estimated."""
_MOST: Final = 1e100
"""Size from which squares of values are not numbers any longer."""
_KNOWN: Final = ("time", "output", "input", "reference")
_ROLES: Final = {"output": "measured", "input": "drive"}
"""Names of these signals where the table calls them by the name of another one, as PID libraries do."""
_RANGES: Final = (
    (0.0, 1.0),
    (0.0, 100.0),
    (-1.0, 1.0),
    (-100.0, 100.0),
    (0.0, 255.0),
    (-255.0, 255.0),
)
"""Usual ranges of a drive's command."""
_OF_AN_INTEGRATOR: Final = 1.0 / 50.0
"""Share of a recording that stands for the time in which an output answers that moves on as long as its input
acts: a recording shows some ten movements or more."""
_BEYOND: Final = 0.05
"""A command may go beyond a usual range by this share of it, as that of a controller without limits does."""
_OFFSET_UNITS: Final = {
    "degc": "°C",
    "c": "°C",
    "°c": "°C",
    "celsius": "°C",
    "degf": "°F",
    "sec": "s",
}


class Signal(NamedTuple):
    """A signal of the proposed plant."""

    name: str
    unit: str
    low: float
    high: float
    text: str = ""


@dataclass(frozen=True)
class Proposal:
    """Numbers for a first plant file."""

    output: Signal
    input: Signal
    disturbances: tuple[Signal, ...]
    noise: float
    """Standard deviation of the output's noise."""
    period: float
    """Sampling period, s."""
    gain: float
    """Steady-state gain: output per unit of the input."""
    lag: float
    """Time constant, s."""
    rest: float
    """Steady-state output with the input at its centre, where no disturbance determines it."""
    sources: dict[str, SignalSource]
    """By signal, with the names of this plant; empty without a table."""
    centre: float = 0.0
    """The level of the input from which its effect is counted; 0, unless it stays far from that, as one in
    kelvin does."""
    table: str = ""
    """Name of the table's file."""
    has_reference: bool = False
    held: bool = False
    """Whether the drive stood at one level for nearly all of the time, so that gain and rest rest on the
    assumption that the output rested at its first readings."""
    switched: bool = False
    """Whether the input only switches between two levels."""
    assumed: bool = False
    """Whether nothing is recorded, so that the lag is what its owner says."""
    split: bool = False
    """Whether the table has gaps, or a clock that was set back."""
    bridge: float | None = None
    """Longest step between rows that is to be interpolated, s; None: the usual one."""
    notes: tuple[str, ...] = ()
    """Sentences on how the table was read, for the user."""

    @property
    def thermal(self) -> bool:
        """Whether the output is a temperature."""
        return measure(self.output.unit).dimension == (("[temperature]", 1.0),)

    @property
    def around(self) -> Signal | None:
        """The disturbance that the output tends to without input: the first one of the output's kind."""
        return next(
            (d for d in self.disturbances if alike(d.unit, self.output.unit)), None
        )


def is_signal(name: str, role: str) -> bool:
    """Whether a name in a map is that of an output, an input or a reference, such as `input` or `input.2`."""
    return re.fullmatch(rf"{role}(\.\d+)?", name) is not None


def alike(first: str, second: str) -> bool:
    """Whether two units measure the same quantity."""
    return measure(first).dimension == measure(second).dimension


def example() -> Proposal:
    """A proposal without a table: a heated block in a room with measured temperature."""
    return Proposal(
        output=Signal("temperature", "°C", -20.0, 150.0, "temperature of the block"),
        input=Signal("heater", "%", 0.0, 100.0, "heater"),
        disturbances=(Signal("room", "°C", 10.0, 30.0, "temperature of the room"),),
        noise=0.1,
        period=1.0,
        gain=0.6,
        lag=120.0,
        rest=20.0,
        sources={},
    )


def propose(
    table: Table, signal_map: SignalMap, *, longest: float | None = None
) -> Proposal:
    """Estimate the numbers for a first plant file from a table.

    Args:
        table: the table.
        signal_map: columns of time, output and input; every other name is a disturbance.
        longest: longest step between rows that is interpolated, s; judged by the rows if not given.
    """
    require_columns(table, signal_map)
    sources = {
        name: with_titles(table, source) for name, source in signal_map.sources.items()
    }
    times = times_of(table, sources.get("time"), signal_map.period)
    resampled, bridge = on_one_clock(table, sources, times, signal_map.period, longest)
    disturbance_names = [name for name in signal_map.sources if name not in _KNOWN]
    reading = resampled.columns["output"]
    output_unit = unit_of(table, sources, "output")
    drive = signal_values(table, sources, "input")
    drive_range = range_of(drive)
    names_in_file: list[str] = []
    output_name = signal_name(sources, "output", names_in_file)
    input_name = signal_name(sources, "input", names_in_file)
    disturbances = disturbance_signals(
        table, sources, disturbance_names, resampled, names_in_file
    )
    around = around_of(output_unit, disturbances, resampled.columns)
    centre = 0.0 if around is not None else centre_of(drive_range)
    noise, model = _estimated(resampled, disturbance_names, centre)
    if around is not None:
        model = model._replace(rest=float(around.values.mean()))
    duration = reading.size * resampled.period
    lag_of_period = lag_of_answer(model.lag, duration, rests=model.rests)
    period = signal_map.period or usual_period(lag_of_period, resampled.period)
    drive_from_centre = [limit - centre for limit in drive_range]
    output_range = _output_range(reading, drive_from_centre, model)
    return Proposal(
        output=Signal(output_name, output_unit, *output_range),
        input=Signal(input_name, unit_of(table, sources, "input"), *drive_range),
        disturbances=tuple(disturbances.values()),
        noise=noise,
        period=period,
        gain=model.gain,
        lag=model.lag,
        rest=model.rest,
        centre=centre,
        sources=by_names_in_file(signal_map, disturbances),
        table=table.path.name,
        has_reference="reference" in signal_map.sources,
        held=not disturbance_names and is_held(resampled.columns["input"]),
        switched=np.unique(drive[np.isfinite(drive)]).size == 2,
        split=bool(resampled.gaps),
        bridge=bridge,
        notes=(
            *notes_on_table(table, sources, times),
            *_notes_on_integration(model, output_name, input_name),
            *note_on_period(lag_of_period, resampled.period, period),
        ),
    )


class Around(NamedTuple):
    """What an output tends to without inputs, and its values, shape (N,)."""

    signal: Signal
    values: FloatArray


def around_of(
    unit: str, disturbances: Mapping[str, Signal], columns: Mapping[str, FloatArray]
) -> Around | None:
    """The first disturbance of the kind of an output with this unit; None without one."""
    for name, disturbance in disturbances.items():
        if alike(disturbance.unit, unit):
            return Around(disturbance, columns[name])
    return None


def disturbance_signals(
    table: Table,
    sources: Mapping[str, SignalSource],
    names: Sequence[str],
    resampled: Resampled,
    names_in_file: list[str],
) -> dict[str, Signal]:
    """The disturbances of a plant by their names in the map, with the ranges that they had; the names that
    they get are added to those in the file."""
    disturbances = {}
    for name in names:
        values = resampled.columns[name]
        unit = unit_of(table, sources, name)
        disturbances[name] = Signal(
            word(name, names_in_file), unit, float(values.min()), float(values.max())
        )
    return disturbances


def by_names_in_file(
    signal_map: SignalMap, disturbances: Mapping[str, Signal]
) -> dict[str, SignalSource]:
    """The sources of a map with the names that disturbances have in the file."""
    sources = {}
    for name, source in signal_map.sources.items():
        sources[disturbances[name].name if name in disturbances else name] = source
    return sources


def notes_on_table(
    table: Table, sources: Mapping[str, SignalSource], times: Times
) -> tuple[str, ...]:
    """How a table was read."""
    of_times = notes_on_times(table, sources.get("time"), times)
    return (*table.notes, *notes_on_readings(table, sources), *of_times)


def lag_of_answer(lag: float, duration: float, *, rests: bool) -> float:
    """The time in which an output answers, s: its `lag`, unless the recording, which lasts `duration` s, does
    not show it. A lag that is not known says nothing of how fast an output answers."""
    return lag if rests else duration * _OF_AN_INTEGRATOR


def _notes_on_integration(model: _FirstOrder, output: str, drive: str) -> list[str]:
    """A note where the output seems to move on as long as the input acts."""
    if model.rests:
        return []
    return [note_on_integration(output, [drive], model.lag, "inner")]


def note_on_integration(
    output: str, drives: Sequence[str], lag: float, state: str
) -> str:
    """A note on an output that seems to move on as long as what drives it acts; `state` is its state."""
    constant, acting = "constant inputs", "its inputs act"
    if len(drives) == 1:
        constant, acting = f"a constant {drives[0]}", f"{drives[0]} acts"
    return (
        f"The recording does not show at which level {output} would rest under {constant}: the lag of "
        f"{lag:.3g} s is a guess. If {output} moves on as long as {acting}, as an angle does, write its "
        f"rate without `- self.{state}`."
    )


def note_on_period(lag: float, row_period: float, period: float) -> list[str]:
    """A note where the sampling period is not that of the rows, or should not be."""
    wanted = usual_period(lag, row_period)
    if wanted == row_period:
        return []
    rows = f"The rows are {row_period:g} s apart, the plant's time constant is about {lag:.3g} s"
    if period == row_period:
        return [f"{rows}: --period {wanted:g} would do, and make windows long enough."]
    return [f"{rows}: a period of {period:g} s is written; --period gives another."]


def on_one_clock(
    table: Table,
    sources: Mapping[str, SignalSource],
    times: Times,
    period: float | None,
    longest: float | None,
) -> tuple[Resampled, float | None]:
    """All signals on one clock, from the rows that have all of them, and the longest step that is bridged, s.

    Raises:
        RecordingError: the rows cannot be resampled, or values are too large for squares.
    """
    names = sorted(
        (name for name in sources if name != "time"),
        key=lambda name: not is_signal(name, "output"),
    )
    kinds: dict[str, Kind] = dict.fromkeys(names, "reading")
    for name in names:
        if is_signal(name, "input"):
            kinds[name] = "held"
        elif is_signal(name, "reference"):
            kinds[name] = "set"
    table, times = in_rows(table, sources, kinds, times)
    signals = {name: signal_values(table, sources, name) for name in names}
    _require_usual_sizes(table, signals)
    columns = (times.seconds, *signals.values())
    rows = complete_rows(*columns)
    if rows.size < 2:
        raise RecordingError(
            f"{table.path}: fewer than two rows have a value of {', '.join(names)}"
        )
    rows = np.setdiff1d(rows, repeated(rows, *columns))
    bridge = second_pace(times.seconds[rows]) if longest is None else longest
    resampled = resample(
        times.seconds[rows],
        {name: values[rows] for name, values in signals.items()},
        kinds,
        period,
        longest=bridge,
        gaps="split",
        place=str(table.path),
        row=lambda i: table.row_name(int(rows[i])),
    )
    return resampled, bridge


def _require_usual_sizes(table: Table, signals: Mapping[str, FloatArray]) -> None:
    """Refuse values too large for squares, in any row: limits are taken from all of them."""
    for name, values in signals.items():
        largest = np.abs(values[~np.isnan(values)]).max(initial=0.0)
        if not largest < _MOST:
            raise RecordingError(
                f"{table.path}: {name} reaches {largest:g}; correct its values"
            )


class _FirstOrder(NamedTuple):
    """A first-order model."""

    gain: float
    lag: float
    """s"""
    rest: float
    """Steady-state output without input, or with it at its centre."""
    rests: bool = True
    """Whether the samples show that it tends to a steady state."""


def _estimated(
    resampled: Resampled, disturbances: Sequence[str], centre: float
) -> tuple[float, _FirstOrder]:
    """The output's noise and the model, from the longest stretch: across a gap there are no rates.

    The rest of the model is that with the input at its centre.
    """
    longest = max(resampled.stretches, key=lambda stretch: stretch.stop - stretch.start)
    reading = resampled.columns["output"][longest]
    drive = resampled.columns["input"][longest] - centre
    disturbance_columns = [resampled.columns[name][longest] for name in disturbances]
    noise = noise_of(reading, [drive, *disturbance_columns])
    free_of_spikes = without_spikes(reading, noise)
    model = _first_order(
        free_of_spikes, drive, disturbance_columns, noise, resampled.period
    )
    if not disturbances and is_held(drive):
        model = _begun_at_rest(free_of_spikes, drive, model)
    return noise, model


def _begun_at_rest(
    reading: FloatArray, drive: FloatArray, model: _FirstOrder
) -> _FirstOrder:
    """The model with the gain and the rest of a plant that rested at its first readings."""
    levels, counts = np.unique(drive, return_counts=True)
    final = model.rest + model.gain * float(levels[np.argmax(counts)])
    parted = begun_at_rest(reading, drive, final)
    return (
        model
        if parted is None
        else _rounded_model(parted.gain, model.lag, parted.rest, rests=model.rests)
    )


def _output_range(
    reading: FloatArray, drive_range: Sequence[float], model: _FirstOrder
) -> tuple[float, float]:
    """Round numbers around all readings and steady states, as far beyond them as the readings go.

    The range of the drive is that about its centre.
    """
    span = float(np.ptp(reading)) or 1.0
    steady = [model.rest, *(model.rest + model.gain * limit for limit in drive_range)]
    low = min(float(reading.min()), *steady)
    high = max(float(reading.max()), *steady)
    return round_out(low - span, high + span)


def signal_values(
    table: Table, sources: Mapping[str, SignalSource], signal: str
) -> FloatArray:
    """The mean of the columns of a signal, in their unit, shape (N,); nan where there is no reading."""
    source = sources[signal]
    columns = [
        source.scale * without_marks(table.values(title)) + source.offset
        for title in source.places
    ]
    mean = np.asarray(np.mean(columns, axis=0), dtype=np.float64)
    return without_impossible(mean, unit_of(table, sources, signal))


def notes_on_readings(table: Table, sources: Mapping[str, SignalSource]) -> list[str]:
    """Notes on columns with values below absolute zero."""
    notes: list[str] = []
    for signal, source in sources.items():
        if signal != "time":
            unit = unit_of(table, sources, signal)
            for title in source.places:
                values = without_marks(table.values(title))
                scaled = source.scale * values + source.offset
                notes += notes_on_impossible(
                    table, signal, values, without_impossible(scaled, unit)
                )
    return notes


def signal_name(
    sources: Mapping[str, SignalSource], signal: str, names_in_file: list[str]
) -> str:
    """A name after the signal's column."""
    title, _ = split_title(sources[signal].places[0])
    role = signal.partition(".")[0]
    if title.lower() in _KNOWN and title.lower() != role:
        title = _ROLES[role]
    says_something = re.search(r"[a-zA-Z]{2}|[a-zA-Z]_?\d", title)
    return word(title if says_something else signal, names_in_file)


def unit_of(table: Table, sources: Mapping[str, SignalSource], signal: str) -> str:
    """The unit of a signal by its map or its title; empty where neither has one."""
    source = sources[signal]
    unit = source.unit or table.unit(source.places[0])
    unit = _OFFSET_UNITS.get(unit.lower(), unit)
    return unit if is_unit(unit) else ""


def word(title: str, names_in_file: list[str]) -> str:
    """A valid Python name that does not yet occur in the file."""
    # as Python reads names
    text = unicodedata.normalize("NFKC", split_title(title)[0].strip().lower())
    plain = "".join(c if f"_{c}".isidentifier() else " " for c in text)
    plain = re.sub(r"[\s_]+", "_", plain).strip("_") or "signal"
    plain = plain if plain.isidentifier() else f"n{plain}"
    reserved = {
        *vars(Plant),
        *Plant.__annotations__,
        "gain",
        "lag",
        "rest",
        "inner",
        "seen",
        "sensor_lag",
    }
    reserved |= {"acting", *(f"acting_{k}" for k in range(4)), "dead_time"}
    reserved |= {"store", "store_lag", "store_share"}
    while (
        keyword.iskeyword(plain)
        or plain in names_in_file
        or plain in reserved - {"output"}
    ):
        plain += "_"
    names_in_file.append(plain)
    return plain


def centre_of(drive_range: tuple[float, float]) -> float:
    """The level from which the effect of an input is counted: 0, or its middle if 0 is farther than its range.

    An effect counted from far away hardly shows apart from a rest.
    """
    low, high = drive_range
    distance = max(low, -high, 0.0)
    return rounded((low + high) / 2) if distance > high - low else 0.0


def range_of(values: FloatArray) -> tuple[float, float]:
    """A usual range, widened a little where the values go beyond it; otherwise round numbers around them.

    `values` has shape (N,), nan without one.
    """
    low = float(np.nanmin(values))
    high = float(np.nanmax(values))
    for least, most in _RANGES:
        slack = _BEYOND * (most - least)
        if (
            least - slack <= low
            and high <= most + slack
            and high > 0.2 * most
            and (low < 0.0) == (least < 0.0)
        ):
            return min(least, low), max(most, high)
    return round_out(low, high) if high > low else (low - 1.0, high + 1.0)


def _first_order(
    reading: FloatArray,
    drive: FloatArray,
    disturbances: Sequence[FloatArray],
    noise: float,
    period: float,
) -> _FirstOrder:
    """The model of the difference equation, of the shortest blocks that show it; a guess if none do."""
    models = models_of_blocks(
        reading, [drive, *disturbances], noise, period, fewest=_FEWEST_BLOCKS
    )
    for model in models:
        gain = model.gains[0]
        if gain != 0.0:
            return _rounded_model(gain, model.lag, model.rest, rests=model.rests)
    span = float(np.ptp(reading)) or 1.0
    reach = float(np.ptp(drive)) or 1.0
    return _rounded_model(span / reach, 0.1 * reading.size * period, float(reading[0]))


def _rounded_model(
    gain: float, lag: float, rest: float, *, rests: bool = True
) -> _FirstOrder:
    return _FirstOrder(rounded(gain), rounded(lag), rounded(rest, 3), rests)


def without_spikes(values: FloatArray, noise: float) -> FloatArray:
    """Readings with the median of five neighbours where one is far from it."""
    from scipy.ndimage import median_filter  # noqa: PLC0415

    middle = median_filter(values, 5, mode="nearest")
    return np.where(np.abs(values - middle) > _SPIKE * noise, middle, values)


def rounded(value: float, digits: int = 2) -> float:
    """To so many digits."""
    return float(f"{value:.{digits}g}")


def round_out(low: float, high: float) -> tuple[float, float]:
    """Round numbers just outside the range."""
    step = 10.0 ** math.floor(math.log10((high - low) / 2)) if high > low else 1.0
    return math.floor(low / step) * step, math.ceil(high / step) * step
