"""The commands that try and retune controllers: what they print and write, and their exit codes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.support.laws import kit_session, law_file
from tests.support.lessons import comparison, lesson
from tests.support.places import OTHERS, PROJECT, SHIPPED
from tests.support.processes import run_twinmatch
from twinmatch.cli import experiment, main, retune, try_controller
from twinmatch.controllers import (
    ControllerError,
    TriedTwin,
    as_linear,
)
from twinmatch.dynamics import LinearLaw, law_of
from twinmatch.memory import Memory
from twinmatch.offline.controllers import (
    Ground,
    ground_of,
    read_law,
    remembered,
)
from twinmatch.plants import Peltier
from twinmatch.sessions import read_session


@pytest.fixture(scope="module")
def ground() -> Ground:
    return ground_of(read_session(SHIPPED))


@pytest.fixture(scope="module", autouse=True)
def judged_once(members_of: Callable[..., tuple[TriedTwin, ...]]) -> Iterator[None]:
    """Commands get the twins of a session that was judged before."""
    with pytest.MonkeyPatch.context() as patch:
        for command in (try_controller, retune, experiment):
            patch.setattr(command, "members_from", members_of)
        yield


def test_try_controller_has_an_exit_code_for_each_decision(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two laws and a file that is not there; the answer as JSON, and as a figure. One that fails is below."""
    out = tmp_path / "answer.json"
    figure = tmp_path / "answer.svg"
    base = [
        "try-controller",
        str(SHIPPED),
        "--draws",
        "25",
        "--set",
        "temperature=75@60",
    ]
    safe = [
        *base,
        "--loop",
        str(law_file(tmp_path)),
        "--json",
        str(out),
        "--figure",
        str(figure),
    ]
    assert main(safe) == 0
    assert capsys.readouterr().out.startswith(
        "law.json: safe for all that the data allow: stable on "
    )
    document = json.loads(out.read_text("utf-8"))
    assert document["decision"] == "safe"
    assert (
        len(document["t"])
        == len(document["outputs"][0]["median"])
        == len(document["references"][0])
        == 300
    )
    assert {"overshoot", "settling time"} <= {
        row["name"] for row in document["figures"]
    }
    assert figure.read_text("utf-8").count("<svg") == 1
    assert (
        main([*base, "--loop", str(law_file(tmp_path, proportional=150, integral=10))])
        == 3
    )
    assert "undecided: unstable in " in capsys.readouterr().out
    assert main([*base, "--loop", str(tmp_path / "no.json")]) == 2
    assert "cannot be read" in capsys.readouterr().err


