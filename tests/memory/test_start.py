"""What a session starts with: the centre of earlier ones, their spread, and twins of some of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.support.lessons import lesson
from tests.support.rich_rig import RIG
from twinmatch.memory import Lesson, start_from
from twinmatch.memory.start import CENTRE, MAX_SESSIONS, MAX_TWINS, spread_of
from twinmatch.plants import Peltier

RICH = RIG.model
FREE = RICH.structure.free


def taught(
    number: int,
    structure: str = RICH.structure_name,
    *,
    led: bool = True,
    rig: str = "",
    **factors: float,
) -> Lesson:
    """The lesson of a session in which these parameters were so many times those of the rig."""
    model = Peltier.model(structure)
    values = {
        name: RIG.get(name, model.defaults[name]) * factors.get(name, 1.0)
        for name in model.names
    }
    free = model.structure.free
    return lesson(
        number,
        structure,
        equations=model.equations,
        parameters=values,
        free=free,
        covariance=tuple(map(tuple, np.diag([1e-6] * len(free)).tolist())),
        led=led,
        rig=rig,
    )


def test_first_comes_the_centre_of_the_structure_that_led_then_twins_then_other_structures() -> (
    None
):
    lessons = [taught(k, conductance=1.0 + 0.01 * k) for k in range(1, 8)]
    lessons += [taught(k, "held sink", led=False) for k in range(1, 8)]
    start = start_from(lessons, Peltier)
    assert [c.name for c in start] == [
        CENTRE,
        "session run_7",
        "session run_1",
        *[c.name for c in start[3:5]],
        "remembered, held sink",
    ]
    assert len(start) == 2 + MAX_TWINS
    assert start[0].parameters["conductance"] == RIG["conductance"] * 1.04
    assert all(c.remembered for c in start)
    assert (
        start_from(reversed(lessons), Peltier)[0].parameters == start[0].parameters
    ), "dates order, not lists"


def test_a_session_far_off_pulls_neither_centre_nor_spread() -> None:
    steady = [taught(k, conductance=1.0 + 0.01 * (k % 3 - 1)) for k in range(1, 10)]
    odd = [*steady[:-1], taught(9, conductance=0.4)]
    usual, *_ = start_from(steady, Peltier)
    pulled, *_ = start_from(odd, Peltier)
    assert (
        abs(pulled.parameters["conductance"] / usual.parameters["conductance"] - 1.0)
        <= 0.01
    )
    place = FREE.index("conductance")
    # It counts like the expected spread, which counts as one session.
    assert pulled.covariance[place, place] <= 2.0 * usual.covariance[place, place]


def test_sessions_of_other_equations_plants_and_ranges_teach_nothing() -> None:
    fits = taught(1)
    assert start_from([fits], Peltier)
    parts = {name: getattr(fits, name) for name in Lesson.__dataclass_fields__}
    wrong = {"equations": "others", "plant": "tclab", "structure": "no such one"}
    for changes in (
        *({k: v} for k, v in wrong.items()),
        {"parameters": parts["parameters"] | {"seebeck": -1.0}},
    ):
        assert start_from([Lesson(**(parts | changes))], Peltier) == []
    assert start_from([taught(1, led=False)], Peltier) == [], (
        "nothing led: nothing is known to be right"
    )
    unproven = Lesson(**(parts | {"level": "unknown"}))
    assert start_from([unproven], Peltier) == [], "its forecasts did not pass the test"
    assert start_from([], Peltier) == []


def test_only_the_newest_sessions_count_and_equal_names_are_told_apart() -> None:
    old = [taught(k, conductance=0.5) for k in range(1, 50)]
    new = [taught(k) for k in range(100, 100 + MAX_SESSIONS)]
    assert (
        start_from(old + new, Peltier)[0].parameters["conductance"]
        == RIG["conductance"]
    )
    twins = start_from([replace(lesson, name="today") for lesson in new[:2]], Peltier)
    assert [c.name for c in twins] == [CENTRE, "session today", "session today (2)"]


@given(st.integers(1, 12), st.floats(0.0, 0.3), st.integers(0, 2**31))
def test_the_spread_is_that_of_the_sessions_and_never_less_than_few_of_them_can_tell(
    sessions: int, deviation: float, seed: int
) -> None:
    centre = np.array([RIG[name] for name in FREE])
    drawn = centre * (
        1.0
        + deviation * np.random.default_rng(seed).standard_normal((sessions, len(FREE)))
    )
    spread = spread_of(drawn, np.median(drawn, axis=0), RICH)
    spread_if_alike = spread_of(np.tile(centre, (sessions, 1)), centre, RICH)
    assert (spread > 0.0).all()
    sizes = [
        0.15 * (RIG[n] if RICH.declared[n].relative else RICH.declared[n].scale)
        for n in FREE
    ]
    np.testing.assert_allclose(
        spread_if_alike, np.array(sizes) / np.sqrt(sessions), rtol=1e-12
    )
    away = np.abs(drawn - np.median(drawn, axis=0)).max(axis=0)
    assert (
        spread
        <= np.sqrt(
            np.square(away) + np.square(0.15 * np.abs(np.median(drawn, axis=0)) + 1.5)
        )
        + 1e-12
    ).all()
