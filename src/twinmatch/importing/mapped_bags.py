"""The signals of a bag as samples of a plant: one row per reading of its first output, with what acted on
the plant there.

Times are by one clock, that of the headers if they share one. Where it was set back, a new stretch begins.
A signal that arrives periodically is not held across a hole in its messages.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics import Plant
from twinmatch.importing.bag_clocks import Times, times_by_one_clock
from twinmatch.importing.bags import Bag, Series, open_bag
from twinmatch.importing.mapped import Mapped, map_samples, turns_in
from twinmatch.importing.resampling import Gaps, usual_step
from twinmatch.importing.stretches import APART, PlacedTimes, Stretches
from twinmatch.importing.tables import Table
from twinmatch.importing.timed_signals import Hole, Loss, TimedSignal, rising_signal
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.names import LoopNames, by_signal, signals_of
from twinmatch.sampling.sources import (
    OUTPUT,
    TIME,
    FollowedSignal,
    SignalMap,
    SignalSource,
)
from twinmatch.sampling.turns import counted_on
from twinmatch.sessions.files import ProgressCallback, RecordingError
from twinmatch.signals import FloatArray


def map_bag(
    path: Path,
    signal_map: SignalMap,
    plant: type[Plant],
    *,
    longest: float | None = None,
    gaps: Gaps = "refuse",
    progress: ProgressCallback | None = None,
) -> Mapped:
    """The samples of a plant from a bag.

    The arguments are those of `map_samples`, with the folder of the bag in place of a table, and topics and
    fields in place of columns; `progress` is called with the number of messages read and their total.

    Raises:
        RecordingError: as `open_bag`, `Bag.series` and `map_samples`; a signal that is not mapped.
    """
    sources = by_signal(plant, signal_map.sources)
    loop = LoopNames.of(plant)
    _require_mapped(path, loop, sources)
    with open_bag(path) as bag:
        recorded = _recorded(bag, sources, progress)
        followed = _followed(bag, plant, sources, recorded)
        bag_notes = bag.notes
    times, clock_notes = times_by_one_clock(recorded)
    placed = _placed(recorded, times)
    step_of_readings = usual_step(np.diff(times[loop.outputs[0]][0]))
    stretches = Stretches.of(
        list(chain.from_iterable(placed.values())), step_of_readings
    )
    times_in_stretches = {}
    for name, channels in placed.items():
        times_in_stretches[name] = [stretches.put(channel) for channel in channels]
    signals, losses = _signals(path, loop, recorded, followed, times_in_stretches)
    signals = _with_turns_counted(path, plant, sources, signals)
    rows = _Rows(path, loop, signals, sources)
    is_used, row_losses = rows.with_all_signals(longest, gaps)
    table = _table(path, rows.columns(is_used, longest), is_used, stretches)
    run = map_samples(
        table, _own_map(table, signal_map), plant, longest=longest, gaps=gaps
    )
    counts = {name: channels[0].values.size for name, channels in recorded.items()}
    account = _account(counts, loop, int(is_used.sum()), [*losses, *row_losses])
    return run._replace(
        sources=sources, notes=[*run.notes, *bag_notes, *clock_notes, account]
    )


def _require_mapped(
    path: Path, loop: LoopNames, sources: Mapping[str, SignalSource]
) -> None:
    if TIME in sources:
        raise RecordingError(
            "--map time: a bag has the times of its messages; leave it out"
        )
    for name in (*loop.outputs, *loop.inputs):
        if name not in sources:
            msg = f"{path}: no topic is mapped to {name}; add --map {name}=TOPIC:FIELD (--list shows them)"
            raise RecordingError(msg)


def _recorded(
    bag: Bag, sources: Mapping[str, SignalSource], progress: ProgressCallback | None
) -> dict[str, list[Series]]:
    """What was recorded of the channels of each signal; the bag is read once for all of them."""
    channels = {name: source.channels(name) for name, source in sources.items()}
    all_channels = list(chain.from_iterable(channels.values()))
    all_series = iter(bag.series(all_channels, progress=progress))
    recorded = {}
    for name, of_signal in channels.items():
        recorded[name] = list(islice(all_series, len(of_signal)))
    return recorded


def _followed(
    bag: Bag,
    plant: type[Plant],
    sources: Mapping[str, SignalSource],
    recorded: Mapping[str, Sequence[Series]],
) -> dict[str, FollowedSignal]:
    """How what was recorded becomes each signal, in the plant's unit."""
    plant_signals = signals_of(plant)
    followed = {}
    for name, source in sources.items():
        series_of_signal = recorded[name]
        asked = source.channels(name)
        channels = [
            Channel(c.topic, s.path)
            for c, s in zip(asked, series_of_signal, strict=True)
        ]
        kinds = [series.kind for series in series_of_signal]
        try:
            followed[name] = source.follow(
                name, plant_signals[name].unit, channels, kinds
            )
        except SamplingError as error:
            raise RecordingError(f"{bag.path}: {error}") from None
    return followed


