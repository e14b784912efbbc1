"""The signals of a bag as samples of a plant: one row per reading of its first output, with what acted on
the plant there.

Times are those of the headers, and those of the bag where messages have none. Headers that share another
clock, as that of a simulator, count for all: the time constants of the plant are in it. Where a clock was set
back, a new stretch begins. A signal that arrives periodically is not held across a hole in its messages.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics import Plant
from twinmatch.importing.bags import Bag, Series, open_bag
from twinmatch.importing.mapped import Mapped, map_samples
from twinmatch.importing.resampling import Gaps, bridged_up_to, held_means, usual_step
from twinmatch.importing.tables import Table
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.names import LoopNames, by_signal, signals_of
from twinmatch.sampling.sources import OUTPUT, TIME, FollowedSignal, SignalMap, SignalSource
from twinmatch.sessions.files import ProgressCallback, RecordingError
from twinmatch.signals import FloatArray

_ASTRAY: Final = 1.0
"""Clocks that differ by more, s, are different ones."""
_RATE: Final = 0.01
"""Clocks whose rates differ by more, relatively, do not go alike."""
_BACK: Final = 3.0
"""Steps back in time by so many usual steps are those of a clock; shorter ones are messages out of order."""
_APART: Final = 1e7
"""Time between two stretches while they are put one after another, s; no hole is half as long."""
_FEWEST: Final = 10
"""Fewest messages that can be called periodic."""
_MOST: Final = 0.9
"""Share of the steps of a periodic signal that are no longer than usual."""
_REGULAR: Final = 1.5
"""Longer steps, in usual ones, are not."""


class _Signal(NamedTuple):
    time: FloatArray
    """s, increasing, shape (N,)."""
    values: FloatArray


def map_bag(
    path: Path,
    given: SignalMap,
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
    sources, loop = by_signal(plant, given.sources), LoopNames.of(plant)
    if TIME in sources:
        raise RecordingError("--map time: a bag has the times of its messages; leave it out")
    for name in (*loop.outputs, *loop.inputs):
        if name not in sources:
            msg = f"{path}: no topic is mapped to {name}; add --map {name}=TOPIC:FIELD (--list shows them)"
            raise RecordingError(msg)
    with open_bag(path) as bag:
        recorded, followed = _read(bag, plant, sources, progress)
        counted = bag.notes
    times, notes = _one_clock(recorded)
    signals, lost, stretches = _signals(path, loop, recorded, followed, times)
    known, more = _known(path, loop, signals, sources, longest=longest, gaps=gaps)
    used = int(known.sum())
    if used < 2:
        rows = sources[loop.outputs[0]].text
        raise RecordingError(f"{path}: fewer than two readings of {rows} follow the first input; check --map")
    columns = _columns(loop, signals, known, longest)
    columns[TIME] = stretches.taken_back(columns[TIME])
    table = Table(path, columns, (np.flatnonzero(known) + 1).tolist(), "reading")
    # The values are in the plant's units.
    named = {name: SignalSource((name,), "s" if name == TIME else "") for name in columns}
    given = SignalMap(named, given.plant, given.period)
    run = map_samples(table, given, plant, longest=longest, gaps=gaps)
    read = {name: held[0].values.size for name, held in recorded.items()}
    return run._replace(
        sources=sources, notes=[*run.notes, *counted, *notes, _account(read, loop, used, [*lost, *more])]
    )


def _read(
    bag: Bag, plant: type[Plant], sources: Mapping[str, SignalSource], progress: ProgressCallback | None
) -> tuple[dict[str, list[Series]], dict[str, FollowedSignal]]:
    """What was recorded of each signal, and how it becomes one in the plant's unit."""
    known, followed, recorded = signals_of(plant), {}, {}
    channels = {name: source.channels(name) for name, source in sources.items()}
    read = iter(bag.series([one for each in channels.values() for one in each], progress=progress))
    for name, source in sources.items():
        recorded[name] = held = [next(read) for _ in channels[name]]
        checked = [Channel(c.topic, s.path) for c, s in zip(channels[name], held, strict=True)]
        try:
            followed[name] = source.follow(name, known[name].unit, checked, [s.kind for s in held])
        except SamplingError as error:
            raise RecordingError(f"{bag.path}: {error}") from None
    return recorded, followed