def test_an_experiment_is_proposed_in_words_as_json_and_as_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The course in words, as JSON and as a figure; what cannot be asked is one line."""
    out = tmp_path / "course.json"
    figure = tmp_path / "course.svg"
    base = ["experiment", str(SHIPPED)]
    assert (
        main([*base, "--minutes", "2", "--json", str(out), "--figure", str(figure)])
        == 0
    )
    first, *course_lines = capsys.readouterr().out.splitlines()
    assert re.match(
        r"hold temperature \d+ °C for .* bits for structure are expected", first
    )
    assert [line.split(":")[0].strip() for line in course_lines] == [
        "proposed",
        "step",
        "PRBS",
        "nothing",
    ]
    document = json.loads(out.read_text("utf-8"))
    course = document["courses"][0]
    assert document["goal"] == "structure"
    assert len(course["levels"][0]) <= 120
    assert course["bits"] > max(rival["bits"] for rival in document["courses"][1:])
    assert figure.read_text("utf-8").count("<svg") == 1
    undecided = ["--loop", str(law_file(tmp_path, proportional=150, integral=10))]
    assert main([*base, "--minutes", "1", "--for", "controller", *undecided]) == 0
    assert "bits for controller are expected" in capsys.readouterr().out
    for options, words in {
        ("--for", "controller"): "--for controller and --loop FILE belong together",
        ("--for", "fault"): "a drive weaker than that is not confused with it",
        ("--minutes", "0.1"): "6 samples of 1 s; give 30 to 20000 of them",
        ("--within", "60", "50"): "give LOW below HIGH",
        ("--within", "69", "71"): "no course keeps the bands of every twin within",
    }.items():
        assert main([*base, *options]) == 2
        assert words in capsys.readouterr().err
    for options, words in {
        (): "give a SESSION, --plant FILE",
        (str(SHIPPED), "--live"): "--live takes",
    }.items():
        with pytest.raises(SystemExit):
            main(["experiment", *options])
        assert words in capsys.readouterr().err


def test_new_gains_are_tried_at_once_and_can_be_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tuned.json"
    assert main(["retune", str(SHIPPED), "--json", str(path)]) == 0
    first, *lines = capsys.readouterr().out.splitlines()
    assert first.startswith("the mean squared error after a load is ")
    assert any(
        line.strip().startswith("safe for all that the data allow") for line in lines
    )
    law = read_law(path, Peltier, 1.0)
    assert isinstance(law, LinearLaw)
    before = as_linear(law_of(Peltier, 1.0))
    assert 1.0 < law.E[0, 0] / before.E[0, 0] < 2.0


def test_only_a_pid_that_is_known_is_tuned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kit_session("prbs_open_loop", tmp_path)
    assert (
        main(["retune", str(tmp_path / "prbs_open_loop"), "--plant", "tclab-both"]) == 2
    )
    assert (
        "prbs_open_loop: its controller is not a known PID" in capsys.readouterr().err
    )


def test_the_twins_of_earlier_sessions_are_tried_too(
    ground: Ground, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of them is a plate of half the heat capacity: a law that holds all of today's twins fails on it."""
    path = tmp_path / "memory.db"
    model = Peltier.model("held sink")
    with pytest.raises(
        ControllerError, match="remembers nothing of plant peltier; leave --memory out"
    ):
        remembered(ground, path)
    usual = {
        **model.typical(),
        "seebeck": 0.08,
        "conductance": 0.4,
        "heat_capacity": 30.0,
    }
    Memory(path).add(
        lesson(
            k,
            "held sink",
            equations=model.equations,
            parameters=usual | {"heat_capacity": capacity},
            free=model.structure.free,
            covariance=np.diag([1e-6, 1e-4, 0.1]).tolist(),
        )
        for k, capacity in enumerate((30.0, 32.0, 12.0))
    )
    remembered_twins = remembered(ground, path)
    assert [twin.name for twin in remembered_twins][:1] == ["remembered"]
    assert {twin.name for twin in remembered_twins[1:]} >= {"remembered: session run_2"}
    assert remembered_twins[0].covariance is not None
    law = law_file(tmp_path, proportional=60)
    command = [
        "try-controller",
        str(SHIPPED),
        "--loop",
        str(law),
        "--draws",
        "10",
        "--set",
        "temperature=75@60",
    ]
    assert main(command) == 0
    assert main([*command, "--memory", str(path)]) == 1
    printed = capsys.readouterr().out
    assert "law.json: fails on " in printed
    assert "first on remembered: session run_2" in printed


class Prediction(NamedTuple):
    """What was printed and written of a law that had run."""

    cost: float
    """Predicted, °C²."""
    largest: float
    """Largest error that was measured, °C."""
    predicted_largest: float
    comparison: dict[str, Any]
    """As in the JSON file."""


def predict_the_law_that_ran(
    folder: Path, size: int | None = None, draws: int = 125
) -> Prediction:
    """The regulator that ran on a real kit, predicted from the kit's open loop alone; of both recordings the
    first samples, or all."""
    for name in ("prbs_open_loop", "closed_loop_lqg"):
        kit_session(name, folder, size)
    law = OTHERS / "tclab_2x2" / "closed_loop_lqg_controller.json"
    out = folder / "out.json"
    memory = folder / "kit.sqlite"
    command = ["try-controller", str(folder / "prbs_open_loop")]
    command += ["--plant", "tclab-both", "--draws", str(draws)]
    command += ["--came", str(folder / "closed_loop_lqg"), "--loop", str(law)]
    done = run_twinmatch(*command, "--memory", memory, "--json", out)
    assert done.returncode == 0, done.stderr
    line = re.search(
        r"  closed_loop_lqg: predicted cost ([\d.]+) °C² .*: inside; .*; stable, as predicted; "
        r"largest error ([\d.]+), predicted ([\d.]+) °C\n",
        done.stdout,
    )
    assert line, done.stdout
    comparison = json.loads(out.read_text("utf-8"))["comparison"]
    (kept,) = Memory(memory).comparisons("tclab-both")
    assert (kept.measured, kept.inside, kept.name) == (
        comparison["measured"],
        True,
        "closed_loop_lqg",
    )
    cost, largest, predicted_largest = map(float, line.groups())
    return Prediction(cost, largest, predicted_largest, comparison)


