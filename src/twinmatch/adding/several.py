"""First-order lags of a plant with several outputs or inputs, estimated from a table of its signals.

Each output is taken as a lag of its own that all inputs move: y[k+1] − y[k] = a + b·y[k] + Σ c·u[k] (and
disturbances), by least squares over blocks of samples long enough to move further than the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twinmatch.adding.blocks import BlockModel, models_of_blocks
from twinmatch.adding.noise import noise_of
from twinmatch.adding.proposal import (
    Around,
    around_of,
    centre_of,
    lag_of_answer,
    note_on_integration,
    note_on_period,
    range_of,
    round_out,
    rounded,
    without_spikes,
)
from twinmatch.adding.table_signals import Signal, TableSignals, is_signal, names_of
from twinmatch.importing.resampling import usual_period
from twinmatch.importing.tables import Table
from twinmatch.sampling.sources import SignalMap, SignalSource
from twinmatch.signals import FloatArray

__all__ = ["LaggedOutput", "SeveralProposal", "has_several", "propose_several"]

_FEWEST_BLOCKS = 20
"""Fewest blocks per coefficient of a model."""
_LONGEST_GUESS = 0.5
"""Longest lag that is guessed, as a share of the recording: with longer ones, a rest and the gains of inputs that
are mostly on hardly differ."""


@dataclass(frozen=True)
class LaggedOutput:
    """An output, and the lag that it is taken as."""

    signal: Signal
    noise: float
    gains: tuple[float, ...]
    """Steady-state gain of each input."""
    lag: float
    """Time constant, s."""
    rests: bool
    """Whether the samples show that it tends to a steady state; without that, the lag is a guess."""
    rest: float
    """Steady-state output with the inputs at their centres; with `around`, its excess over that."""
    around: Signal | None
    """The measured disturbance that it tends to without inputs."""


@dataclass(frozen=True)
class SeveralProposal:
    """Numbers for a first file of a plant with several outputs or inputs."""

    outputs: tuple[LaggedOutput, ...]
    inputs: tuple[Signal, ...]
    centres: tuple[float, ...]
    """The level of each input from which its effects are counted; 0, unless it stays far from that."""
    disturbances: tuple[Signal, ...]
    period: float
    """Sampling period, s."""
    sources: dict[str, SignalSource]
    """By signal, with the names of this plant."""
    table: str
    """Name of the table's file."""
    split: bool
    """Whether the table has gaps, or a clock that was set back."""
    bridge: float | None
    """Longest step between rows that is to be interpolated, s; None: the usual one."""
    notes: tuple[str, ...]
    """Sentences on how the table was read, for the user."""


def has_several(signal_map: SignalMap) -> bool:
    """Whether a map has numbered outputs or inputs, such as `input.2`."""
    return any(
        "." in name and is_signal(name, name.partition(".")[0])
        for name in signal_map.sources
    )


def propose_several(
    table: Table, signal_map: SignalMap, *, longest: float | None = None
) -> SeveralProposal:
    """Estimate the numbers for a first plant file from a table.

    Args:
        table: the table.
        signal_map: columns of time, `output.1`, `input.1` and so on; every other name is a disturbance.
        longest: longest step between rows that is interpolated, s; judged by the rows if not given.

    Raises:
        RecordingError: an output or an input is missing, or the table cannot be used.
    """
    output_names = names_of(signal_map, "output") or ["output"]
    input_names = names_of(signal_map, "input") or ["input"]
    needed = (*output_names, *input_names)
    signals = TableSignals(table, signal_map, needed, longest=longest)
    inputs = [_input_signal(signals, name) for name in input_names]
    disturbances = signals.disturbance_signals()
    columns = signals.longest_stretch
    surroundings = [
        around_of(signals.unit(name), disturbances, columns) for name in output_names
    ]
    centres = _centres_of(inputs, surroundings)
    drives = [
        _Drive(columns[name] - centre, u.low - centre, u.high - centre)
        for name, u, centre in zip(input_names, inputs, centres, strict=True)
    ]
    outputs = [
        _lagged(signals, name, drives, around)
        for name, around in zip(output_names, surroundings, strict=True)
    ]
    row_period = signals.resampled.period
    duration = columns[output_names[0]].size * row_period
    fastest = min(lag_of_answer(y.lag, duration, rests=y.rests) for y in outputs)
    period = signal_map.period or usual_period(fastest, row_period)
    return SeveralProposal(
        outputs=tuple(outputs),
        inputs=tuple(inputs),
        centres=centres,
        disturbances=tuple(disturbances.values()),
        period=period,
        sources=signals.sources_in_file(disturbances),
        table=table.path.name,
        split=bool(signals.resampled.gaps),
        bridge=signals.bridge,
        notes=(
            *signals.notes,
            *_notes_on_integration(outputs, inputs),
            *note_on_period(fastest, row_period, period),
        ),
    )


