from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.links.pwm_protocol import (
    Banner,
    Code,
    Flags,
    Refusal,
    Reply,
    Request,
    Status,
    Verb,
    is_newer,
    parse_reply,
    parse_request,
)

SEQUENCE = st.integers(0, 65535)
REQUESTS = st.one_of(
    st.builds(Request, st.sampled_from([Verb.HELLO, Verb.QUERY, Verb.CLEAR]), SEQUENCE),
    st.builds(Request, st.just(Verb.SET), SEQUENCE, st.integers(-255, 255)),
)
REPLIES = st.one_of(
    st.builds(Refusal, st.none() | SEQUENCE, st.sampled_from(Code)),
    st.builds(
        Status,
        SEQUENCE,
        st.integers(0, 2**32 - 1),
        st.integers(-255, 255),
        st.integers(0, 1023),
        st.integers(0, 63).map(Flags),
    ),
    st.builds(
        Banner, SEQUENCE, st.just("1.0.0"), st.integers(0, 9), st.integers(0, 31), st.just(1000), SEQUENCE
    ),
)


@given(REQUESTS)
def test_requests_survive_their_spelling(request_: Request) -> None:
    assert parse_request(str(request_).encode()) == request_


@given(REPLIES)
def test_replies_survive_their_spelling(reply: Reply) -> None:
    assert parse_reply(str(reply).encode()) == reply


@pytest.mark.parametrize(
    ("payload", "answer"),
    [
        (b"P 1 256", Refusal(1, Code.RANGE)),
        (b"P 1 -256", Refusal(1, Code.RANGE)),
        (b"P 1 99999", Refusal(1, Code.RANGE)),
        (b"P 1 100000", Refusal(1, Code.SYNTAX)),
        (b"P 1 -0", Refusal(1, Code.SYNTAX)),
        (b"P 1 05", Refusal(1, Code.SYNTAX)),
        (b"P 1 +5", Refusal(1, Code.SYNTAX)),
        (b"P 1 5.0", Refusal(1, Code.SYNTAX)),
        (b"P 1 nan", Refusal(1, Code.SYNTAX)),
        (b"P 1  5", Refusal(1, Code.SYNTAX)),
        (b"P 1 5 ", Refusal(1, Code.SYNTAX)),
        (b"P 1", Refusal(1, Code.SYNTAX)),
        (b"Q 1 5", Refusal(1, Code.SYNTAX)),
        (b"Q 1 ", Refusal(1, Code.SYNTAX)),
        (b"Q 1x", Refusal(None, Code.SYNTAX)),
        (b"Q 01", Refusal(None, Code.SYNTAX)),
        (b"Q 65536", Refusal(None, Code.SYNTAX)),
        (b"Q 99999999999999", Refusal(None, Code.SYNTAX)),
        (b"Q", Refusal(None, Code.SYNTAX)),
        (b"q 1", Refusal(1, Code.UNKNOWN)),
        (b"X 1 5", Refusal(1, Code.UNKNOWN)),
        (b"\xb2 1", Refusal(1, Code.UNKNOWN)),
        (b"Q \xb2", Refusal(None, Code.SYNTAX)),
    ],
)
def test_requests_that_are_refused(payload: bytes, answer: Refusal) -> None:
    assert parse_request(payload) == answer


@pytest.mark.parametrize("rest", [b"", b" 7", b" a b c d e"])
def test_the_banner_of_another_protocol_still_names_it(rest: bytes) -> None:
    assert parse_reply(b"B 5 9.1 2" + rest) == Banner(5, "9.1", 2, 0, 0, 0)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"S 1 2 3 4",
        b"S 1 2 3 4 5 6",
        b"S 65536 2 3 4 5",
        b"S 1 4294967296 3 4 5",
        b"S 1 2 256 4 5",
        b"S 1 2 3 1024 5",
        b"S 1 2 3 4 256",
        b"S 01 2 3 4 5",
        b"B 1 1.0.0 1 0 1000",
        b"E 1 NONSENSE",
        b"E x CRC",
        b"P 1 5",
    ],
)
def test_invalid_replies(payload: bytes) -> None:
    assert parse_reply(payload) is None


@given(SEQUENCE, st.integers(1, 32767))
def test_sequence_numbers_count_around_the_end(last: int, ahead: int) -> None:
    assert is_newer((last + ahead) % 65536, last)
    assert not is_newer(last, (last + ahead) % 65536)
    assert not is_newer(last, last)
