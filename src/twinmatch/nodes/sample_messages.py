"""Stamps, and samples as messages.

In a message every signal is an array, so that a plant with two inputs needs no other message type. A twin
runs one loop: a message without exactly one reference, one output and one input is refused.
"""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time

from twinmatch.signals import Sample, SignalError, not_one_loop
from twinmatch_msgs import msg as messages

NANOSECONDS = 1_000_000_000
LOOP = ("reference", "output", "input")
"""The signals of a loop, without disturbances."""


def time_message(stamp: int) -> Time:
    """A stamp (ns) as a message."""
    seconds, rest = divmod(stamp, NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def nanoseconds(stamp: Any) -> int:
    """A ROS time stamp in nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def stamped(message: Any, stamp: int) -> Any:
    """The message, with a stamp (ns) in its header."""
    message.header.stamp = time_message(stamp)
    return message


def sample_message(sample: Sample, frame: str = "plate") -> messages.LoopSample:
    """A sample as `LoopSample`."""
    message = messages.LoopSample(
        index=sample.index,
        disturbances=list(sample.disturbances),
        **{name: [getattr(sample, name)] for name in LOOP},
    )
    message.header.frame_id = frame
    return stamped(message, sample.stamp)


def sample_from(message: messages.LoopSample) -> Sample:
    """A sample from `LoopSample`.

    Raises:
        SignalError: it does not have exactly one reference, one output and one input.
    """
    loop = [getattr(message, name) for name in LOOP]
    lengths = [len(values) for values in loop]
    if lengths != [1, 1, 1]:
        raise SignalError(not_one_loop(message.index, lengths))
    (reference,), (output,), (entry,) = loop
    stamp = nanoseconds(message.header.stamp)
    return Sample(message.index, stamp, reference, output, entry, tuple(message.disturbances))


def one_of(message: Any, name: str) -> float:
    """The single value of an array in a message about one loop.

    Raises:
        SignalError: there is not exactly one value.
    """
    values = getattr(message, name)
    if len(values) != 1:
        raise SignalError(
            f"{name} of sample {message.index} has {len(values)} values; a twin runs one loop, with one value"
        )
    return float(values[0])