def _input_signal(signals: TableSignals, name: str) -> Signal:
    """An input, with the range of all of its rows."""
    limits = range_of(signals.values(name))
    return Signal(signals.name_in_file(name), signals.unit(name), *limits)


def _centres_of(
    inputs: Sequence[Signal], surroundings: Sequence[Around | None]
) -> tuple[float, ...]:
    """The levels from which the effects of inputs are counted.

    They are 0 where a disturbance says what an output tends to without inputs.
    """
    if any(surroundings):
        return (0.0,) * len(inputs)
    return tuple(centre_of((u.low, u.high)) for u in inputs)


def _notes_on_integration(
    outputs: Sequence[LaggedOutput], inputs: Sequence[Signal]
) -> list[str]:
    """A note for each output that seems to move on as long as its inputs act."""
    drives = [u.name for u in inputs]
    return [
        note_on_integration(output.signal.name, drives, output.lag, f"inner_{number}")
        for number, output in enumerate(outputs, 1)
        if not output.rests
    ]


class _Drive(NamedTuple):
    """An input, counted from its centre."""

    values: FloatArray
    """Shape (N,)."""
    low: float
    high: float


def _lagged(
    signals: TableSignals,
    name: str,
    drives: Sequence[_Drive],
    around: Around | None,
) -> LaggedOutput:
    """The lag of one output, of its readings and what moves it: inputs and disturbances."""
    columns = signals.longest_stretch
    reading = columns[name]
    commanded = [drive.values for drive in drives]
    measured = [columns[disturbance] for disturbance in signals.disturbances]
    noise = noise_of(reading, [*commanded, *measured])
    quiet = without_spikes(reading, noise)
    excess = quiet if around is None else quiet - around.values
    period = signals.resampled.period
    model = _first_order(excess, commanded, noise, period)
    reach = float(np.ptp(reading)) or 1.0
    level = 0.0 if around is None else float(around.values.mean())
    effects = [
        (gain * drive.low, gain * drive.high)
        for gain, drive in zip(model.gains, drives, strict=True)
    ]
    # All inputs may stand at the ends that move the output the same way.
    lowest = level + model.rest + sum(min(ends) for ends in effects)
    highest = level + model.rest + sum(max(ends) for ends in effects)
    low = min(float(reading.min()), lowest) - reach
    high = max(float(reading.max()), highest) + reach
    signal = Signal(
        signals.name_in_file(name),
        signals.unit(name),
        *round_out(low, high),
        turn=signals.turn(name),
    )
    return LaggedOutput(
        signal,
        noise,
        tuple(rounded(gain) for gain in model.gains),
        rounded(model.lag),
        model.rests,
        rounded(model.rest, 3),
        None if around is None else around.signal,
    )


def _first_order(
    output: FloatArray, inputs: Sequence[FloatArray], noise: float, period: float
) -> BlockModel:
    """The model of the difference equation, of the shortest blocks that show it.

    If none do, the gains are a share of the ranges, and the lag a tenth of the recording.
    """
    fewest = _FEWEST_BLOCKS * (2 + len(inputs))
    model = next(models_of_blocks(output, inputs, noise, period, fewest=fewest), None)
    if model is not None:
        longest = _LONGEST_GUESS * output.size * period
        middle = float(output.mean())
        return model if model.rests else model.with_lag(min(model.lag, longest), middle)
    reach = float(np.ptp(output)) or 1.0
    gains = [reach / (float(np.ptp(drive)) or 1.0) / len(inputs) for drive in inputs]
    return BlockModel(gains, 0.1 * output.size * period, float(output[0]), rests=False)
