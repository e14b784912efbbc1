"""What messages from damaged parts of a file are worth.

A message that no checksum confirms may have any content: a time in the next century, an index out of order, a
value that is not a number, or too few bytes. The messages around it tell: a sample that does not lie in their
line is left out, and so is what cannot be decoded; a time of recording that cannot be right is replaced.
A value that is wrong by little stays, and its message stays marked.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from itertools import pairwise
from typing import Final

from twinmatch.sessions.cdr import current, decode_sample, decoded
from twinmatch.sessions.files import SessionError
from twinmatch.sessions.messages import SAMPLE, Message
from twinmatch.settings import Rule
from twinmatch.signals import NANOSECONDS, Sample

AROUND: Final = 64
"""Sound messages before and after a damaged part that are compared with it."""
_MOST: Final = 1000
"""Messages that are compared at once."""


class Neighbours(Rule):
    """What a message or sample is compared with, and how far from it a time is wrong."""

    on_each_side: int = 15
    far: float = 4.0
    """Distance from their median in median deviations: at the end of a regular row it is two."""


_NEIGHBOURS: Final = Neighbours()
_DECODED: Final = ("cdr", "ros2msg")


def _median(values: Iterable[float]) -> float:
    """The median; what computes it is loaded only where a file is damaged."""
    from statistics import median  # noqa: PLC0415

    return median(values)


def mended(
    messages: Iterable[Message], on_drop: Callable[[], None]
) -> Iterator[Message]:
    """The messages, without those of damaged parts that cannot be right; `on_drop` is called for each.

    Messages that are sound are not changed.
    """
    before: deque[Message] = deque(maxlen=AROUND)
    waiting: list[Message] = []
    behind = 0
    for message in messages:
        if message.is_sound and not waiting:
            before.append(message)
            yield message
            continue
        waiting.append(message)
        behind = behind + 1 if message.is_sound else 0
        if behind == AROUND or len(waiting) == _MOST:
            yield from _released(before, waiting, on_drop)
            before.extend(waiting)
            waiting = []
            behind = 0
    yield from _released(before, waiting, on_drop)


def _released(
    before: Iterable[Message], waiting: Sequence[Message], on_drop: Callable[[], None]
) -> Iterator[Message]:
    """The waiting messages that can be right."""
    if not waiting:
        return
    context = list(before)
    row = _with_times(context + list(waiting))
    wrong = _undecodable(row) | _out_of_line(row)
    for number in range(len(context), len(row)):
        if number in wrong:
            on_drop()
        else:
            yield row[number]


def _with_times(row: Sequence[Message]) -> list[Message]:
    """The messages; a time of recording that cannot be right becomes that of the message before."""
    times = [message.log_time for message in row]
    result: list[Message] = []
    for number, message in enumerate(row):
        if message.is_sound or not _is_far(times, number):
            result.append(message)
            continue
        time_before = result[-1].log_time if result else int(_median(times))
        result.append(message._replace(log_time=time_before, publish_time=time_before))
    return result


def _around(number: int) -> slice:
    """The places of a message and its neighbours in a row."""
    side = _NEIGHBOURS.on_each_side
    return slice(max(0, number - side), number + side + 1)


def _is_far(times: Sequence[int], number: int) -> bool:
    near = times[_around(number)]
    middle = _median(near)
    spread = _median(abs(time - middle) for time in near)
    return abs(times[number] - middle) > _NEIGHBOURS.far * spread + NANOSECONDS


def _undecodable(row: Sequence[Message]) -> set[int]:
    """Places of unsound messages that are not what their topic's definition says."""
    wrong = set()
    for number, message in enumerate(row):
        if (
            message.is_sound
            or (message.topic.encoding, message.topic.language) != _DECODED
        ):
            continue
        try:
            decoded(message)
        except SessionError:
            wrong.add(number)
    return wrong


def _out_of_line(row: Sequence[Message]) -> set[int]:
    """Places of unsound samples whose index, stamp or values cannot be right, topic by topic."""
    wrong: set[int] = set()
    topics = {
        message.topic.name for message in row if message.topic.type == SAMPLE.type
    }
    for name in topics:
        samples: dict[int, Sample] = {}
        for number, message in enumerate(row):
            if message.topic.name != name:
                continue
            sample = _sample_of(message)
            if sample is not None:
                samples[number] = sample
            elif not message.is_sound:
                wrong.add(number)
        in_line = _in_line(
            samples, {number for number in samples if row[number].is_sound}
        )
        wrong |= samples.keys() - in_line
    return wrong


def _sample_of(message: Message) -> Sample | None:
    """The sample in a message; None if it cannot be decoded or has a value that is not finite."""
    try:
        sample = decode_sample(current(message).data)
    except SessionError:
        return None
    values = (*sample.references, *sample.outputs, *sample.inputs, *sample.disturbances)
    return sample if all(map(math.isfinite, values)) else None


def _in_line(samples: Mapping[int, Sample], sound: Set[int]) -> set[int]:
    """The places of the samples that are sound, or whose stamp and index agree with those around them."""
    places = list(samples)
    period = _usual_period([samples[place] for place in places])
    begins = [samples[place].stamp - samples[place].index * period for place in places]
    shapes = [samples[place].shape for place in places]
    likely: list[int] = []
    trusted: set[int] = set()
    last = -1
    for number, place in enumerate(places):
        near = _around(number)
        if place in sound:
            trusted |= _rising(likely, samples, last, samples[place].index)
            trusted.add(place)
            likely = []
            last = samples[place].index
        elif len(places) == 1 or (
            abs(begins[number] - _median(begins[near])) < period / 2
            and shapes[number] == max(shapes[near], key=shapes[near].count)
        ):
            likely.append(place)
    return trusted | _rising(likely, samples, last, None)


def _rising(
    places: Sequence[int], samples: Mapping[int, Sample], above: int, below: int | None
) -> set[int]:
    """As many of the places as possible at which the indices rise, within these bounds: a sample that a
    damage has moved costs itself only."""
    tails: list[int] = []
    rows: list[list[int]] = []
    for place in places:
        index = samples[place].index
        if index <= above or (below is not None and index >= below):
            continue
        number = bisect_left(tails, index)
        row = [*rows[number - 1], place] if number else [place]
        tails[number : number + 1] = [index]
        rows[number : number + 1] = [row]
    return set(rows[-1]) if rows else set()


def _usual_period(samples: Sequence[Sample]) -> float:
    """The median time from one index to the next, ns; 1 s if it cannot be determined."""
    steps = [
        (after.stamp - before.stamp) / (after.index - before.index)
        for before, after in pairwise(samples)
        if after.index > before.index
    ]
    period = _median(steps) if steps else 0.0
    return period if period > 0 else float(NANOSECONDS)
