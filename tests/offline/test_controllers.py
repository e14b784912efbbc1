"""A controller tried on sessions: profiles, files of laws, what is refused, and the command."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.exchanging import Heaters
from tests.support.laws import kit_session, law_file
from tests.support.places import OTHERS, SHIPPED
from tests.support.plant_files import plant_file
from tests.support.plants import Lag
from tests.support.steps import drive_lost
from twinmatch.controllers import (
    ControllerDecision,
    ControllerError,
    ControllerQuestion,
    CourseFigure,
    TriedTwin,
    law_from,
    try_controller,
)
from twinmatch.dynamics import LinearLaw, PidGains, PlantError, law_of
from twinmatch.errors import TwinmatchError
from twinmatch.offline.controllers import (
    Ground,
    ground_of,
    members_from,
    planned_profile,
    read_law,
    recorded_profile,
    resting_point,
    stepped_profile,
    usual_profile,
)
from twinmatch.offline.track_record import LawThatRan
from twinmatch.plants import Peltier, find_plant
from twinmatch.sessions import Session, read_session, write_session
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings

LEVEL = np.array([45.0, 38.0])


@pytest.fixture(scope="module")
def session() -> Session:
    return read_session(SHIPPED)


@pytest.fixture(scope="module")
def ground(session: Session) -> Ground:
    return ground_of(session)


@pytest.fixture(scope="module")
def members(
    ground: Ground, members_of: Callable[..., tuple[TriedTwin, ...]]
) -> tuple[TriedTwin, ...]:
    return members_of(ground)


def test_the_law_that_ran_is_safe_and_the_same_beside_itself(
    ground: Ground, members: tuple[TriedTwin, ...], tmp_path: Path
) -> None:
    law = read_law(law_file(tmp_path), Peltier, 1.0)
    holding = ground.holding
    references = usual_profile(Peltier, ground.level, 120)
    answer = try_controller(
        members, ControllerQuestion(law, references, references[0], holding, draws=50)
    )
    assert answer.decision is ControllerDecision.SAFE, answer.sentence
    assert answer.guarantee is not None
    assert answer.guarantee.holds
    assert answer.running is not None
    for quantity, figure in answer.courses.figures.items():
        assert figure == pytest.approx(
            answer.running.figures[quantity], rel=1e-6, nan_ok=True
        )
    rested = [replace(member, states=None) for member in members]
    at_rest = try_controller(
        rested,
        ControllerQuestion(law, references[:120], references[0], holding, draws=50),
    )
    still = at_rest.courses.figures[
        CourseFigure("mean squared error", "temperature", "°C²")
    ]
    # in closed loop the noise of the readings moves the plate by less
    assert still.high < 0.1**2


def test_the_cost_of_the_last_part_was_predicted(session: Session) -> None:
    """The law that ran, tried on what the first half has taught, over the set-points of the rest: the
    mean squared error of the recording is in the band, within 1 %."""
    cut = len(session.samples) // 2
    early = ground_of(replace(session, samples=session.samples[:cut]))
    later = session.samples[cut:]
    references = np.array([sample.references for sample in later])
    law = law_of(Peltier, 1.0)
    before = np.array(session.samples[cut - 1].references)
    question = ControllerQuestion(law, references, before, early.holding, draws=50)
    answer = try_controller(members_from(early), question)
    came = (
        np.mean([(s.output - s.reference) ** 2 for s in later])
        - Peltier.output.noise**2
    )
    band = answer.courses.figures[
        CourseFigure("mean squared error", "temperature", "°C²")
    ]
    assert 0.99 * band.low <= came <= 1.01 * band.high


def test_a_session_that_ends_in_a_fault_is_refused(tmp_path: Path) -> None:
    lost = read_session(write_session(tmp_path / "lost", drive_lost()))
    with pytest.raises(
        ControllerError, match=r"its twin ends fault \(the plant shows drive-lost\)"
    ):
        members_from(ground_of(lost))
    assert LawThatRan(ground_of(lost), law_of(Peltier, 1.0), "law").faulty


def test_a_session_whose_twin_is_not_trusted_yet_is_refused(session: Session) -> None:
    short = replace(session, samples=session.samples[:200])
    with pytest.raises(
        ControllerError, match="says what to record until the twin is trusted"
    ):
        members_from(ground_of(short))


def test_the_noise_is_that_of_the_readings(session: Session) -> None:
    rng = np.random.default_rng(1)
    slow = 50.0 + 5.0 * np.sin(np.arange(3000) / 40.0)
    readings = list(session.samples[:1]) * 3000
    noisy = [
        replace(s, outputs=(y + e,))
        for s, y, e in zip(readings, slow, rng.normal(0.0, 0.07, 3000), strict=True)
    ]
    assert Ground(
        replace(session, samples=noisy), Peltier, None
    ).noise == pytest.approx([0.07], rel=0.05)
    still = Ground(replace(session, samples=readings), Peltier, None)
    assert still.noise == pytest.approx([Peltier.output.noise])


def test_profiles_step_one_set_point_at_a_time_or_as_planned() -> None:
    usual = usual_profile(Heaters, LEVEL, 10)
    assert usual.shape == (90, 2)
    steps = usual[::10] - LEVEL
    np.testing.assert_array_equal(steps[[0, 2, 4, 6, 8]], np.zeros((5, 2)))
    np.testing.assert_allclose(
        steps[[1, 3, 5, 7]], [[15.0, 0.0], [-15.0, 0.0], [0.0, 15.0], [0.0, -15.0]]
    )
    planned = planned_profile(
        Heaters, LEVEL, [(0, 45, 38), (4, 50, 38), (8, 50, 40)], 2.0, 3
    )
    np.testing.assert_array_equal(
        planned, [[45, 38], [50, 38], [50, 38], [50, 40], [50, 40], [50, 40], [50, 40]]
    )
    stepped = stepped_profile(Heaters, LEVEL, ["second=40@8", "first=50@4"], 2.0, 3)
    np.testing.assert_array_equal(stepped, planned)


def test_mistakes_in_profiles_are_named(session: Session) -> None:
    with pytest.raises(
        ControllerError,
        match="a row has no level for second; give seconds, then first, second",
    ):
        planned_profile(Heaters, LEVEL, [(0, 45)], 1.0, 10)
    with pytest.raises(
        ControllerError, match="first: profile: row 1: the set-point is 400"
    ):
        planned_profile(Heaters, LEVEL, [(0, 400, 40)], 1.0, 10)
    with pytest.raises(
        ControllerError,
        match="--set third=3@4: give NAME=LEVEL@S, with S in seconds and NAME of",
    ):
        stepped_profile(Heaters, LEVEL, ["third=3@4"], 1.0, 10)
    assert recorded_profile(session).shape == (len(session.samples), 1)


def test_a_law_may_be_a_python_file(tmp_path: Path) -> None:
    path = tmp_path / "law.py"
    path.write_text(
        "from twinmatch.dynamics import PidGains\nloop = PidGains(2, 1, 0, 0, -5, 5, period=0.5)\n"
    )
    assert read_law(path, Lag, 0.5) == PidGains(2, 1, 0, 0, -5, 5, period=0.5)
    assert isinstance(read_law(law_file(tmp_path), Lag, 1.0), LinearLaw)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("absent.json", None, "absent.json: cannot be read: No such file or directory"),
        ("torn.json", '{"kind"', "torn.json: is not valid JSON"),
        ("odd.json", '{"kind": "pid", "kp": 1}', "odd.json: kp: is not a known key"),
        ("none.py", "x = 1", "none.py: has no law; write one such as loop = PidGains"),
        ("wrong.py", "loop = oops", "wrong.py, line 1: "),
        ("slow.py", "from twinmatch.dynamics import PidGains\nloop = PidGains(2, 1, 0, 0, -5, 5, period=3.0)",
         "slow.py: the law runs every 3 s, the samples come every 1 s; give a law with period=1"),
        ("twice.json", '{"kind": "pid", "proportional": 1, "proportional": 9}',
         "twice.json: 'proportional' is given twice; give it once"),
    ],
)  # fmt: skip
def test_mistakes_in_files_of_laws_are_one_line(
    name: str, text: str | None, words: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(TwinmatchError) as caught:
        read_law(path, Lag, 1.0)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_law_in_python_runs_at_its_own_period_or_not_at_all(tmp_path: Path) -> None:
    """One second is what is meant where nothing is said, so it is not taken for another period either."""
    path = tmp_path / "law.py"
    path.write_text(
        "from twinmatch.dynamics import PidGains\nloop = PidGains(2, 1, 0, 0, -5, 5)\n"
    )
    with pytest.raises(
        ControllerError,
        match=r"runs every 1 s, the samples come every 0\.1 s; give a law with",
    ):
        read_law(path, Lag, 0.1)


MATRICES = """from twinmatch.dynamics import LinearLaw
loop = LinearLaw([[1]], [[-1]], [[1]], [[-9]], [[9]], [[1]], [[0]], [0], [0], [0], [100], period=3.0)
"""
BY_KEY = {
    "A": [[1]],
    "B": [[-1]],
    "C": [[1]],
    "D": [[-9]],
    "E": [[9]],
    "F": [[1]],
    "period": 3.0,
}


def test_matrices_of_another_period_are_refused_wherever_a_law_is_given(
    tmp_path: Path,
) -> None:
    """A PID of a plant file is in seconds, and holds at any period."""
    words = (
        "the law runs every 3 s, the samples come every 1 s; give a law with period=1"
    )
    (tmp_path / "law.py").write_text(MATRICES)
    (tmp_path / "law.json").write_text(json.dumps({"kind": "state-space"} | BY_KEY))
    for name in ("law.py", "law.json"):
        with pytest.raises(ControllerError, match=f"{name}: {words}"):
            read_law(tmp_path / name, Lag, 1.0)
        assert read_law(tmp_path / name, Lag, 3.0).period == 3.0
    loop = MATRICES.splitlines()[1]
    changes = (
        ("import Disturbance", "import LinearLaw, Disturbance"),
        ("    structures", f"    {loop}\n    structures"),
    )
    plant = find_plant(str(plant_file(tmp_path, "looped", *changes)))
    with pytest.raises(
        PlantError, match=f"plant looped: {words}, or set loop: unknown"
    ):
        TwinSettings.of(plant)
    assert TwinSettings.of(plant, period=3.0).law is plant.loop
    assert law_of(Peltier, 0.5) == replace(law_of(Peltier, 1.0), period=0.5)


def test_a_law_is_tried_on_a_real_kit_from_its_open_loop_alone(
    members_of: Callable[..., tuple[TriedTwin, ...]], tmp_path: Path
) -> None:
    """The law that ran on it is safe and guaranteed. A law with an observer that corrects the disturbance the
    wrong way fails, as foreign laws did. What the first costs is predicted by the command."""
    path = OTHERS / "tclab_2x2" / "closed_loop_lqg_controller.json"
    ground = ground_of(kit_session("prbs_open_loop", tmp_path))
    references = recorded_profile(kit_session("closed_loop_lqg", tmp_path))
    law = read_law(path, ground.plant, 1.0)
    twins = members_of(ground)
    assert len(twins) == 5
    question = ControllerQuestion(
        law, references[:300], references[0], ground.holding, draws=25
    )
    answer = try_controller(twins, question)
    assert answer.decision is ControllerDecision.SAFE, answer.sentence
    assert answer.guarantee is not None
    assert answer.guarantee.holds
    assert len(ground.unvisited(references)) == 2
    document = json.loads(path.read_text("utf-8"))
    document["K"][2] = [-value for value in document["K"][2]]
    wrong = try_controller(
        twins, replace(question, law=law_from(document, ground.plant, 1.0))
    )
    assert wrong.decision is ControllerDecision.FAILS
    assert wrong.sentence.startswith("fails on 5 of 5 twins")
    assert resting_point(path) == pytest.approx([54.736, 47.904])


def test_what_cannot_be_tried_on_several_loops(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noise = [
        Sample(k, 10**9 * k, (0.0, 0.0), (40.0 + a, 35.0 + b), (30.0, 20.0))
        for k, (a, b) in enumerate(rng.normal(size=(900, 2)))
    ]
    session = replace(
        read_session(write_session(tmp_path / "noise", noise)),
        plant="tclab-both",
        has_reference=False,
    )
    with pytest.raises(
        ControllerError,
        match=r"explains only 0 % of its movement, .* record steps of every input",
    ):
        members_from(ground_of(session))
