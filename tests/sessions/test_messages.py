"""Our CDR against the serialiser of rosbags, for every alignment a frame name can cause."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from twinmatch.sessions import SessionError
from twinmatch.sessions.messages import (
    LOOP_SAMPLE,
    decode_sample,
    encode_float64,
    encode_sample,
    encode_temperature,
)
from twinmatch.signals import Sample

STORE = get_typestore(Stores.ROS2_KILTED)
STORE.register(get_types_from_msg(LOOP_SAMPLE.schema, LOOP_SAMPLE.name))
LoopSample = STORE.types[LOOP_SAMPLE.name]
Header = STORE.types["std_msgs/msg/Header"]
Time = STORE.types["builtin_interfaces/msg/Time"]
Temperature = STORE.types["sensor_msgs/msg/Temperature"]

doubles = st.floats(allow_nan=False)
stamps = st.integers(0, 2**31 * 10**9 - 1)
several = st.lists(doubles, max_size=3).map(tuple)
samples = st.builds(Sample, st.integers(0, 2**64 - 1), stamps, doubles, doubles, doubles, several)
frames = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=20)


def header(stamp: int, frame: str):
    return Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id=frame)


def loop_sample(sample: Sample, frame: str):
    arrays = [sample.reference], [sample.output], [sample.input], sample.disturbances
    return LoopSample(header(sample.stamp, frame), sample.index, *map(np.array, arrays))


@given(samples, frames)
def test_samples_are_encoded_as_rosbags_does(sample, frame):
    theirs = STORE.serialize_cdr(
        loop_sample(sample, frame),
        LOOP_SAMPLE.name,
    )
    assert encode_sample(sample, frame) == bytes(theirs)


@given(samples, frames, st.booleans())
def test_samples_are_decoded_from_what_rosbags_encodes(sample, frame, little):
    theirs = STORE.serialize_cdr(
        loop_sample(sample, frame),
        LOOP_SAMPLE.name,
        little_endian=little,
    )
    assert decode_sample(bytes(theirs)) == sample


@pytest.mark.parametrize("frame", ["x" * n for n in range(17)])
def test_every_alignment_round_trips(frame):
    sample = Sample(7, 1_234_567_890_123_456_789, 30.0, 29.5, -12.25)
    assert decode_sample(encode_sample(sample, frame)) == sample


@given(stamps, doubles, doubles, frames)
def test_temperatures_are_encoded_as_rosbags_does(stamp, value, variance, frame):
    theirs = STORE.serialize_cdr(
        Temperature(header(stamp, frame), value, variance), "sensor_msgs/msg/Temperature"
    )
    assert encode_temperature(stamp, value, variance, frame) == bytes(theirs)


@given(doubles)
def test_numbers_are_encoded_as_rosbags_does(value):
    message = STORE.deserialize_cdr(encode_float64(value), "std_msgs/msg/Float64")
    assert message.data == value
    assert encode_float64(value) == bytes(STORE.serialize_cdr(message, "std_msgs/msg/Float64"))


def test_a_not_a_number_keeps_its_place():
    sample = decode_sample(encode_sample(Sample(1, 2, 3.0, math.nan, 5.0)))
    assert math.isnan(sample.output)
    assert (sample.reference, sample.input) == (3.0, 5.0)


@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_stamps_outside_ros_time_are_refused(stamp):
    with pytest.raises(SessionError, match="outside 1970 to 2038"):
        encode_sample(Sample(0, stamp, 0.0, 0.0, 0.0))
    with pytest.raises(SessionError, match="outside 1970 to 2038"):
        encode_temperature(stamp, 20.0)


def test_arrays_of_another_length_are_refused():
    """A message of a plant with two loops, or none."""
    for arrays, said in (
        (([1.0, 2.0], [3.0, 4.0], [5.0]), "sample 9 has 2 references, 2 outputs and 1 inputs"),
        (([], [3.0], []), "sample 9 has 0 references, 1 outputs and 0 inputs"),
    ):
        message = LoopSample(header(0, "plate"), 9, *map(np.array, arrays), np.array([]))
        with pytest.raises(SessionError, match=f"session: {said}; a twin runs one loop"):
            decode_sample(bytes(STORE.serialize_cdr(message, LOOP_SAMPLE.name)))


def test_another_encoding_is_refused():
    with pytest.raises(SessionError, match="'00 07 00 00'; only plain CDR"):
        decode_sample(b"\x00\x07\x00\x00" + bytes(60))


@pytest.mark.parametrize("length", [2, 4, 15, 16, 30, 59, 80])
def test_short_messages_are_refused(length):
    whole = encode_sample(Sample(1, 2, 3.0, 4.0, 5.0))
    with pytest.raises(SessionError, match=f"{length} bytes is too short"):
        decode_sample(whole[:length])


def test_a_string_longer_than_the_message_is_refused():
    raw = bytearray(encode_sample(Sample(1, 2, 3.0, 4.0, 5.0)))
    struct.pack_into("<I", raw, 12, 2**32 - 1)
    with pytest.raises(SessionError, match="too short"):
        decode_sample(bytes(raw))
