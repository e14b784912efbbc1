"""Answers before a twin is trusted: the true reason, what to record, and a first PID."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.newcomers import KINDS, PrintedCourse, UnknownPlant, kettle, lead
from tests.support.processes import run_twinmatch
from twinmatch.adding import check_plant, propose
from twinmatch.adding.held_input import begun_at_rest, is_held
from twinmatch.importing.tables import read_table
from twinmatch.offline.separation import inseparable_in
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import parse_map
from twinmatch.signals import Window

GAIN = 1.5
LAG = 80.0
REST = 25.0


def one_step(rest: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """A lag from rest on: so many samples of rest and then of a step to 64, one a second, with noise."""
    inputs = np.concatenate([np.zeros(rest), np.full(step, 64.0)])
    outputs = np.empty(inputs.size)
    level = REST
    for k, command in enumerate(inputs):
        outputs[k] = level
        level += (1.0 - np.exp(-1.0 / LAG)) * (REST + GAIN * command - level)
    return inputs, outputs + np.random.default_rng(3).normal(0.0, 0.1, inputs.size)


def log_file(folder: Path, rest: int, step: int) -> Path:
    """The same as a table."""
    inputs, outputs = one_step(rest, step)
    rows = [
        f"{k},{u:g},{y:.3f}"
        for k, (u, y) in enumerate(zip(inputs, outputs, strict=True))
    ]
    path = folder / f"log_{rest}_{step}.csv"
    path.write_text("\n".join(["time,heater,temperature", *rows]) + "\n", "utf-8")
    return path


@pytest.fixture
def plant_path(tmp_path: Path) -> Path:
    """The file that new-plant writes of the step without rest."""
    log = log_file(tmp_path, 1, 300)
    made = run_twinmatch("new-plant", "stepped", "--from", log, "-o", tmp_path)
    assert made.returncode == 0, made.stderr
    assert "gain and rest cannot be told apart" in made.stdout
    return tmp_path / "stepped.py"


def test_a_drive_that_stood_is_recognised_and_the_plant_taken_as_begun_at_rest(
    tmp_path: Path,
) -> None:
    """The gain is right if the plant rested at first; by least squares it was anything."""
    inputs, outputs = one_step(1, 300)
    assert is_held(inputs)
    assert not is_held(one_step(100, 300)[0])
    assert begun_at_rest(outputs, np.full(300, 0.0), 50.0) is None
    table = read_table(log_file(tmp_path, 1, 300))
    proposal = propose(
        table, parse_map(["time=time", "output=temperature", "input=heater"])
    )
    assert proposal.held
    assert proposal.gain == pytest.approx(GAIN, rel=0.1)
    assert proposal.rest == pytest.approx(REST, abs=1.0)


def test_gain_and_rest_are_told_apart_by_a_rest(plant_path: Path) -> None:
    plant = find_plant(str(plant_path))
    inputs, outputs = one_step(1, 300)
    window = Window(outputs, outputs, inputs, period=1.0)
    inseparable = inseparable_in([window], plant)
    assert inseparable is not None
    assert inseparable.sentence == (
        "gain and rest cannot be told apart: heater stood at 64 for 300 of 301 s"
    )
    inputs, outputs = one_step(150, 300)
    assert inseparable_in([Window(outputs, outputs, inputs, period=1.0)], plant) is None


def test_a_step_without_rest_is_answered(plant_path: Path, tmp_path: Path) -> None:
    """The true reason; rest, then steps within the range; a PID that is safe; and from the others where it is
    said."""
    log = log_file(tmp_path, 1, 300)
    gains = tmp_path / "pid.json"
    document = tmp_path / "answer.json"
    answer = run_twinmatch(
        "experiment", log, "--plant", plant_path, "--pid", gains, "--json", document
    )
    assert answer.returncode == 0, answer.stderr
    first = answer.stdout.splitlines()[0]
    assert (
        first
        == "not trusted yet: gain and rest cannot be told apart: heater stood at 64 for 300 of 301 s"
    )
    course = PrintedCourse.read(answer.stdout)
    assert course.levels[0] == 0.0
    assert course.holds[0] >= 40.0
    assert max(course.levels) > 0.0
    parsed = json.loads(document.read_text("utf-8"))
    assert parsed["inseparable"] == ["gain", "rest"]
    assert parsed["course"]["levels"] == list(course.levels)
    assert json.loads(gains.read_text("utf-8"))["kind"] == "pid"
    session = tmp_path / "session"
    assert (
        run_twinmatch("import", log, "--plant", plant_path, "-o", session).returncode
        == 0
    )
    tried = run_twinmatch(
        "try-controller", session, "--plant", plant_path, "--loop", gains
    )
    assert tried.returncode == 2
    assert "gain and rest cannot be told apart" in tried.stderr
    assert "twinmatch experiment says what to record" in tried.stderr
    checked = run_twinmatch("check-plant", plant_path, "--data", session)
    assert (
        "no window could be matched: gain and rest cannot be told apart"
        in checked.stdout
    )
    assert "did not move far enough" not in checked.stdout


def test_a_plant_file_alone_is_answered(plant_path: Path) -> None:
    answer = run_twinmatch("experiment", "--plant", plant_path)
    assert answer.returncode == 0, answer.stderr
    course = PrintedCourse.read(answer.stdout)
    assert course.levels[0] == 0.0
    assert len(course.levels) == 2
    narrow = run_twinmatch("experiment", "--plant", plant_path, "--within", "20", "60")
    assert PrintedCourse.read(narrow.stdout).levels[1] < course.levels[1]
    nothing = run_twinmatch("experiment")
    assert nothing.returncode == 2
    assert "--plant FILE if nothing is recorded yet" in nothing.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--measured", "hot"], "is not a signal"),
        (["--measured", "t [°C] 90 to 5"], "give the lower end first"),
        (["--measured", "t [°C] a to 5"], "an end that is not a number"),
        (["--measured", "t [°C^] 5 to 90"], "'°C^' is not a known unit"),
        (["--measured", "t [left] 5 to 90"], "'left' is not a known unit"),
        (
            ["--measured", "t [°C] 5 to 90", "--now", "200"],
            "give a reading within 5 to 90",
        ),
        ([], "--nothing-recorded needs --measured and --takes"),
    ],
)
def test_what_is_said_of_a_plant_without_a_recording_is_checked(
    words: list[str], message: str, tmp_path: Path
) -> None:
    takes = ["--takes", "600"] if words else []
    refused = run_twinmatch(
        "new-plant", "bare", "--nothing-recorded", *words, *takes, "-o", tmp_path
    )
    assert refused.returncode == 2
    assert message in refused.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "measured"),
    [
        ("warm_air", "air [°F] 40 to 110"),
        ("warm_block", "block [K] 280 to 400"),
        ("shaft", "speed [rpm] -3000 to 3000"),
        ("filled", "level 0 to 9"),
    ],
)
def test_what_is_written_where_nothing_is_recorded_has_no_findings(
    name: str, measured: str, tmp_path: Path
) -> None:
    """Whatever its unit and range: losses that grow with the distance from rest let no output run away."""
    words = ["--measured", measured, "--moved", "drive [%] 0 to 100", "--takes", "30"]
    made = run_twinmatch(
        "new-plant", name, "--nothing-recorded", *words, "-o", tmp_path
    )
    assert made.returncode == 0, made.stderr
    assert check_plant(find_plant(str(tmp_path / f"{name}.py"))).findings == ()


@pytest.mark.parametrize("kind", [kettle])
def test_a_newcomer_is_led_to_a_trusted_twin_and_a_pid(
    kind: Callable[[np.random.Generator], UnknownPlant], tmp_path: Path
) -> None:
    """With three commands and two recordings; `benchmarks.newcomer` leads twenty, of all kinds."""
    assert kind in KINDS
    led = lead(kind(np.random.default_rng(100)), tmp_path, seed=0)
    assert led.trusted, led.words
    assert led.commands <= 3
    assert led.recordings <= 3
    assert led.kept
    # A PI by Skogestad's rule settles within a few time constants; a tenth is more than the noise.
    assert led.error < 0.1
    assert led.overshoot < 0.3
