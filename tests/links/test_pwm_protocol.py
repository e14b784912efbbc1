from __future__ import annotations

import pytest

from twinmatch.links.pwm_protocol import Code, Conversation, Flags, Refusal, Status, Verb, seal


def status(sequence: int, applied: int = 0) -> bytes:
    return seal(str(Status(sequence, 5, applied, 0, Flags.NONE)))


def test_each_request_gets_the_next_number_around_the_end() -> None:
    talk = Conversation(65535)
    assert talk.ask(Verb.QUERY) == seal("Q 65535")
    assert talk.ask(Verb.SET, -3) == seal("P 0 -3")


def test_repeating_keeps_the_number() -> None:
    talk = Conversation(7)
    assert talk.ask(Verb.SET, 9) == talk.repeat()


def test_nothing_to_repeat() -> None:
    with pytest.raises(ValueError, match="no request is outstanding"):
        Conversation().repeat()


def test_the_reply_ends_the_request() -> None:
    talk = Conversation(7)
    talk.ask(Verb.SET, 9)
    line = status(7, 9)
    assert talk.hear(line[:5]) is None
    reply = talk.hear(line[5:])
    assert isinstance(reply, Status)
    assert reply.applied == 9
    assert talk.outstanding is None
    assert talk.hear(line) is None


def test_replies_to_earlier_requests_are_counted_and_dropped() -> None:
    talk = Conversation(7)
    talk.ask(Verb.QUERY)
    talk.ask(Verb.QUERY)
    assert talk.hear(status(7)) is None
    assert (talk.stale, talk.spoiled) == (1, False)
    assert talk.hear(status(8)) is not None


@pytest.mark.parametrize(
    "line",
    [
        status(7).replace(b"S", b"T"),
        seal("S 7 nonsense"),
        seal("B 7 1.0.0 1 0 1000 0"),
        b":" + b"x" * 99 + b"\n",
    ],
)
def test_damaged_or_unfitting_replies_spoil_the_request(line: bytes) -> None:
    talk = Conversation(7)
    talk.ask(Verb.QUERY)
    assert talk.hear(line) is None
    assert talk.spoiled
    assert talk.damaged == 1
    talk.repeat()
    assert not talk.spoiled
    assert talk.hear(status(7)) is not None


def test_the_boards_word_about_a_damaged_line_spoils_the_request() -> None:
    talk = Conversation(7)
    talk.ask(Verb.QUERY)
    assert talk.hear(seal("E - CRC")) is None
    assert talk.spoiled
    assert talk.refused_line == Refusal(None, Code.CRC)
    talk.repeat()
    assert talk.refused_line is None


def test_a_numbered_refusal_is_the_reply() -> None:
    talk = Conversation(7)
    talk.ask(Verb.HELLO)
    assert talk.hear(seal("E 7 SYNTAX")) == Refusal(7, Code.SYNTAX)
