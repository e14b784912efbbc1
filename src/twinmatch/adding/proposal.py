"""A first-order model of an unknown plant, estimated from a table of its signals.

Gain and lag are those of the difference equation y[k+1] − y[k] = a + b·y[k] + c·u[k] (and
disturbances), by least squares over blocks of samples long enough to move further than the noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from twinmatch.adding.blocks import models_of_blocks
from twinmatch.adding.held_input import begun_at_rest, is_held
from twinmatch.adding.noise import noise_of
from twinmatch.adding.table_signals import Signal, TableSignals
from twinmatch.importing.resampling import usual_period
from twinmatch.importing.tables import Table
from twinmatch.sampling.sources import SignalMap, SignalSource
from twinmatch.signals import FloatArray
from twinmatch.units import measure

_SPIKE: Final = 10.0
"""Distance from the median of its neighbours, in noises, from which a reading is a spike."""
_FEWEST_BLOCKS: Final = 20
"""Fewest blocks of rows from which a model is estimated."""
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
    signals = TableSignals(table, signal_map, longest=longest)
    resampled = signals.resampled
    output_unit = signals.unit("output")
    drive = signals.values("input")
    drive_range = range_of(drive)
    output_name = signals.name_in_file("output")
    input_name = signals.name_in_file("input")
    disturbances = signals.disturbance_signals()
    around = around_of(output_unit, disturbances, resampled.columns)
    centre = 0.0 if around is not None else centre_of(drive_range)
    noise, model = _estimated(signals, centre)
    if around is not None:
        model = model._replace(rest=float(around.values.mean()))
    reading = resampled.columns["output"]
    duration = reading.size * resampled.period
    lag_of_period = lag_of_answer(model.lag, duration, rests=model.rests)
    period = signal_map.period or usual_period(lag_of_period, resampled.period)
    drive_from_centre = [limit - centre for limit in drive_range]
    output_range = _output_range(reading, drive_from_centre, model)
    return Proposal(
        output=Signal(
            output_name, output_unit, *output_range, turn=signals.turn("output")
        ),
        input=Signal(input_name, signals.unit("input"), *drive_range),
        disturbances=tuple(disturbances.values()),
        noise=noise,
        period=period,
        gain=model.gain,
        lag=model.lag,
        rest=model.rest,
        centre=centre,
        sources=signals.sources_in_file(disturbances),
        table=table.path.name,
        has_reference="reference" in signal_map.sources,
        held=not disturbances and is_held(resampled.columns["input"]),
        switched=np.unique(drive[np.isfinite(drive)]).size == 2,
        split=bool(resampled.gaps),
        bridge=signals.bridge,
        notes=(
            *signals.notes,
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


class _FirstOrder(NamedTuple):
    """A first-order model."""

    gain: float
    lag: float
    """s"""
    rest: float
    """Steady-state output without input, or with it at its centre."""
    rests: bool = True
    """Whether the samples show that it tends to a steady state."""


def _estimated(signals: TableSignals, centre: float) -> tuple[float, _FirstOrder]:
    """The output's noise and the model, with its rest at the input's centre."""
    columns = signals.longest_stretch
    reading = columns["output"]
    drive = columns["input"] - centre
    disturbance_columns = [columns[name] for name in signals.disturbances]
    noise = noise_of(reading, [drive, *disturbance_columns])
    free_of_spikes = without_spikes(reading, noise)
    period = signals.resampled.period
    model = _first_order(free_of_spikes, drive, disturbance_columns, noise, period)
    if not disturbance_columns and is_held(drive):
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
    lag = 0.1 * reading.size * period
    return _rounded_model(span / reach, lag, float(reading[0]), rests=False)


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
