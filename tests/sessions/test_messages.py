"""Our CDR against the serialiser of rosbags, for every alignment a frame name can cause."""

from __future__ import annotations

import json
import math
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from twinmatch.cli import main
from twinmatch.dynamics import Controller
from twinmatch.offline.judging import recorded_terms
from twinmatch.offline.verification import verify_session
from twinmatch.plants import Peltier
from twinmatch.sessions import SessionError, read_session, write_session
from twinmatch.sessions.cdr import (
    decode_sample,
    encode_float64,
    encode_sample,
    encode_temperature,
)
from twinmatch.sessions.messages import SAMPLE
from twinmatch.sessions.metadata import METADATA
from twinmatch.sessions.recording import repair_session
from twinmatch.signals import Sample

STORE = get_typestore(Stores.ROS2_KILTED)
STORE.register(get_types_from_msg(SAMPLE.schema, SAMPLE.type))
LoopSample = STORE.types[SAMPLE.type]
Header = STORE.types["std_msgs/msg/Header"]
Time = STORE.types["builtin_interfaces/msg/Time"]
Temperature = STORE.types["sensor_msgs/msg/Temperature"]

doubles = st.floats(allow_nan=False)
stamps = st.integers(0, 2**31 * 10**9 - 1)
several = [
    st.lists(doubles, min_size=least, max_size=3).map(tuple) for least in (1, 1, 1, 0)
]
samples = st.builds(Sample, st.integers(0, 2**64 - 1), stamps, *several)
frames = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=20)


def header(stamp: int, frame: str):
    return Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id=frame)


def loop_sample(sample: Sample, frame: str):
    arrays = sample.references, sample.outputs, sample.inputs, sample.disturbances
    return LoopSample(header(sample.stamp, frame), sample.index, *map(np.array, arrays))


@given(samples, frames)
def test_samples_are_encoded_as_rosbags_does(sample, frame):
    theirs = STORE.serialize_cdr(loop_sample(sample, frame), SAMPLE.type)
    assert encode_sample(sample, frame) == bytes(theirs)


@given(samples, frames, st.booleans())
def test_samples_are_decoded_from_what_rosbags_encodes(sample, frame, little):
    theirs = STORE.serialize_cdr(
        loop_sample(sample, frame), SAMPLE.type, little_endian=little
    )
    assert decode_sample(bytes(theirs)) == sample


@pytest.mark.parametrize("frame", ["x" * n for n in range(17)])
def test_every_alignment_round_trips(frame):
    sample = Sample(7, 1_234_567_890_123_456_789, 30.0, 29.5, -12.25)
    assert decode_sample(encode_sample(sample, frame)) == sample


@given(stamps, doubles, doubles, frames)
def test_temperatures_are_encoded_as_rosbags_does(stamp, value, variance, frame):
    theirs = STORE.serialize_cdr(
        Temperature(header(stamp, frame), value, variance),
        "sensor_msgs/msg/Temperature",
    )
    assert encode_temperature(stamp, value, variance, frame) == bytes(theirs)


@given(doubles)
def test_numbers_are_encoded_as_rosbags_does(value):
    message = STORE.deserialize_cdr(encode_float64(value), "std_msgs/msg/Float64")
    assert message.data == value
    assert encode_float64(value) == bytes(
        STORE.serialize_cdr(message, "std_msgs/msg/Float64")
    )


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


def test_a_sample_without_a_signal_is_refused():
    for arrays, numbers_of_signals in (
        (([], [3.0], []), "sample 9 has 0 references, 1 outputs and 0 inputs"),
        (([1.0, 2.0], [], [5.0]), "sample 9 has 2 references, 0 outputs and 1 inputs"),
    ):
        message = LoopSample(
            header(0, "plate"), 9, *map(np.array, arrays), np.array([])
        )
        with pytest.raises(
            SessionError,
            match=f"session: {numbers_of_signals}; every sample has at least one of each",
        ):
            decode_sample(bytes(STORE.serialize_cdr(message, SAMPLE.type)))


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


# A session of the first form: reference, temperature and PWM as numbers, the rig's own parameters.

SESSION = Path(__file__).parent / "first_form"


def test_the_file_is_of_the_first_form() -> None:
    with AnyReader([SESSION]) as reader:
        samples = next(c for c in reader.connections if c.topic == "/plant/sample")
        assert "float64 temperature" in samples.msgdef.data
        scores = next(c for c in reader.connections if c.topic == "/twin/model_score")
        assert "RigParameters structure_parameters" in scores.msgdef.data


