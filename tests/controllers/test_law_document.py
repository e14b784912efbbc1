"""Laws as documents: the one that ran on a real kit, a regulator, and one line for every mistake."""

from __future__ import annotations

import json
from typing import Any

import control
import numpy as np
import pytest

from tests.support.exchanging import Heaters
from tests.support.places import OTHERS
from tests.support.plants import Lag
from tests.support.recorded_kits import kit_rows
from twinmatch.controllers import ControllerError, law_from
from twinmatch.dynamics import LinearLaw, PlantError, TwoLevel, commands_of

REGULATOR: dict[str, Any] = {
    "A": [[0.98, 0.01], [0.02, 0.97]], "B": [[0.02, 0.0], [0.001, 0.03]], "C": [[1.0, 0.0], [0.0, 1.0]],
    "Bd": [[0.0, 0.0], [0.0, 0.0]], "Cd": [[1.0, 0.0], [0.0, 1.0]],
    "K": [[0.1, 0.0], [0.0, 0.2], [0.3, 0.0], [0.0, 0.4]],
    "u0": [[40.0], [30.0]], "y0": [[50.0], [45.0]], "Qs": [[1.0, 0.0], [0.0, 2.0]],
    "Rs": [[0.1, 0.0], [0.0, 0.1]],
}  # fmt: skip
TWO = {"kind": "two-level", "off": 0, "on": 50, "below": 1}
PID = {"kind": "pid", "proportional": 2.0, "integral": 0.1}


def test_the_regulator_of_a_real_kit_gives_the_commands_that_it_gave() -> None:
    """All 5100 recorded samples, from the recorded readings, to what the author's program rounded."""
    rows = kit_rows("tclab_2x2", "closed_loop_lqg")
    document = json.loads(
        (OTHERS / "tclab_2x2" / "closed_loop_lqg_controller.json").read_text("utf-8")
    )
    law = law_from(document, Heaters, 1.0)
    r = np.array([[row["SP1"], row["SP2"]] for row in rows])
    y = np.array([[row["T1"], row["T2"]] for row in rows])
    u = np.array([[row["Q1"], row["Q2"]] for row in rows])
    commands, _ = commands_of(law.code, np.zeros(4), r, y)
    np.testing.assert_allclose(commands, u, atol=7e-4)


def test_a_regulator_has_the_gain_of_python_control_and_no_offset() -> None:
    law = law_from(REGULATOR, Heaters, 1.0)
    assert isinstance(law, LinearLaw)
    a, b, c = (np.array(REGULATOR[key]) for key in "ABC")
    gain, _, _ = control.dlqr(
        a, b, c.T @ np.array(REGULATOR["Qs"]) @ c, np.array(REGULATOR["Rs"])
    )
    np.testing.assert_allclose(law.C[:, :2], -gain, atol=1e-9)
    # its own model under an output disturbance: the observer finds it, and the outputs reach the set-points
    x = np.zeros(2)
    z = np.zeros(4)
    r = np.array([[53.0, 41.0]])
    for _ in range(2000):
        y = c @ x + [50.0, 45.0] + np.array([1.5, -0.7])
        u, z = commands_of(law.code, z, r, y[None])
        x = a @ x + b @ (u[0] - [40.0, 30.0])
    np.testing.assert_allclose(y, r[0], atol=1e-6)


def test_two_levels_and_matrices_are_read_from_documents() -> None:
    two = law_from(
        {
            "kind": "two-level",
            "off": 0,
            "on": 5,
            "below": 0.5,
            "above": 0.2,
            "least_on": 3,
        },
        Lag,
        2.0,
    )
    assert two == TwoLevel(0.0, 5.0, 0.5, 0.2, least_on=3.0, period=2.0)
    matrices = {
        "kind": "state-space",
        "A": [[1]],
        "B": [[-0.1]],
        "C": [[1]],
        "D": [[-2]],
        "E": [[2]],
        "F": [[0.1]],
    }
    law = law_from(matrices, Lag, 1.0)
    pid = law_from(PID, Lag, 1.0)
    r, y = np.random.default_rng(2).normal(size=(2, 30, 1))
    ours, theirs = (
        commands_of(a_law.code, np.zeros(a_law.n_states), r, y)[0]
        for a_law in (law, pid)
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_pids_side_by_side_become_one_linear_law() -> None:
    gains = {"proportional": 2.0, "integral": 0.1, "filter": 3.0, "weight": 0.5}
    law = law_from(
        {"kind": "pid", "loops": [gains, {**gains, "high": 60}]}, Heaters, 1.0
    )
    assert isinstance(law, LinearLaw)
    np.testing.assert_array_equal(law.high, [100.0, 60.0])
    np.testing.assert_allclose(law.E, np.eye(2))


@pytest.mark.parametrize(
    ("document", "plant", "words"),
    [
        ([1], Lag, "is not an object of keys and values"),
        ({"kind": "fuzzy"}, Lag, "kind: 'fuzzy' is not a kind of law; give one of pid, two-level"),
        ({**PID, "ki": 1.0}, Lag, "ki: is not a known key; there are back_calculation,"),
        ({"kind": "pid", "integral": 1.0}, Lag, "proportional: is missing"),
        ({**PID, "proportional": "2"}, Lag, "proportional: is '2'; give a number"),
        ({**PID, "period": 0.5}, Lag, "the law runs every 0.5 s, the samples come every 1 s"),
        ({**PID, "units": {"u": "%"}}, Lag, "units: u is in %, the plant's is in V; convert the law"),
        ({**PID, "units": {"v": "%"}}, Lag, "units: plant lag has no signal 'v'; it has y, u"),
        (PID, Heaters, "loops: 1 PIDs for 2 outputs; give one for each of first, second"),
        (REGULATOR, Lag, "is a law for 2 outputs, 2 set-points and 2 inputs; plant lag has 1 outputs (y)"),
        ({**REGULATOR, "outputs": ["second", "first"]}, Heaters, "second, first is not the order of plant"),
        ({**REGULATOR, "A": [[1.0]]}, Heaters, "regulator: its matrices do not fit together"),
        ({**REGULATOR, "K": [[1.0, 2.0], [1.0]]}, Heaters, "K: is not a matrix of numbers"),
        ({**TWO, "above": 1}, Lag, "off, on: 0 and 50 are not within -10 to 10"),
        (TWO, Lag, "above: is missing"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(document: Any, plant: Any, words: str) -> None:
    with pytest.raises((ControllerError, PlantError)) as caught:
        law_from(document, plant, 1.0)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
