"""Conversion of messages recorded with older definitions.

Only samples are converted: playing or judging a session needs nothing else. Recorded verdicts and matches are
decoded with the definitions in the file where they are compared.
"""

from __future__ import annotations

from functools import lru_cache

from twinmatch.sessions.cdr import decode_scalar_sample, encode_sample
from twinmatch.sessions.definitions import LOOP_SAMPLE, SCALAR_SAMPLE, fields_of
from twinmatch.sessions.topics import Message, Topic

__all__ = ["current", "current_topic"]


@lru_cache(maxsize=64)
def current_topic(topic: Topic) -> Topic:
    """The topic with the current definition of its messages; unchanged if it is current or unknown."""
    if topic.type == LOOP_SAMPLE.name and fields_of(topic.schema) == list(SCALAR_SAMPLE):
        return Topic.of(topic.name, LOOP_SAMPLE, topic.qos)
    return topic


def current(message: Message) -> Message:
    """Convert a message to the current definition.

    Raises:
        SessionError: the message does not match the definition in its file.
    """
    topic = current_topic(message.topic)
    if topic == message.topic:
        return message
    sample, frame = decode_scalar_sample(message.data)
    return message._replace(topic=topic, data=encode_sample(sample, frame))
