"""When forecasts at a horizon pass the test of trust."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.bank.kits import typical
from twinmatch.comparing import ForecastScore
from twinmatch.comparing.verdict import Shortfall, doubt_words

HORIZON = 10.0


def score(
    persistence: tuple[float, float] = (0.9, 0.95),
    arx: tuple[float, float] = (0.5, 0.6),
    coverage: float = 0.9,
) -> ForecastScore:
    """The score at one horizon by skills with the upper ends of their intervals, of many forecasts."""
    return ForecastScore(
        name="twin", parameters=typical(), first=0, last=99, gain=1.0, gains=(1.0,), forecasts=300.0,
        persistence_skill=(persistence[0],), persistence_skill_high=(persistence[1],),
        arx_skill=(arx[0],), arx_skill_high=(arx[1],), coverage=(coverage,), independent=(300.0,),
    )  # fmt: skip


def is_trusted(scored: ForecastScore, *, before: bool = False) -> bool:
    return not scored.doubts([HORIZON], [HORIZON] if before else [])


def test_a_twin_that_was_trusted_is_not_once_arx_is_better_by_the_upper_end_of_its_interval() -> (
    None
):
    """An error of 1.95 times that of ARX, at least 1.3 times: 2.3 standard errors beyond a tenth."""
    assert not is_trusted(score(arx=(-0.95, -0.30)), before=True)
    assert is_trusted(score(arx=(-0.2, 0.05)), before=True)


@pytest.mark.parametrize(
    ("persistence", "arx", "words"),
    [
        (
            (-0.1, -0.02),
            (-0.5, -0.4),
            "a linear model without physics (ARX), with 1.50 times the error",
        ),
        (
            (-0.8, -0.6),
            (-0.5, -0.4),
            "saying that nothing changes, with 1.80 times the error",
        ),
    ],
)
def test_of_two_baselines_the_better_one_is_named(
    persistence: tuple[float, float], arx: tuple[float, float], words: str
) -> None:
    doubt = score(persistence, arx).doubts([HORIZON])[HORIZON]
    assert doubt.words.format(doubt.figure).endswith(words)


@given(
    st.floats(-3.0, 0.99),
    st.floats(0.001, 1.0),
    st.floats(-3.0, 0.99),
    st.floats(0.001, 1.0),
    st.booleans(),
)
def test_what_is_trusted_is_better_than_standing_still_and_about_as_good_as_arx(
    persistence: float, wider: float, arx: float, wide: float, before: bool
) -> None:
    """Whatever was trusted before: the figures of this very verdict must allow it."""
    persistence_high = min(persistence + wider, 0.999)
    arx_high = min(arx + wide, 0.999)
    scored = score((persistence, persistence_high), (arx, arx_high))
    if is_trusted(scored, before=before):
        assert persistence > 0.0
        assert arx >= -0.1 - 1e-9 or math.log(1.0 - arx_high) <= math.log(1.1) + 1e-9


def test_horizons_of_fast_plants_are_said_to_three_digits() -> None:
    worse = Shortfall("its forecasts are off by {}", "2.00", certain=True)
    words = doubt_words({2 / 75: worse, 22500.0: worse})
    assert words == "0.0267 and 22500 s ahead its forecasts are off by 2.00 and 2.00"
