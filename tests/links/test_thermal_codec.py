"""The wire format: against bytes built by hand, RFC examples, round trips, and what corruption does."""

from __future__ import annotations

import dataclasses
import random
import struct
import zlib
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.support.camera import decoded
from tests.support.damage import FUZZ, damaged
from twinmatch.links.thermal_frame import (
    LEPTON_SHAPE,
    MAX_FRAME_BYTES,
    Exposure,
    FlatField,
    FrameChecksumError,
    FrameError,
    FrameFieldError,
    FrameFlags,
    FrameSyntaxError,
    FrameTooLongError,
    FrameVersionError,
    ThermalEndError,
    ThermalFrame,
    encode_frame,
    read_frame,
)

BOOT = bytes(range(16))


def make_frame(shape: tuple[int, int] = LEPTON_SHAPE, **changes: Any) -> ThermalFrame:
    image = np.random.default_rng(5).integers(29000, 31500, shape, dtype=np.uint16)
    values: dict[str, Any] = {
        "image": image,
        "stamp": 123_456_789_012,
        "resolution": 0.01,
        "frame_counter": 77,
        "flat_field": FlatField.COMPLETE,
        "flat_field_age": 61_000,
        "sensor_temperature": 30_315,
        "flags": FrameFlags.EMULATED | FrameFlags.FLAT_FIELD_DESIRED,
        "sequence": 9,
        "boot_id": BOOT,
    }
    return ThermalFrame(**{**values, **changes})


def same(first: ThermalFrame, second: ThermalFrame) -> bool:
    names = [field.name for field in dataclasses.fields(first) if field.name != "image"]
    return np.array_equal(first.image, second.image) and all(
        getattr(first, name) == getattr(second, name) for name in names
    )


def sealed(value: dict[str, Any]) -> bytes:
    """A map with a checksum that fits, whatever else may be wrong with it."""
    body = cbor2.dumps({**value, "crc": bytes(4)})[:-4]
    return body + zlib.crc32(body).to_bytes(4, "big")


def wire_map(**changes: Any) -> dict[str, Any]:
    value: dict[str, Any] = cbor2.loads(encode_frame(make_frame((2, 3))))
    del value["crc"]
    return {**value, **changes}


def head(major: int, value: int) -> bytes:
    """The head of a CBOR item, from RFC 8949 section 3 alone."""
    if value < 24:
        return bytes([major << 5 | value])
    for code, size in ((24, 1), (25, 2), (26, 4), (27, 8)):
        if value < 1 << (8 * size):
            return bytes([major << 5 | code]) + value.to_bytes(size, "big")
    raise AssertionError(value)


def text(word: str) -> bytes:
    return head(3, len(word)) + word.encode()


def test_bytes_are_those_of_a_hand_written_encoder() -> None:
    frame = make_frame()
    pixels = b"".join(
        struct.pack("<H", count) for row in frame.image.tolist() for count in row
    )
    item = head(5, 12)
    item += text("v") + head(0, 1)
    item += text("seq") + head(0, 9)
    item += text("t_ns") + head(0, 123_456_789_012)
    item += text("boot_id") + head(2, 16) + BOOT
    item += text("res_k") + b"\xfb" + struct.pack(">d", 0.01)
    item += (
        text("img") + head(6, 40) + head(4, 2) + head(4, 2) + head(0, 60) + head(0, 80)
    )
    item += head(6, 69) + head(2, len(pixels)) + pixels
    item += text("ffc") + head(0, 3)
    item += text("ffc_age_ms") + head(0, 61_000)
    item += text("fpa_ck") + head(0, 30_315)
    item += text("frame_counter") + head(0, 77)
    item += text("flags") + head(0, 33)
    item += text("crc") + head(2, 4)
    item += struct.pack(">I", zlib.crc32(item))
    assert encode_frame(frame) == item


def test_unknown_values_travel_as_null() -> None:
    frame = make_frame(
        (2, 3), flat_field=None, flat_field_age=None, sensor_temperature=None
    )
    value = cbor2.loads(encode_frame(frame))
    assert (value["ffc"], value["ffc_age_ms"], value["fpa_ck"]) == (None, None, None)
    assert same(decoded(encode_frame(frame)), frame)