def _placed(
    recorded: Mapping[str, Sequence[Series]], times: Times
) -> dict[str, list[PlacedTimes]]:
    """The times by one clock of the messages of each channel, with their places in the bag."""
    placed = {}
    for name, of_signal in recorded.items():
        pairs = zip(of_signal, times[name], strict=True)
        placed[name] = [
            PlacedTimes(series.place, series_times) for series, series_times in pairs
        ]
    return placed


def _signals(
    path: Path,
    loop: LoopNames,
    recorded: Mapping[str, Sequence[Series]],
    followed: Mapping[str, FollowedSignal],
    times: Times,
) -> tuple[dict[str, TimedSignal], list[Loss]]:
    """Signals in the plant's units, and which messages of the first output are not used.

    A signal that is computed from several channels has the times of the first one. Of those that a formula
    takes, whole numbers, such as a mode, apply until the next: there is no mode 1.5 between 1 and 2.
    """
    signals = {}
    losses: dict[str, list[Loss]] = {}
    for name, of_signal in recorded.items():
        channels = []
        for series, series_times in zip(of_signal, times[name], strict=True):
            numbers = followed[name].source.without_missing(series.values)
            channel, losses[name] = rising_signal(path, name, series_times, numbers)
            channels.append(channel)
        first, *further = channels
        is_computed = bool(followed[name].source.formula)
        values = [first.values]
        for channel in further:
            is_held = is_computed and channel.is_whole
            values.append(
                channel.held(first.times)
                if is_held
                else channel.interpolated(first.times)
            )
        computed = followed[name].values(values, first.times)
        is_number = np.isfinite(computed)  # a rate has none at its first message
        signals[name] = TimedSignal(first.times[is_number], computed[is_number])
    return signals, losses[loop.outputs[0]]


def _with_turns_counted(
    path: Path,
    plant: type[Plant],
    sources: Mapping[str, SignalSource],
    signals: Mapping[str, TimedSignal],
) -> dict[str, TimedSignal]:
    """The signals, those that begin again with their turns: between 359 and 1 nothing can be interpolated.

    Set-points are only held; they get the turns of their outputs once both are in one row.

    Raises:
        RecordingError: such a signal is the mean of several channels.
    """
    counted = dict(signals)
    for name, turn in turns_in(path, plant, sources).items():
        if name not in LoopNames.of(plant).references:
            signal = signals[name]
            counted[name] = TimedSignal(signal.times, counted_on(signal.values, turn))
    return counted


