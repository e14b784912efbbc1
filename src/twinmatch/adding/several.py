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
    Signal,
    around_of,
    by_names_in_file,
    centre_of,
    disturbance_signals,
    is_signal,
    lag_of_answer,
    note_on_integration,
    note_on_period,
    notes_on_table,
    on_one_clock,
    range_of,
    round_out,
    rounded,
    signal_name,
    signal_values,
    unit_of,
    without_spikes,
)
from twinmatch.importing.mapped import require_columns, times_of, with_titles
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
    names = _NamesByRole.of(signal_map)
    require_columns(table, signal_map, (*names.outputs, *names.inputs))
    sources = {
        name: with_titles(table, source) for name, source in signal_map.sources.items()
    }
    times = times_of(table, sources.get("time"), signal_map.period)
    resampled, bridge = on_one_clock(table, sources, times, signal_map.period, longest)
    names_in_file: list[str] = []
    inputs = []
    for name in names.inputs:
        unit = unit_of(table, sources, name)
        limits = range_of(signal_values(table, sources, name))
        inputs.append(Signal(signal_name(sources, name, names_in_file), unit, *limits))
    disturbances = disturbance_signals(
        table, sources, names.disturbances, resampled, names_in_file
    )
    longest_stretch = max(
        resampled.stretches, key=lambda stretch: stretch.stop - stretch.start
    )
    columns = {
        name: column[longest_stretch] for name, column in resampled.columns.items()
    }
    surroundings = [
        around_of(unit_of(table, sources, name), disturbances, columns)
        for name in names.outputs
    ]
    centres = _centres_of(inputs, surroundings)
    drives = [
        _Drive(columns[name] - centre, u.low - centre, u.high - centre)
        for name, u, centre in zip(names.inputs, inputs, centres, strict=True)
    ]
    measured = [columns[name] for name in names.disturbances]
    outputs = []
    for name, around in zip(names.outputs, surroundings, strict=True):
        unit = unit_of(table, sources, name)
        signal = Signal(signal_name(sources, name, names_in_file), unit, 0.0, 0.0)
        outputs.append(
            _lagged(
                signal,
                columns[name],
                drives,
                measured,
                period=resampled.period,
                around=around,
            )
        )
    duration = columns[names.outputs[0]].size * resampled.period
    fastest = min(lag_of_answer(y.lag, duration, rests=y.rests) for y in outputs)
    period = signal_map.period or usual_period(fastest, resampled.period)
    return SeveralProposal(
        outputs=tuple(outputs),
        inputs=tuple(inputs),
        centres=centres,
        disturbances=tuple(disturbances.values()),
        period=period,
        sources=by_names_in_file(signal_map, disturbances),
        table=table.path.name,
        split=bool(resampled.gaps),
        bridge=bridge,
        notes=(
            *notes_on_table(table, sources, times),
            *_notes_on_integration(outputs, inputs),
            *note_on_period(fastest, resampled.period, period),
        ),
    )


def _centres_of(
    inputs: Sequence[Signal], surroundings: Sequence[Around | None]
) -> tuple[float, ...]:
    """The levels from which the effects of inputs are counted.

    They are 0 where a disturbance says what an output tends to without inputs.
    """
    if any(surroundings):
        return (0.0,) * len(inputs)
    return tuple(centre_of((u.low, u.high)) for u in inputs)


class _NamesByRole(NamedTuple):
    """The names in a map by what they are."""

    outputs: list[str]
    inputs: list[str]
    disturbances: list[str]

    @classmethod
    def of(cls, signal_map: SignalMap) -> _NamesByRole:
        """Those of a map; an output and an input are needed, whether it has them or not."""
        names = list(signal_map.sources)
        outputs = [name for name in names if is_signal(name, "output")] or ["output"]
        inputs = [name for name in names if is_signal(name, "input")] or ["input"]
        references = [name for name in names if is_signal(name, "reference")]
        others = {"time", *outputs, *inputs, *references}
        return cls(outputs, inputs, [name for name in names if name not in others])


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
    signal: Signal,
    reading: FloatArray,
    drives: Sequence[_Drive],
    measured: Sequence[FloatArray],
    *,
    period: float,
    around: Around | None,
) -> LaggedOutput:
    """The lag of one output, of its readings, shape (N,), and what moves it: inputs and disturbances."""
    commanded = [drive.values for drive in drives]
    noise = noise_of(reading, [*commanded, *measured])
    quiet = without_spikes(reading, noise)
    excess = quiet if around is None else quiet - around.values
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
    low, high = round_out(low, high)
    return LaggedOutput(
        signal._replace(low=low, high=high),
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