def test_samples_are_those_that_another_reader_finds() -> None:
    session = read_session(SESSION)
    assert session.notes == []
    with AnyReader([SESSION]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/plant/sample"]
        theirs = [
            reader.deserialize(data, c.msgtype)
            for c, _, data in reader.messages(wanted)
        ]
    assert [
        (s.index, s.reference, s.output, s.input, s.disturbances)
        for s in session.samples
    ] == [(m.index, m.reference, m.temperature, m.pwm, ()) for m in theirs]
    assert [s.stamp for s in session.samples] == [
        m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in theirs
    ]
    assert len(theirs) == 360


def test_outputs_and_inputs_are_those_of_the_loop() -> None:
    """The rig's PID computes the inputs from references and outputs, so none is taken for another."""
    window = read_session(SESSION).window()
    pid = Controller(Peltier.loop)
    computed = [
        pid.step(r, y)[0] for r, y in zip(window.reference, window.output, strict=True)
    ]
    np.testing.assert_allclose(computed, window.input, atol=1e-9)


def test_its_samples_are_played_as_those_of_today() -> None:
    session = read_session(SESSION)
    (topic,) = (t for t in session.topics if t.name == "/plant/sample")
    assert (topic.schema, topic.type_hash) == (SAMPLE.schema, SAMPLE.type_hash)
    played = list(session.messages(["/plant/sample"]))
    assert {m.topic for m in played} == {topic}
    assert [decode_sample(m.data) for m in played] == session.samples
    length = struct.unpack_from("<I", played[0].data, 12)[0]
    assert played[0].data[16 : 16 + length] == b"plate\0"


def test_recorded_parameters_get_their_names_of_today() -> None:
    terms = recorded_terms(read_session(SESSION), None, None)
    assert (terms.settings.noise.output, terms.settings.noise.input) == (0.1, 7.0)


def test_verdicts_are_compared_in_what_both_forms_have() -> None:
    """Whether they are the same to the last bit is a matter of versions; like is compared with like."""
    verification = verify_session(SESSION)
    assert (verification.samples, verification.verdicts, verification.matches) == (
        360,
        6,
        1,
    )
    assert verification.notes[0].startswith(
        "recorded in another form; fields that only one form has were not compared"
    )
    assert " parameters.structure" in verification.notes[0]
    for renamed in (
        "rms_y",
        "rms_u",
        "residual",
        " parameters.heat_capacity",
        "starts",
    ):
        assert renamed not in verification.notes[0]
    if verification.difference is not None:
        assert type(verification.difference.recorded) is type(
            verification.difference.computed
        )


def test_a_session_in_the_former_form_can_be_replayed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["replay", str(SESSION)]) == 0
    assert (
        "Nominal, the centre of the family: match at 40 °C" in capsys.readouterr().out
    )


def test_a_repaired_copy_stays_in_its_form(tmp_path: Path) -> None:
    """What was recorded is kept, whatever the form."""
    torn = tmp_path / "torn"
    torn.mkdir()
    whole = (SESSION / "first_form_0.mcap").read_bytes()
    (torn / "torn_0.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    repair_session(torn)
    samples = read_session(torn).samples
    assert 200 < len(samples) < 360
    assert samples == read_session(SESSION).samples[: len(samples)]
    with AnyReader([torn]) as reader:
        assert (
            "float64 temperature"
            in next(c for c in reader.connections if "sample" in c.topic).msgdef.data
        )


# Sessions read by `@mcap/core`, the reader behind the usual viewers.

VERSION = "2.2.2"
CACHE = Path(__file__).resolve().parents[2] / "build" / f"mcap-core-{VERSION}"
SCRIPT = Path(__file__).with_name("read_with_mcap_core.mjs")


@pytest.fixture(scope="module")
def core() -> Path:
    """The reader's folder, installed once into the ignored build folder."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    module = CACHE / "node_modules" / "@mcap" / "core"
    if not module.is_dir():
        CACHE.mkdir(parents=True, exist_ok=True)
        options = [
            "--prefix",
            str(CACHE),
            "--ignore-scripts",
            "--no-audit",
            "--no-fund",
            "--no-save",
        ]
        completed = subprocess.run(
            ["npm", "install", *options, f"@mcap/core@{VERSION}"],
            capture_output=True,
            text=True,
            check=False,
        )
        if completed.returncode:
            pytest.skip(
                f"npm could not install @mcap/core: {completed.stderr.strip().splitlines()[-1:]}"
            )
    return module


def test_the_web_reader_finds_the_same(tmp_path, core):
    samples = [
        Sample(k, 10**18 + k * 10**9, 30.0 + k // 500, 25.0 + k / 16, k / 4)
        for k in range(1000)
    ]
    folder = write_session(tmp_path / "run", samples)
    completed = subprocess.run(
        ["node", str(SCRIPT), str(folder / "run_0.mcap"), str(core)],
        capture_output=True,
        text=True,
        check=True,
    )
    theirs = json.loads(completed.stdout)
    ours = read_session(folder)
    assert theirs["profile"] == "ros2"
    assert theirs["topics"] == {
        topic.name: {
            "type": topic.type,
            "encoding": "ros2msg",
            "schema": topic.schema,
            "message": "cdr",
            "hash": topic.type_hash,
            "count": ours.counts[topic.name],
        }
        for topic in ours.topics
    }
    assert theirs["messages"] == [
        [m.topic.name, str(m.log_time), m.data.hex()] for m in ours.messages()
    ]
    text = (folder / METADATA).read_text()
    assert all(
        line.strip() in text
        for line in theirs["metadata"]["serialized_metadata"].splitlines()
    )
