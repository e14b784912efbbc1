"""What a session says of the law that ran, for everybody who judges it."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from benchmarks.bank.kits import run
from tests.support.laws import kit_session
from tests.support.steps import quarter_of_an_hour
from twinmatch.dynamics import commands_of
from twinmatch.errors import TwinmatchError
from twinmatch.offline.judging import judge_samples, terms_from_files
from twinmatch.parameters.twin import read_settings
from twinmatch.plants.tclab import TCLabBoth
from twinmatch.sessions import Session, read_session, write_session
from twinmatch.sessions.metadata import PLANT, parameters_record
from twinmatch.twin import TwinSettings


def session_with(folder: Path, read_through: str) -> Session:
    """A minute of two heaters, recorded beside a law that takes estimates of these outputs."""
    parameters = {"plant": f'"{TCLabBoth.name}"', "read_through": f'"{read_through}"'}
    records = {
        PLANT: {"plant": TCLabBoth.name},
        parameters_record("/discriminator"): parameters,
    }
    return read_session(
        write_session(folder / "kit", list(run(21, "nothing", 60)), records=records)
    )


@pytest.mark.parametrize("with_file", [False, True])
def test_a_session_that_is_judged_says_that_its_law_ran_on_estimates(
    tmp_path: Path, *, with_file: bool
) -> None:
    """So no window is matched that the live twin has refused for it."""
    config = tmp_path / "twin.yaml"
    config.write_text(
        "/**:\n  ros__parameters: {plant: tclab-both}\n", encoding="utf-8"
    )
    session = session_with(tmp_path, "T1 T2")
    terms = terms_from_files(session, config if with_file else None)
    assert terms.settings.read_through == tuple(TCLabBoth.outputs)


def test_a_law_that_took_its_readings_took_no_estimates(tmp_path: Path) -> None:
    assert terms_from_files(session_with(tmp_path, "")).settings.read_through == ()


def test_an_output_that_the_plant_has_not_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        TwinmatchError, match="read_through has T3, no output of plant tclab-both"
    ):
        terms_from_files(session_with(tmp_path, "T3"))


def test_after_a_law_on_trial_it_is_said_when_forecasts_are_compared_again() -> None:
    """Not that none has ever been compared, beside what they have saved."""
    judged = judge_samples(
        "steps", quarter_of_an_hour(), TwinSettings(), trials={500: 540}
    )
    saved = "characters per forecast"
    after = [
        verdict
        for verdict in judged.verdicts
        if verdict.sample > 540 and saved in verdict.certainty
    ]
    again = "measurements are compared with forecasts again after sample 900"
    reasons = {verdict.level_reason for verdict in after if verdict.sample <= 900}
    assert reasons == {f"a law on trial drove until sample 540: {again}"}
    on_trial = [
        verdict.level_reason for verdict in judged.verdicts if verdict.sample == 540
    ]
    assert on_trial == [
        "a law is on trial: its samples are not compared with forecasts for the law before"
    ]


def test_the_graph_that_plays_a_session_is_given_the_same(tmp_path: Path) -> None:
    replay = pytest.importorskip("twinmatch.launching.replay", reason="no ROS 2 here")
    settings = terms_from_files(session_with(tmp_path, "T2")).settings
    values = replay.values_for_twin(settings)
    assert values["read_through"] == "second_temperature"
    assert ("loop" in values) is (settings.law is None)
    config = tmp_path / "nodes.yaml"
    config.write_text(
        yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8"
    )
    of_nodes = read_settings(config)
    assert of_nodes.read_through == settings.read_through == ("second_temperature",)
    assert (of_nodes.law is None) is (settings.law is None)


def test_the_law_of_a_recording_needs_no_kernel_of_its_own(tmp_path: Path) -> None:
    """Arrays that cannot be written to are another kind for numba, which would compile the law again."""
    terms = terms_from_files(kit_session("closed_loop_lqg", tmp_path, size=300))
    assert terms.settings.law is None
    assert commands_of.signatures  # type: ignore[attr-defined]  # of numba
    for kinds in commands_of.signatures:  # type: ignore[attr-defined]  # of numba
        assert all(kind.mutable for kind in kinds), kinds
