"""Frames, messages and conversation of the PWM board's protocol; nothing damaged is acted on."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.damage import FUZZ, damaged_lines
from twinmatch.links.pwm_protocol import (
    MAX_PAYLOAD,
    Banner,
    BoardStatus,
    Code,
    Conversation,
    Damage,
    Flags,
    FrameReader,
    Refusal,
    Reply,
    Request,
    Verb,
    crc16,
    is_newer,
    parse_reply,
    parse_request,
    seal,
)

PAYLOADS = st.text(
    st.sampled_from([chr(c) for c in range(0x20, 0x7F) if chr(c) != ":"]),
    min_size=1,
    max_size=40,
)


def test_crc_has_the_published_check_value() -> None:
    # CRC-16/CCITT-FALSE (also CRC-16/IBM-3740) in the catalogue of parametrised CRC algorithms.
    assert crc16(b"123456789") == 0x29B1


@given(st.binary(max_size=60))
def test_crc_is_the_polynomial_division_it_claims_to_be(data: bytes) -> None:
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            feedback = (register >> 15) ^ (byte >> bit & 1)
            register = (register << 1 & 0xFFFF) ^ (0x1021 if feedback else 0)
    assert crc16(data) == register


@given(st.lists(PAYLOADS, max_size=5), st.integers(1, 7))
def test_whatever_is_sealed_is_read_back_in_any_pieces(
    payloads: list[str], piece: int
) -> None:
    stream = b"".join(map(seal, payloads))
    reader = FrameReader()
    read_back = [
        e
        for begin in range(0, len(stream), piece)
        for e in reader.feed(stream[begin : begin + piece])
    ]
    assert read_back == [p.encode() for p in payloads]


@pytest.mark.parametrize(
    "payload",
    [
        "",
        "x" * (MAX_PAYLOAD + 1),
        "P 1:2",
        "P 1\n",
        "P 1\r",
        "a\tb",
        "P 1\x00",
        "P 1 −5",
    ],
)
def test_seal_refuses_what_a_frame_cannot_hold(payload: str) -> None:
    with pytest.raises(ValueError, match=r"cannot be sent|ascii"):
        seal(payload)


def framed(body: bytes) -> bytes:
    """A line with a right check sum, whatever its body."""
    return b":%b*%04X\n" % (body, crc16(body))


LONGEST = "x" * MAX_PAYLOAD


@pytest.mark.parametrize(
    ("stream", "events"),
    [
        (b"\x00noise\n*\n" + seal("Q 1") + b"\r\nmore", [b"Q 1"]),
        (seal("Q 1")[:-1] + b"\r\n", [b"Q 1"]),  # as a serial monitor sends it
        (b":P 7 25" + seal("Q 1"), [b"Q 1"]),  # a colon starts the frame over
        # a lost line end
        (seal("P 1 25")[:-1] + seal("P 2 30") + seal("P 3 35"), [b"P 2 30", b"P 3 35"]),
        *(
            (line, [Damage.CHECKSUM])
            for line in (
                b":\n",
                b":*FFFF\n",
                b":Q 1\n",
                b":Q 1*0000\n",
                b":Q 1*12345\n",
            )
        ),
        # control characters, even under a right check sum
        (framed(b"Q 1\x00"), [Damage.CHECKSUM]),
        (seal(LONGEST)[:-1] + b"\r\n", [LONGEST.encode()]),
        (framed(b"x" + LONGEST.encode()), [Damage.LENGTH]),
        (b":" + b"x" * 10_000 + b"\n" + seal("Q 2"), [Damage.LENGTH, b"Q 2"]),
    ],
)
def test_frames_and_damage_are_found_in_any_stream(
    stream: bytes, events: list[bytes | Damage]
) -> None:
    assert FrameReader().feed(stream) == events


def test_lower_case_digits_are_damage() -> None:
    lines = [seal(f"Q {n}") for n in range(20)]
    lowered = [line[:-5] + line[-5:].lower() for line in lines]
    changed = [low for low, line in zip(lowered, lines, strict=True) if low != line]
    assert changed
    assert all(FrameReader().feed(line) == [Damage.CHECKSUM] for line in changed)


SEQUENCE = st.integers(0, 65535)
REQUESTS = st.one_of(
    st.builds(Request, st.sampled_from([Verb.HELLO, Verb.QUERY, Verb.CLEAR]), SEQUENCE),
    st.builds(Request, st.just(Verb.SET), SEQUENCE, st.integers(-255, 255)),
)
REPLIES = st.one_of(
    st.builds(Refusal, st.none() | SEQUENCE, st.sampled_from(Code)),
    st.builds(
        BoardStatus,
        SEQUENCE,
        st.integers(0, 2**32 - 1),
        st.integers(-255, 255),
        st.integers(0, 1023),
        st.integers(0, 63).map(Flags),
    ),
    st.builds(
        Banner,
        SEQUENCE,
        st.just("1.0.0"),
        st.integers(0, 9),
        st.integers(0, 31),
        st.just(1000),
        SEQUENCE,
    ),
)


@given(REQUESTS)
def test_requests_survive_their_spelling(request_: Request) -> None:
    assert parse_request(str(request_).encode()) == request_


@given(REPLIES)
def test_replies_survive_their_spelling(reply: Reply) -> None:
    assert parse_reply(str(reply).encode()) == reply


SYNTAX = ["-0", "05", "+5", "5.0", "nan", " 5", "5 ", "100000"]
UNREADABLE = [b"Q 1x", b"Q 01", b"Q 65536", b"Q 99999999999999", b"Q", b"Q \xb2"]


@pytest.mark.parametrize(
    ("payload", "answer"),
    [
        *(
            (f"P 1 {pwm}".encode(), Refusal(1, Code.RANGE))
            for pwm in (256, -256, 99999)
        ),
        *((f"P 1 {pwm}".encode(), Refusal(1, Code.SYNTAX)) for pwm in SYNTAX),
        *(
            (payload, Refusal(1, Code.SYNTAX))
            for payload in (b"P 1", b"Q 1 5", b"Q 1 ")
        ),
        *((payload, Refusal(None, Code.SYNTAX)) for payload in UNREADABLE),
        *(
            (payload, Refusal(1, Code.UNKNOWN))
            for payload in (b"q 1", b"X 1 5", b"\xb2 1")
        ),
    ],
)
def test_a_wrong_request_is_refused_with_its_number_and_a_code(
    payload: bytes, answer: Refusal
) -> None:
    assert parse_request(payload) == answer


@pytest.mark.parametrize("more_fields", [b"", b" 7", b" a b c d e"])
def test_the_banner_of_another_protocol_still_names_it(more_fields: bytes) -> None:
    assert parse_reply(b"B 5 9.1 2" + more_fields) == Banner(5, "9.1", 2, 0, 0, 0)


REPLY = b"S 1 2 3 4|S 1 2 3 4 5 6|S 65536 2 3 4 5|S 1 4294967296 3 4 5|S 1 2 256 4 5|S 1 2 3 1024 5|S 1 2 3 4 256"
MORE = b"|S 01 2 3 4 5|B 1 1.0.0 1 0 1000|E 1 NONSENSE|E x CRC|P 1 5|"


@pytest.mark.parametrize("payload", (REPLY + MORE).split(b"|"))
def test_an_invalid_reply_is_ignored(payload: bytes) -> None:
    assert parse_reply(payload) is None


@given(SEQUENCE, st.integers(1, 32767))
def test_sequence_numbers_count_around_the_end(last: int, ahead: int) -> None:
    assert is_newer((last + ahead) % 65536, last)
    assert not is_newer(last, (last + ahead) % 65536)
    assert not is_newer(last, last)


def test_no_damaged_frame_is_acted_on_with_a_changed_meaning_and_the_next_one_always_arrives() -> (
    None
):
    reader = FrameReader()
    found_damage = 0
    for payload, line in damaged_lines(FUZZ, seed=20220):
        # The line end in front stands for what the line before may have lost.
        events = reader.feed(line + b"\n" + seal("Q 9"))
        assert events[-1] == b"Q 9", (payload, line)
        for event in events[:-1]:
            if isinstance(event, Damage):
                found_damage += 1
            else:
                request = parse_request(event)
                assert not isinstance(request, Request) or str(request) == payload, (
                    payload,
                    line,
                )
    assert found_damage > FUZZ // 2


def status(sequence: int, applied: int = 0) -> bytes:
    return seal(str(BoardStatus(sequence, 5, applied, 0, Flags.NONE)))


def test_each_request_gets_the_next_number_around_the_end_and_keeps_it_when_it_is_repeated() -> (
    None
):
    talk = Conversation(65535)
    with pytest.raises(ValueError, match="no request is outstanding"):
        talk.repeat()
    assert talk.ask(Verb.QUERY) == seal("Q 65535")
    assert talk.ask(Verb.SET, -3) == talk.repeat() == seal("P 0 -3")


def test_the_reply_ends_the_request() -> None:
    talk = Conversation(7)
    talk.ask(Verb.SET, 9)
    line = status(7, 9)
    assert talk.hear(line[:5]) is None
    reply = talk.hear(line[5:])
    assert isinstance(reply, BoardStatus)
    assert reply.applied == 9
    assert talk.hear(line) is None  # nothing is outstanding


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
    # with its number it is the reply
    assert talk.hear(seal("E 7 SYNTAX")) == Refusal(7, Code.SYNTAX)
