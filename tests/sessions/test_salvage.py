"""Messages of damaged parts, beside sound ones."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import pytest

from tests.support.places import SHIPPED
from twinmatch.sessions import read_session
from twinmatch.sessions.messages import SAMPLE, Message
from twinmatch.sessions.salvage import AROUND, mended

DAMAGED = 10
"""Place of the damaged message."""


@pytest.fixture(scope="module")
def sound() -> list[Message]:
    messages = read_session(SHIPPED).messages([SAMPLE.name])
    return list(islice(messages, 2 * AROUND + DAMAGED))


def test_what_waits_is_released_once_as_many_sound_messages_follow_as_it_is_compared_with(
    sound: list[Message],
) -> None:
    """So a file of any length takes little memory."""
    read: list[Message] = []

    def reading() -> Iterator[Message]:
        for place, message in enumerate(sound):
            read.append(message)
            yield message._replace(is_sound=place != DAMAGED)

    released = mended(reading(), lambda: None)
    before = list(islice(released, DAMAGED))
    assert before == sound[:DAMAGED]
    assert len(read) == DAMAGED
    assert next(released).data == sound[DAMAGED].data
    assert len(read) == DAMAGED + 1 + AROUND


def test_of_two_samples_with_one_index_the_sound_one_stays(
    sound: list[Message],
) -> None:
    again = sound[DAMAGED]._replace(is_sound=False)
    dropped: list[bool] = []
    messages = [*sound[: DAMAGED + 1], again, *sound[DAMAGED + 1 :]]
    assert list(mended(messages, lambda: dropped.append(True))) == sound
    assert len(dropped) == 1
