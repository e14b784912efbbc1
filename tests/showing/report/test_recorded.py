"""Reports on sessions that hold verdicts of their own: these are computed again, and compared."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from tests.support.recorded import write_judged
from tests.support.rig import rig, run
from twinmatch.parameters.twin import settings_from, twin_values
from twinmatch.sessions import samples_of
from twinmatch.showing.report.report import judge_for_report
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def judged() -> tuple[list[Sample], list[Outcome], dict[str, Any]]:
    """Samples, what a twin said of them, and its parameters, which are not the defaults."""
    reference = np.repeat([30.0, 60.0, 40.0], [60, 250, 120])
    samples = samples_of(
        run(rig(seebeck=0.07, conductance=0.5, heat_capacity=27.0), reference, seed=3)
    )
    values = twin_values("twin", {"decimals": 1})
    twin = Twin(settings_from(values))
    return samples, [twin.push(sample) for sample in samples], values


@pytest.fixture
def record(
    judged: tuple[list[Sample], list[Outcome], dict[str, Any]], tmp_path: Path
) -> Callable[..., Path]:
    """A session as the recorder makes one."""
    return lambda **changed: write_judged(tmp_path / "run", *judged, **changed)


def test_a_session_with_verdicts_is_judged_once_with_its_parameters_and_they_agree(
    record: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    pushed: list[int] = []
    push = Twin.push

    def counted(twin: Twin, sample: Sample) -> Outcome:
        pushed.append(sample.index)
        return push(twin, sample)

    folder = record()
    monkeypatch.setattr(Twin, "push", counted)
    judged_session = judge_for_report(folder)
    assert judged_session.judgement.settings.decimals == 1
    assert judged_session.identical is True
    assert "the same, bit for bit" in judged_session.recorded
    assert judged_session.parameters == "those recorded with the session"
    assert pushed == [sample.index for sample in judged_session.session.samples]


def test_verdicts_that_differ_are_reported_with_the_first_difference(
    record: Callable[..., Path],
) -> None:
    def spoil(_matches: list[Any], scores: list[Any]) -> None:
        for score in scores:
            score.nominal = "invented"

    judged = judge_for_report(record(change=spoil))
    assert judged.identical is False
    assert "differ from the recorded ones" in judged.recorded
    assert "nominal was recorded as 'invented'" in judged.recorded


def test_verdicts_that_cannot_be_compared_are_reported_too(
    record: Callable[..., Path],
) -> None:
    judged = judge_for_report(record(nodes=()))
    assert judged.identical is None
    assert "could not be compared" in judged.recorded
    assert "were not recorded" in judged.recorded
    assert judged.parameters == "the defaults of this version"
