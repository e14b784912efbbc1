"""Reports on sessions that hold verdicts of their own: these are computed again, and compared."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from rclpy.serialization import serialize_message

from tests.support.rig import rig, run
from twinmatch.nodes.messages import match_message, score_message
from twinmatch.parameters.twin import settings_from, twin_values
from twinmatch.sessions import Qos, SessionWriter, Topic, samples_of
from twinmatch.sessions.definitions import schema_of
from twinmatch.sessions.messages import SAMPLE, encode_sample
from twinmatch.sessions.metadata import parameters_record
from twinmatch.showing.report.report import judge_for_report, make_report
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin

pytestmark = pytest.mark.ros


def topic_of(name: str, kind: str) -> Topic:
    return Topic(name, kind, schema_of(kind), "", Qos("reliable", "volatile", 100))


SCORE = topic_of("/twin/model_score", "twinmatch_msgs/msg/ModelScore")
MATCH = topic_of("/twin/match", "twinmatch_msgs/msg/Match")


@pytest.fixture
def record(tmp_path: Path) -> Callable[..., Path]:
    """A session as the recorder makes one, with parameters that are not the defaults."""

    def write(spoil: Callable[[Any], None] = lambda _score: None, *, parameters: bool = True) -> Path:
        reference = np.repeat([30.0, 60.0, 40.0], [60, 250, 120])
        samples = samples_of(run(rig(seebeck=0.07, conductance=0.5, heat_capacity=27.0), reference, seed=3))
        values = twin_values("twin", {"decimals": 1})
        twin = Twin(settings_from(values))
        outcomes = [twin.push(sample) for sample in samples]
        stamps = {s.index: s.stamp for s in samples}
        messages = [(MATCH, match_message(o.match, stamps[o.match.sample])) for o in outcomes if o.match]
        scores = [score_message(v, stamps[v.sample]) for o in outcomes for v in o.verdicts]
        for score in scores:
            spoil(score)
        messages += [(SCORE, score) for score in scores]
        with SessionWriter(tmp_path / "run") as writer:
            for node in ("/matcher", "/discriminator") if parameters else ():
                entries = {name: json.dumps(value) for name, value in values.items()}
                writer.add_record(parameters_record(node), entries)
            for topic in (SAMPLE, SCORE, MATCH):
                writer.add_topic(topic)
            for sample in samples:
                writer.write(SAMPLE.name, encode_sample(sample), sample.stamp)
            for topic, message in messages:
                writer.write(topic.name, serialize_message(message), samples[-1].stamp)
        return tmp_path / "run"

    return write


def test_the_recorded_parameters_are_used_and_the_verdicts_agree(record: Callable[..., Path]) -> None:
    report = make_report(record())
    assert report.judged.judgement.settings.decimals == 1
    assert report.judged.identical is True
    text = report.html()
    assert "the same, bit for bit" in text
    assert "those recorded with the session" in text


def test_a_session_with_verdicts_is_judged_once(
    record: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    pushed: list[int] = []
    push = Twin.push

    def counted(twin: Twin, sample: Sample) -> Outcome:
        pushed.append(sample.index)
        return push(twin, sample)

    folder = record()
    monkeypatch.setattr(Twin, "push", counted)
    found = judge_for_report(folder)
    assert found.identical
    assert pushed == [sample.index for sample in found.session.samples]


def test_verdicts_that_differ_are_reported_with_the_first_difference(record: Callable[..., Path]) -> None:
    def spoil(score: Any) -> None:
        score.nominal = "invented"

    judged = judge_for_report(record(spoil))
    assert judged.identical is False
    assert "differ from the recorded ones" in judged.recorded
    assert "nominal was recorded as 'invented'" in judged.recorded


def test_verdicts_that_cannot_be_compared_are_reported_too(record: Callable[..., Path]) -> None:
    judged = judge_for_report(record(parameters=False))
    assert judged.identical is None
    assert "could not be compared" in judged.recorded
    assert "were not recorded" in judged.recorded
    assert judged.parameters == "the defaults of this version"
