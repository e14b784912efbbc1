"""Convert between samples and their messages, without losing a bit.

In a message every signal is an array, so that a plant with two inputs needs no other message type. A twin
runs one loop: a message without exactly one reference, one output and one input is refused.
"""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Time

from twinmatch.signals import Sample, SignalError, not_one_loop
from twinmatch_msgs import msg as messages

__all__ = ["one_of", "sample_from", "sample_message", "stamp_header"]

NANOSECONDS = 1_000_000_000


def sample_message(sample: Sample, frame: str = "plate") -> messages.LoopSample:
    """A sample as `LoopSample`."""
    message = messages.LoopSample(
        index=sample.index,
        reference=[sample.reference],
        output=[sample.output],
        input=[sample.input],
        disturbances=list(sample.disturbances),
    )
    stamp_header(message.header, sample.stamp)
    message.header.frame_id = frame
    return message


def sample_from(message: messages.LoopSample) -> Sample:
    """A sample from `LoopSample`.

    Raises:
        SignalError: it does not have exactly one reference, one output and one input.
    """
    lengths = [len(message.reference), len(message.output), len(message.input)]
    if lengths != [1, 1, 1]:
        raise SignalError(not_one_loop(message.index, lengths))
    stamp = message.header.stamp
    return Sample(
        message.index,
        stamp.sec * NANOSECONDS + stamp.nanosec,
        message.reference[0],
        message.output[0],
        message.input[0],
        tuple(message.disturbances),
    )


def one_of(message: Any, name: str) -> float:
    """The single value of an array in a message about one loop.

    Raises:
        SignalError: there is not exactly one value.
    """
    values = getattr(message, name)
    if len(values) != 1:
        msg = (
            f"{name} of sample {message.index} has {len(values)} values; a twin runs one loop, with one value"
        )
        raise SignalError(msg)
    return float(values[0])


def stamp_header(header: Any, stamp: int) -> None:
    """Write a stamp in nanoseconds into a header."""
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    header.stamp = Time(sec=seconds, nanosec=nanoseconds)
