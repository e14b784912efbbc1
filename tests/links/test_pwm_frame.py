from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.links.pwm_protocol import MAX_PAYLOAD, Damage, FrameReader, crc16, seal

PAYLOADS = st.text(
    st.sampled_from([chr(c) for c in range(0x20, 0x7F) if chr(c) != ":"]), min_size=1, max_size=40
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
def test_whatever_is_sealed_is_read_back_in_any_pieces(payloads: list[str], piece: int) -> None:
    stream = b"".join(map(seal, payloads))
    reader = FrameReader()
    found = [e for at in range(0, len(stream), piece) for e in reader.feed(stream[at : at + piece])]
    assert found == [p.encode() for p in payloads]


@pytest.mark.parametrize(
    "payload", ["", "x" * (MAX_PAYLOAD + 1), "P 1:2", "P 1\n", "P 1\r", "a\tb", "P 1\x00"]
)
def test_seal_refuses_what_a_frame_cannot_hold(payload: str) -> None:
    with pytest.raises(ValueError, match="cannot be sent"):
        seal(payload)


def test_seal_refuses_other_alphabets() -> None:
    with pytest.raises(ValueError, match="ascii"):
        seal("P 1 −5")


def test_noise_between_frames_is_skipped() -> None:
    assert FrameReader().feed(b"\x00noise\n*\n" + seal("Q 1") + b"\r\nmore") == [b"Q 1"]


def test_a_serial_monitors_carriage_return_is_allowed() -> None:
    assert FrameReader().feed(seal("Q 1")[:-1] + b"\r\n") == [b"Q 1"]


def test_a_colon_starts_the_frame_over() -> None:
    assert FrameReader().feed(b":P 7 25" + seal("Q 1")) == [b"Q 1"]


@pytest.mark.parametrize(
    "line",
    [b":\n", b":*FFFF\n", b":Q 1\n", b":Q 1*0000\n", b":Q 1*12345\n"],
)
def test_a_line_without_its_check_sum_is_damage(line: bytes) -> None:
    assert FrameReader().feed(line) == [Damage.CHECKSUM]


def test_lower_case_digits_are_damage() -> None:
    lines = [seal(f"Q {n}") for n in range(20)]
    lowered = [line[:-5] + line[-5:].lower() for line in lines]
    changed = [low for low, line in zip(lowered, lines, strict=True) if low != line]
    assert changed
    assert all(FrameReader().feed(line) == [Damage.CHECKSUM] for line in changed)


def test_control_characters_are_damage_even_under_a_right_check_sum() -> None:
    body = b"Q 1\x00"
    assert FrameReader().feed(b":%b*%04X\n" % (body, crc16(body))) == [Damage.CHECKSUM]


def test_longest_frame_passes_and_a_longer_one_does_not() -> None:
    longest = "x" * MAX_PAYLOAD
    assert FrameReader().feed(seal(longest)[:-1] + b"\r\n") == [longest.encode()]
    body = b"x" * (MAX_PAYLOAD + 1)
    assert FrameReader().feed(b":%b*%04X\n" % (body, crc16(body))) == [Damage.LENGTH]


def test_an_endless_line_is_one_damage_and_then_over() -> None:
    assert FrameReader().feed(b":" + b"x" * 10_000 + b"\n" + seal("Q 2")) == [Damage.LENGTH, b"Q 2"]


def test_reset_forgets_a_begun_frame() -> None:
    reader = FrameReader()
    reader.feed(b":Q 1")
    reader.reset()
    assert reader.feed(seal("Q 1")[4:]) == []