class _Rows(NamedTuple):
    """The readings of the first output, each with the other signals at its time."""

    path: Path
    loop: LoopNames
    signals: Mapping[str, TimedSignal]
    sources: Mapping[str, SignalSource]

    @property
    def output(self) -> str:
        return self.loop.outputs[0]

    @property
    def times(self) -> FloatArray:
        return self.signals[self.output].times

    def with_all_signals(
        self, longest: float | None, gaps: Gaps
    ) -> tuple[NDArray[np.bool_], list[Loss]]:
        """Which readings have all other signals, shape (N,), and how many lack one, by reason.

        Raises:
            RecordingError: a signal that arrives periodically has a hole that is to be refused, or fewer
                than two readings have all signals.
        """
        is_used = self.times >= self._all_begun()
        losses = [
            Loss(int((~is_used).sum()), f"before the first {self._others_in_words()}")
        ]
        for name, signal in self.signals.items():
            if name == self.output or name in self.loop.references:
                # set-points apply until the next
                continue
            is_in_hole = np.zeros_like(is_used)
            for hole in signal.holes(self.times, longest):
                is_inside = (
                    is_used & (self.times > hole.begin) & (self.times < hole.end)
                )
                if gaps == "refuse" and is_inside.any():
                    self._refuse(name, hole, int(np.flatnonzero(is_inside)[0]))
                is_in_hole |= is_inside
            losses.append(
                Loss(int(is_in_hole.sum()), f"in holes of {self._described(name)}")
            )
            is_used &= ~is_in_hole
        if is_used.sum() < 2:
            text = self.sources[self.output].text
            msg = f"{self.path}: fewer than two readings of {text} follow the first input; check --map"
            raise RecordingError(msg)
        return is_used, losses

    def _all_begun(self) -> float:
        """The time at which all other signals of the loop have a value, s."""
        _, *other_outputs = self.loop.outputs
        needed = (*self.loop.inputs, *self.loop.references, *other_outputs)
        return max(
            float(self.signals[name].times[0])
            for name in needed
            if name in self.signals
        )

    def _others_in_words(self) -> str:
        if len(self.loop.outputs) > 1:
            return "input, set-point or other output"
        return "input or set-point"

    def _described(self, name: str) -> str:
        return f"{name} ({self.sources[name].text})"

    def _refuse(self, name: str, hole: Hole, reading: int) -> None:
        """Refuse a hole, unless the clock was set back in it, which the rows then show as a gap."""
        seconds = min(hole.end, float(self.times[-1])) - hole.begin
        if seconds >= APART / 2:
            return
        raise RecordingError(
            f"{self.path}: {self._described(name)} has no message for {seconds:.4g} s from reading "
            f"{reading + 1} on: split the recording there (--gaps split), or "
            f"hold its last value (--bridge {math.ceil(seconds) + 1})"
        )

    def columns(
        self, is_used: NDArray[np.bool_], longest: float | None
    ) -> dict[str, FloatArray]:
        """Columns of a table by signal, for the readings that are used."""
        times = self.times[is_used]
        columns = {TIME: times, self.output: self.signals[self.output].values[is_used]}
        for name, signal in self.signals.items():
            if name in self.loop.inputs:
                columns[name] = signal.means(times, longest)
            elif name in self.loop.references:
                columns[name] = signal.newest(times)
            elif name != self.output:
                columns[name] = signal.interpolated(times)
        return columns


def _table(
    path: Path,
    columns: Mapping[str, FloatArray],
    is_used: NDArray[np.bool_],
    stretches: Stretches,
) -> Table:
    """A table of these columns with the times of the clock, whose lines are the numbers of the readings."""
    by_clock = {**columns, TIME: stretches.taken_back(columns[TIME])}
    readings = (np.flatnonzero(is_used) + 1).tolist()
    return Table(path, by_clock, readings, "reading")


def _own_map(table: Table, signal_map: SignalMap) -> SignalMap:
    """The map of a table whose columns have the names of signals and are in the plant's units."""
    columns = {
        name: SignalSource((name,), "s" if name == TIME else "")
        for name in table.columns
    }
    return SignalMap(columns, signal_map.plant, signal_map.period)


def _account(
    counts: Mapping[str, int], loop: LoopNames, used: int, losses: Sequence[Loss]
) -> str:
    """What became of the messages that were read, in a sentence."""
    output = loop.outputs[0]
    output_in_words = "the output" if output == OUTPUT else output
    counts_beside = ", ".join(
        f"{count} of {name}" for name, count in counts.items() if name != output
    )
    left_out = ", ".join(
        f"{loss.messages} {loss.why}" for loss in losses if loss.messages
    )
    without = f" (left out: {left_out})" if left_out else ""
    return (
        f"Of {counts[output]} messages of {output_in_words}, {used} are used{without}; "
        f"read beside them: {counts_beside}."
    )