def test_what_a_law_cost_was_predicted_and_the_comparison_is_kept(
    tmp_path: Path,
) -> None:
    """Of the first 25 minutes of either recording."""
    prediction = predict_the_law_that_ran(tmp_path, size=1500, draws=25)
    assert prediction.comparison["share"] > 0.8


@pytest.mark.long("two hours of a real kit, as docs/controllers.md quotes them")
def test_a_real_kit_was_predicted_as_its_page_says(tmp_path: Path) -> None:
    """Its cost of 5.16 K² is inside."""
    cost, largest, predicted_largest, comparison = predict_the_law_that_ran(tmp_path)
    # far within its band, 4.5 to 6.7
    assert cost == pytest.approx(5.16, rel=0.05)
    assert largest == 5.19
    assert predicted_largest == pytest.approx(5.19, rel=0.05)
    assert comparison["measured"] == pytest.approx(5.16, abs=0.02)
    quoted = re.search(
        r"closed_loop_lqg: .* (\d+) % of the readings",
        (PROJECT / "docs" / "controllers.md").read_text("utf-8"),
    )
    assert quoted
    # fewer draws than on the page
    assert 100 * comparison["share"] == pytest.approx(float(quoted[1]), abs=2)


def test_a_session_of_another_law_or_the_predicted_one_itself_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("prbs_open_loop", "closed_loop_lqg"):
        kit_session(name, tmp_path, size=300)
    law = OTHERS / "tclab_2x2" / "closed_loop_lqg_controller.json"
    document = json.loads(law.read_text("utf-8"))
    document["Rs"] = (100.0 * np.array(document["Rs"])).tolist()
    other_law = tmp_path / "other.json"
    other_law.write_text(json.dumps(document), "utf-8")
    recorded = tmp_path / "prbs_open_loop"
    command = ["try-controller", str(recorded), "--plant", "tclab-both"]
    came = str(tmp_path / "closed_loop_lqg")
    assert main([*command, "--came", came, "--loop", str(other_law)]) == 2
    assert "another law ran there; give that one" in capsys.readouterr().err
    assert main([*command, "--came", str(recorded), "--loop", str(law)]) == 2
    assert "is a session that it is predicted from" in capsys.readouterr().err


def test_later_answers_are_as_wide_as_the_record_asks_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    memory = Memory(tmp_path / "rig.sqlite")
    for k, measured in enumerate((5.2, 4.1, 8.0)):
        memory.add_comparison(comparison(k, measured=measured))
    command = [
        "try-controller",
        str(SHIPPED),
        "--loop",
        str(law_file(tmp_path)),
        "--draws",
        "10",
    ]
    command += ["--set", "temperature=75@60", "--json", str(out)]
    assert main([*command, "--memory", str(memory.path)]) == 0
    assert json.loads(out.read_text("utf-8"))["widening"] == pytest.approx(3.0)
    assert (
        "3 times as wide as the recordings alone would have them: of 3 sessions"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [(["--draws", "0"], "samples; give at least one draw, and at most 20000000 samples"),
     (["--draws", "100000000"], "controller: 100000000 draws of"),
     (["--set", "temperature=60@1e7"], "profile: its last row is at 1e+07 s; give times of at most 86400 s"),
     (["--set", "x=1@2"], "--set x=1@2: give NAME=LEVEL@S"),
     (["--set", "temperature=500@0"], "temperature: profile: row 1")],
)  # fmt: skip
def test_mistakes_on_the_command_line_are_named(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "try-controller",
                str(SHIPPED),
                "--loop",
                str(law_file(tmp_path)),
                *options,
            ]
        )
        == 2
    )
    assert words in capsys.readouterr().err