def test_the_array_of_rfc_8746_figure_1_in_little_endian() -> None:
    # 40([[2, 3], 65(h'000200040008000400100100')]), with tag 69 and its bytes swapped in pairs.
    array = bytes.fromhex("d82882820203d8454c020004000800040010000001")
    frame = decoded(sealed(wire_map(img=cbor2.loads(array))))
    assert frame.image.tolist() == [[2, 4, 8], [4, 16, 256]]


def test_a_lepton_frame_is_below_ten_kilobytes() -> None:
    assert len(encode_frame(make_frame())) < 10_000


frames = st.builds(
    ThermalFrame,
    image=hnp.arrays(
        np.uint16, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12)
    ),
    stamp=st.integers(0, 2**63 - 1),
    resolution=st.floats(0, 1, exclude_min=True),
    frame_counter=st.integers(0, 2**32 - 1),
    flat_field=st.none() | st.sampled_from(FlatField),
    flat_field_age=st.none() | st.integers(0, 2**32 - 1),
    sensor_temperature=st.none() | st.integers(0, 2**16 - 1),
    flags=st.integers(0, 2**16 - 1).map(FrameFlags),
    sequence=st.integers(0, 2**63 - 1),
    boot_id=st.binary(min_size=16, max_size=16),
)


@given(frames)
def test_every_frame_comes_back(frame: ThermalFrame) -> None:
    assert same(decoded(encode_frame(frame)), frame)


@given(st.lists(frames, max_size=4))
def test_a_sequence_is_read_frame_by_frame_and_not_a_byte_further(
    sent: list[ThermalFrame],
) -> None:
    stream = b"".join(encode_frame(frame) for frame in sent) + b"next"
    position = 0

    def read(count: int) -> bytes:
        nonlocal position
        position += count
        return stream[position - count : position]

    for frame in sent:
        assert same(read_frame(read), frame)
    assert stream[position:] == b"next"


