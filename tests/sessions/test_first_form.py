"""A session of the first form: reference, temperature and PWM as numbers, the rig's own parameters.

`first_form` was made by the version before signals became arrays: a simulated rig with one set-point step,
its match, its verdicts, the parameters of its nodes and a family to begin with.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from twinmatch.cli import main
from twinmatch.dynamics import Pid
from twinmatch.offline.judging import recorded_terms
from twinmatch.offline.verification import verify_session
from twinmatch.plants import Peltier
from twinmatch.sessions import read_session
from twinmatch.sessions.messages import LOOP_SAMPLE, decode_sample
from twinmatch.sessions.recording import repair_session

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
        theirs = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(wanted)]
    assert [(s.index, s.reference, s.output, s.input, s.disturbances) for s in session.samples] == [
        (m.index, m.reference, m.temperature, m.pwm, ()) for m in theirs
    ]
    assert [s.stamp for s in session.samples] == [
        m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in theirs
    ]
    assert len(theirs) == 360


def test_outputs_and_inputs_are_those_of_the_loop() -> None:
    """The rig's PID computes the inputs from references and outputs, so none is taken for another."""
    window, pid = read_session(SESSION).window(), Pid(Peltier.loop)
    computed = [pid.step(r, y) for r, y in zip(window.reference, window.output, strict=True)]
    np.testing.assert_allclose(computed, window.input, atol=1e-9)


def test_its_samples_are_played_as_those_of_today() -> None:
    session = read_session(SESSION)
    (topic,) = (t for t in session.topics if t.name == "/plant/sample")
    assert (topic.schema, topic.type_hash) == (LOOP_SAMPLE.schema, LOOP_SAMPLE.type_hash)
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
    found = verify_session(SESSION)
    assert (found.samples, found.verdicts, found.matches) == (360, 6, 1)
    assert found.notes[0].startswith(
        "recorded in another form; fields that only one form has were not compared"
    )
    assert " parameters.structure" in found.notes[0]
    for renamed in ("rms_y", "rms_u", "residual", " parameters.heat_capacity", "starts"):
        assert renamed not in found.notes[0]
    if found.difference is not None:
        assert type(found.difference.recorded) is type(found.difference.computed)


@pytest.mark.parametrize("command", ["replay", "report"])
def test_the_commands_read_it(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([command, str(SESSION)]) == 0
    assert "first_form.html" in (out := capsys.readouterr().out) or "Nominal: 40 °C set" in out


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
        assert "float64 temperature" in next(c for c in reader.connections if "sample" in c.topic).msgdef.data