def _one_clock(recorded: Mapping[str, Sequence[Series]]) -> tuple[dict[str, list[FloatArray]], list[str]]:
    """The times of all messages by one clock, s, in the order of recording, and a note on another clock."""
    every = [one for held in recorded.values() for one in held]
    stamped = [one for one in every if np.isfinite(one.stamped).any()]
    off = max((_median(one.logged - one.stamped) for one in stamped), default=0.0)
    stand_ins, notes = {id(one): one.logged for one in every}, []
    if off > _ASTRAY:
        guide = max(stamped, key=lambda one: np.isfinite(one.stamped).sum())
        known, passed = np.isfinite(guide.stamped), _passed(every)
        at, stamps = passed[id(guide)][known], guide.stamped[known]
        said = {id(one): np.interp(passed[id(one)], at, stamps) for one in every}
        alike = max(_median(one.stamped - said[id(one)]) for one in stamped) <= _ASTRAY
        if alike and np.unique(stamps).size > stamps.size / 2:
            stand_ins, rate = said, float(np.ptp(stamps) / max(np.ptp(at), 1e-9))
            pace = f", {rate:.3g} times as fast" if abs(rate - 1) > _RATE else ""
            notes.append(
                f"The headers share a clock of their own, which counts: {off:.3g} s from the bag's{pace}."
            )
        else:
            notes.append(
                f"The headers have clocks of their own, up to {off:.3g} s from that of the bag; the times of "
                "the bag are used instead."
            )
            return {name: [one.logged for one in held] for name, held in recorded.items()}, notes
    return {
        name: [np.where(np.isfinite(one.stamped), one.stamped, stand_ins[id(one)]) for one in held]
        for name, held in recorded.items()
    }, notes


def _median(apart: FloatArray) -> float:
    return float(np.median(np.abs(apart[np.isfinite(apart)])))


def _passed(every: Sequence[Series]) -> dict[int, FloatArray]:
    """Time of recording of all messages, s, without the steps of a clock that was set back."""
    place, first = np.unique(np.concatenate([one.place for one in every]), return_index=True)
    logged = np.concatenate([one.logged for one in every])[first]
    passed = np.append(0.0, np.cumsum(np.maximum(np.diff(logged), 0.0)))
    return {id(one): np.interp(one.place, place, passed) for one in every}


def _signals(
    path: Path,
    loop: LoopNames,
    recorded: Mapping[str, list[Series]],
    followed: Mapping[str, FollowedSignal],
    times: Mapping[str, list[FloatArray]],
) -> tuple[dict[str, _Signal], list[tuple[int, str]], _Stretches]:
    """Signals in the plant's units; how many messages of the first output are not used, in words; and
    the stretches, which are put one after another."""
    held = {name: list(zip(recorded[name], times[name], strict=True)) for name in recorded}
    every = [(one.place, time) for each in held.values() for one, time in each]
    stretches = _Stretches.of(every, times[loop.outputs[0]][0])
    signals, lost = {}, {}
    for name, each in held.items():
        rising = []
        for one, time in each:
            signal, lost[name] = _growing(path, name, stretches.put(one.place, time), one.values)
            rising.append(signal)
        first = rising[0]  # whose times are those of the signal
        values = [first.values, *(np.interp(first.time, o.time, o.values) for o in rising[1:])]
        signals[name] = _Signal(first.time, followed[name].value(values))
    return signals, lost[loop.outputs[0]], stretches


class _Stretches(NamedTuple):
    """The stretches between the moments at which the clock was set back, put one after another."""

    places: FloatArray
    """Place of the first message of each."""
    begins: FloatArray
    """Time at which each begins, s, put so that it follows the one before."""
    shifts: FloatArray
    """What that adds to its times, s."""

    @classmethod
    def of(cls, messages: Sequence[tuple[FloatArray, FloatArray]], rows: FloatArray) -> _Stretches:
        """Find them in places and times of the messages of each channel; `rows` are the readings' times.

        A clock that is set back shows in each topic between two of its messages. As few moments are taken as
        explain all of them.
        """
        places, usual = [-math.inf], usual_step(np.diff(rows))
        spans = [span for place, time in messages for span in _steps_back(place, time, usual)]
        for after, until in sorted(spans, key=lambda span: span[1]):
            if places[-1] <= after:
                places.append(until)
        place, time = (np.concatenate(both) for both in zip(*messages, strict=True))
        of, shifts, begins = np.searchsorted(places, place, side="right") - 1, [0.0], [-math.inf]
        for k in range(1, len(places)):
            begins.append(float(time[of == k - 1].max()) + shifts[-1] + _APART)
            shifts.append(begins[-1] - float(time[of == k].min()))
        return cls(np.array(places), np.array(begins), np.array(shifts))

    def put(self, place: FloatArray, time: FloatArray) -> FloatArray:
        """The times of messages at these places where their stretches are put."""
        return np.asarray(time + self.shifts[np.searchsorted(self.places, place, side="right") - 1])

    def taken_back(self, time: FloatArray) -> FloatArray:
        """The times of the clock, of times in stretches that are put one after another."""
        return np.asarray(time - self.shifts[np.searchsorted(self.begins, time, side="right") - 1])


def _steps_back(place: FloatArray, time: FloatArray, row: float) -> Iterator[tuple[float, float]]:
    """Places between which the clock was set back: two messages in a row are far before the one before."""
    if time.size < 3:
        return
    low = time[:-2] - _BACK * max(usual_step(np.diff(time)), row)
    for k in np.flatnonzero((time[1:-1] < low) & (time[2:] < low)).tolist():
        yield float(place[k]), float(place[k + 1])