@given(frames, st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_numbering_changes_the_numbers_only(
    frame: ThermalFrame, sequence: int, boot_id: bytes
) -> None:
    numbered = frame.numbered(sequence, boot_id)
    assert same(
        numbered, dataclasses.replace(frame, sequence=sequence, boot_id=boot_id)
    )


@pytest.mark.parametrize(
    ("shape", "rounds"), [((6, 8), FUZZ - FUZZ // 10), (LEPTON_SHAPE, FUZZ // 10)]
)
def test_no_changed_frame_is_accepted(shape: tuple[int, int], rounds: int) -> None:
    good = encode_frame(make_frame(shape))
    rng = random.Random(20)
    for number in range(rounds):
        data = damaged(good, rng, number)
        try:
            decoded(data)
        except (FrameError, ThermalEndError):
            continue
        pytest.fail(f"accepted: {data!r}")


def test_every_single_bit_counts() -> None:
    good = encode_frame(make_frame((2, 3)))
    for bit in range(8 * len(good)):
        data = bytearray(good)
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises((FrameError, ThermalEndError)):
            decoded(bytes(data))


@given(st.binary(max_size=300))
def test_noise_is_refused(data: bytes) -> None:
    with pytest.raises((FrameError, ThermalEndError)):
        decoded(data)


@pytest.mark.parametrize(
    "start", ["5a7fffffff", "5b7fffffffffffffff", "7a7fffffff", "a163696d675a00010000"]
)
def test_absurd_length_is_refused_before_it_is_read(start: str) -> None:
    sent = bytes.fromhex(start)
    asked = 0

    def read(count: int) -> bytes:
        nonlocal asked
        asked += count
        return sent[asked - count : asked].ljust(count, b"\0")

    with pytest.raises(
        (FrameTooLongError, FrameSyntaxError), match=r"longer than|not CBOR"
    ):
        read_frame(read)
    assert asked <= MAX_FRAME_BYTES


def test_endless_nesting_and_endless_arrays_end_at_the_cap() -> None:
    for byte in (b"\x81", b"\x9f", b"\xbf", b"\x5f", b"\xc6"):
        with pytest.raises(FrameError):
            read_frame(lambda count, byte=byte: byte * count)


SMALL = encode_frame(make_frame((2, 3)))
# behind 16 or 32 bits the tail of the item is not the value of `crc`
BEFORE_CRC = SMALL[:-5] + b"\x58\x04"
# figure 1 of RFC 8746
BIG_ENDIAN = bytes.fromhex("d82882820203d8414c000200040008000400100100")
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"seq": -1}, "sequence is -1"),
    ({"seq": True}, "sequence is True"),
    ({"t_ns": 1.5}, "stamp is 1.5"),
    ({"boot_id": b"short"}, "boot_id is"),
    ({"res_k": 0.0}, "resolution is 0.0"),
    ({"res_k": float("nan")}, "resolution is nan"),
    ({"res_k": 1}, "resolution is 1;"),
    ({"ffc": 4}, "ffc is 4"),
    ({"ffc": False}, "ffc is False"),
    ({"ffc_age_ms": -5}, "flat_field_age is -5"),
    ({"fpa_ck": 65_536}, "sensor_temperature is 65536"),
    ({"frame_counter": 2**32}, "frame_counter is 4294967296"),
    ({"flags": 65_536}, "flags is 65536"),
    ({"img": b"123456"}, "not a two-dimensional RFC 8746 array"),
    ({"img": cbor2.CBORTag(40, [[2, 3], b"123456789012"])}, "not a two-dimensional"),
    (
        {"img": cbor2.CBORTag(40, [[3], cbor2.CBORTag(69, b"123456")])},
        "not a two-dimensional",
    ),
    (
        {"img": cbor2.CBORTag(40, [[2, 3], cbor2.CBORTag(69, b"1234")])},
        "4 bytes for 2 by 3 pixels",
    ),
    ({"img": cbor2.CBORTag(40, [[0, 3], cbor2.CBORTag(69, b"")])}, r"shape \(0, 3\)"),
    (
        {"img": cbor2.CBORTag(40, [[1, 2000], cbor2.CBORTag(69, bytes(4000))])},
        r"shape \(1, 2000\)",
    ),
    (
        {"img": cbor2.CBORTag(40, [[-1, -3], cbor2.CBORTag(69, b"123456")])},
        "not a two-dimensional",
    ),
    ({"img": cbor2.loads(BIG_ENDIAN)}, "not a two-dimensional RFC 8746 array"),
    ({"extra": 1}, "keys are"),
]


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (
            SMALL[:80] + bytes([SMALL[80] ^ 1]) + SMALL[81:],
            FrameChecksumError,
            "the bytes were corrupted",
        ),
        *(
            (bytes.fromhex(i), FrameSyntaxError, "instead of a map")
            for i in ("01", "80", "f6", "d81800")
        ),
        # Releases of cbor2 differ in whether a lone break is an error or a value.
        *(
            (bytes.fromhex(item), FrameSyntaxError, r"not CBOR|instead of a map")
            for item in ("ff", "1c", "c000", "d81d05", "81" * 5000)
        ),
        (
            sealed(wire_map(v=2)),
            FrameVersionError,
            "format version 2; this program reads version 1",
        ),
        (
            sealed({k: v for k, v in wire_map().items() if k != "ffc"}),
            FrameFieldError,
            "keys are",
        ),
        (
            BEFORE_CRC + zlib.crc32(BEFORE_CRC).to_bytes(4, "big"),
            FrameFieldError,
            "must be the frame's last 4 bytes",
        ),
        *(
            (sealed(wire_map(**change)), FrameFieldError, message)
            for change, message in WRONG
        ),
    ],
)
def test_other_bytes_are_refused(
    data: bytes, error: type[FrameError], message: str
) -> None:
    with pytest.raises(error, match=message):
        decoded(data)


def test_an_image_cannot_be_changed() -> None:
    frame = make_frame((2, 3))
    with pytest.raises(ValueError, match="read-only"):
        frame.image[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        decoded(encode_frame(frame)).image[0, 0] = 1


def test_exposures_of_a_wrong_shape_type_or_state_are_refused() -> None:
    for image in (
        np.zeros((2, 3)),
        *(np.zeros(s, np.uint16) for s in (3, (0, 3), (1, 1025))),
        [1],
    ):
        with pytest.raises(FrameFieldError, match=r"the image (is|has shape)"):
            Exposure(image=image, stamp=0, resolution=0.01, frame_counter=0)  # type: ignore[arg-type]
    with pytest.raises(FrameFieldError, match="flat_field is 3"):
        make_frame((2, 3), flat_field=3)


def test_a_running_flat_field_freezes_and_gain_control_leaves_no_temperatures() -> None:
    assert make_frame((2, 3), flat_field=FlatField.RUNNING).frozen
    assert not make_frame((2, 3), flat_field=FlatField.IMMINENT).frozen
    assert make_frame((2, 3)).radiometric
    assert not make_frame((2, 3), flags=FrameFlags.GAIN_CONTROL).radiometric
