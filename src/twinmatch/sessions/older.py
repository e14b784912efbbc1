"""Messages of sessions that were recorded with older definitions, as today's.

Samples are all that is translated here: whoever plays or judges a session needs nothing else of it. What a
twin had published is read through the definition in the file by those who compare with it.
"""

from __future__ import annotations

from functools import lru_cache

from twinmatch.sessions.cdr import decode_scalar_sample, encode_sample
from twinmatch.sessions.definitions import LOOP_SAMPLE, SCALAR_SAMPLE, fields_of
from twinmatch.sessions.topics import Message, Topic

__all__ = ["current", "current_topic"]


@lru_cache(maxsize=64)
def current_topic(topic: Topic) -> Topic:
    """The topic with today's definition of its messages; itself if it has that, or an unknown one."""
    if topic.type == LOOP_SAMPLE.name and fields_of(topic.schema) == list(SCALAR_SAMPLE):
        return Topic.of(topic.name, LOOP_SAMPLE, topic.qos)
    return topic


def current(message: Message) -> Message:
    """The message as it would be recorded today.

    Raises:
        SessionError: it is no message of the definition in its file.
    """
    topic = current_topic(message.topic)
    if topic == message.topic:
        return message
    sample, frame = decode_scalar_sample(message.data)
    return message._replace(topic=topic, data=encode_sample(sample, frame))