def _growing(
    path: Path, name: str, time: FloatArray, values: FloatArray
) -> tuple[_Signal, list[tuple[int, str]]]:
    """Numbers with rising times, and how many messages gave none, in words.

    Messages are sorted by time, since some arrive out of order; of several at one time the last is kept.
    """
    kept = np.isfinite(values)
    if not kept.any():
        raise RecordingError(f"{path}: no message of {name} has a number; map another field")
    order = np.argsort(time[kept], kind="stable")
    rising = _Signal(time[kept][order], values[kept][order])
    last = np.append(np.diff(rising.time) > 0, True)
    lost = (
        (values.size - int(kept.sum()), "without a number"),
        (int((~last).sum()), "at a time of another"),
    )
    return _Signal(rising.time[last], rising.values[last]), [(count, why) for count, why in lost if count]


def _known(
    path: Path,
    loop: LoopNames,
    signals: Mapping[str, _Signal],
    sources: Mapping[str, SignalSource],
    *,
    longest: float | None,
    gaps: Gaps,
) -> tuple[NDArray[np.bool_], list[tuple[int, str]]]:
    """Which readings have all other signals, and how many have not, in words.

    Raises:
        RecordingError: a signal that arrives periodically has a hole that is to be refused.
    """
    rows, *others = loop.outputs
    time, needed = signals[rows].time, [*loop.inputs, *loop.references, *others]
    known = time >= max(signals[name].time[0] for name in needed if name in signals)
    what = "input, set-point or other output" if others else "input or set-point"
    lost = [(int((~known).sum()), f"before the first {what}")]
    for name in (n for n in signals if n not in {rows, *loop.references}):  # set-points apply until the next
        text = f"{name} ({sources[name].text})"
        unknown = np.zeros_like(known)
        for begin, end in _holes(signals[name].time, time, longest):
            inside = known & (time > begin) & (time < end)
            unknown |= inside
            last = min(end, float(time[-1]))
            if gaps == "refuse" and inside.any() and last - begin < _APART / 2:
                raise RecordingError(
                    f"{path}: {text} has no message for {last - begin:.4g} s from reading "
                    f"{int(np.flatnonzero(inside)[0]) + 1} on: split the recording there (--gaps split), or "
                    f"hold its last value (--bridge {math.ceil(last - begin) + 1})"
                )
        lost.append((int(unknown.sum()), f"in holes of {text}"))
        known &= ~unknown
    return known, lost


def _holes(time: FloatArray, rows: FloatArray, longest: float | None) -> Iterator[tuple[float, float]]:
    """Where the messages of a signal stay away: from one usual step after the last one to the next one.

    A signal without a usual step is published when it changes, and applies until then.
    """
    steps, row = np.diff(time), usual_step(np.diff(rows))
    if time.size < _FEWEST:
        return
    usual = usual_step(steps)
    if np.quantile(steps, _MOST) > max(_REGULAR * usual, bridged_up_to(rows)):
        return
    usual = max(usual, row)
    limit = bridged_up_to(np.array([0.0, usual]), longest)
    ends = np.append(time[1:], math.inf)
    for k in np.flatnonzero(np.append(steps, rows[-1] - time[-1]) > limit).tolist():
        yield float(time[k]) + usual, float(ends[k])


def _columns(
    loop: LoopNames, signals: Mapping[str, _Signal], known: NDArray[np.bool_], longest: float | None
) -> dict[str, FloatArray]:
    """Columns of a table by signal, for the readings that are known."""
    rows = loop.outputs[0]
    time = signals[rows].time[known]
    columns = {TIME: time, rows: signals[rows].values[known]}
    for name, signal in signals.items():
        if name in loop.inputs:
            columns[name] = _means(signal, time, longest)
        elif name in loop.references:
            columns[name] = signal.values[np.searchsorted(signal.time, time, side="right") - 1]
        elif name != rows:
            columns[name] = np.interp(time, signal.time, signal.values)
    return columns


def _means(signal: _Signal, time: FloatArray, longest: float | None) -> FloatArray:
    """Mean of the held signal from each time to the next; before a gap and at the end, over a median step."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    ends = np.append(time[1:], time[-1] + usual)
    wide = np.flatnonzero(steps > bridged_up_to(time, longest))
    ends[wide] = time[wide] + usual
    return held_means(signal.time, signal.values, time, ends, ends - time)


def _account(read: Mapping[str, int], loop: LoopNames, used: int, lost: Sequence[tuple[int, str]]) -> str:
    """What became of the messages that were read, in a sentence."""
    rows = loop.outputs[0]
    others = ", ".join(f"{count} of {name}" for name, count in read.items() if name != rows)
    left = ", ".join(f"{count} {why}" for count, why in lost if count)
    return (
        f"Of {read[rows]} messages of {'the output' if rows == OUTPUT else rows}, {used} are used"
        + (f" (left out: {left})" if left else "")
        + f"; read beside them: {others}."
    )
