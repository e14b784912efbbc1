"""The times of a bag's messages by one clock.

The time of a message is that of its header or, without one, that at which the bag recorded it. Headers may
share a clock that is not the bag's, such as a simulator's. Then messages without a header get their times by
it, too: the plant moves by that clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from twinmatch.importing.bags import Series
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

__all__ = ["Times", "times_by_one_clock"]

Times = dict[str, list[FloatArray]]
"""By signal, for each of its channels the times of its messages, s, in the order of recording."""


class ClockLikeness(Rule):
    """When two clocks are taken as the same one."""

    offset: float = 1.0
    """Clocks that differ by more, s, are different ones."""
    rate: float = 0.01
    """Clocks whose rates differ by more, relatively, do not go alike."""


_ALIKE: Final = ClockLikeness()
_SHORTEST: Final = 1e-9
"""Shortest time of recording by which a rate is divided, s."""


def times_by_one_clock(
    recorded: Mapping[str, Sequence[Series]],
) -> tuple[Times, list[str]]:
    """The times of all messages by one clock, and a note if the headers have another than the bag."""
    all_series = list(chain.from_iterable(recorded.values()))
    with_stamps = [series for series in all_series if series.has_stamp.any()]
    largest_offset = max(
        (_usual_size(series.logged - series.stamped) for series in with_stamps),
        default=0.0,
    )
    if largest_offset <= _ALIKE.offset:
        return _times(recorded, lambda series: _stamps_or(series.logged, series)), []
    clock = _HeaderClock.of(with_stamps, _RecordingTime.of(all_series))
    if not (clock.moves and clock.is_shared_by(with_stamps)):
        own_clocks_note = (
            f"The headers have clocks of their own, up to {largest_offset:.3g} s from that of the bag; the "
            "times of the bag are used instead."
        )
        return _times(recorded, lambda series: series.logged), [own_clocks_note]
    times = _times(recorded, lambda series: _stamps_or(clock.at(series), series))
    pace = (
        ""
        if abs(clock.rate - 1) <= _ALIKE.rate
        else f", {clock.rate:.3g} times as fast"
    )
    shared_clock_note = (
        "The headers share a clock of their own, which counts: "
        f"{largest_offset:.3g} s from the bag's{pace}."
    )
    return times, [shared_clock_note]


def _times(
    recorded: Mapping[str, Sequence[Series]], times_of: Callable[[Series], FloatArray]
) -> Times:
    """The times that this function gives for every channel."""
    times = {}
    for name, channels in recorded.items():
        times[name] = [times_of(series) for series in channels]
    return times


def _stamps_or(times: FloatArray, series: Series) -> FloatArray:
    """The header stamps, and these times where a message has none."""
    return np.where(series.has_stamp, series.stamped, times)


def _usual_size(differences: FloatArray) -> float:
    """The median size of those differences that are not NaN."""
    return float(np.median(np.abs(differences[np.isfinite(differences)])))


class _RecordingTime(NamedTuple):
    """How long the recording has run at each message, without the steps of a clock that was set back."""

    places: FloatArray
    """Places of the messages, increasing, shape (N,)."""
    passed: FloatArray
    """s, shape (N,)."""

    @classmethod
    def of(cls, all_series: Sequence[Series]) -> _RecordingTime:
        all_places = np.concatenate([series.place for series in all_series])
        all_logged = np.concatenate([series.logged for series in all_series])
        places, first_of_place = np.unique(all_places, return_index=True)
        steps = np.maximum(np.diff(all_logged[first_of_place]), 0.0)
        return cls(places, np.append(0.0, np.cumsum(steps)))

    def at(self, places: FloatArray) -> FloatArray:
        return np.interp(places, self.places, self.passed)


class _HeaderClock(NamedTuple):
    """The clock of the channel that has most header stamps."""

    recording: _RecordingTime
    passed: FloatArray
    """Time of recording of the messages with a stamp, s, shape (M,)."""
    stamps: FloatArray
    """s, shape (M,)."""

    @classmethod
    def of(
        cls, with_stamps: Sequence[Series], recording: _RecordingTime
    ) -> _HeaderClock:
        guide = max(with_stamps, key=lambda series: series.has_stamp.sum())
        stamped = guide.has_stamp
        return cls(
            recording, recording.at(guide.place)[stamped], guide.stamped[stamped]
        )

    @property
    def moves(self) -> bool:
        """Whether most messages have a time of their own."""
        return bool(np.unique(self.stamps).size > self.stamps.size / 2)

    @property
    def rate(self) -> float:
        """Seconds of this clock in a second of recording."""
        return float(np.ptp(self.stamps) / max(np.ptp(self.passed), _SHORTEST))

    def at(self, series: Series) -> FloatArray:
        """Its times of a channel's messages, s."""
        return np.interp(self.recording.at(series.place), self.passed, self.stamps)

    def is_shared_by(self, with_stamps: Sequence[Series]) -> bool:
        """Whether the header stamps of all these channels are of this clock."""
        offsets = [
            _usual_size(series.stamped - self.at(series)) for series in with_stamps
        ]
        return max(offsets) <= _ALIKE.offset
