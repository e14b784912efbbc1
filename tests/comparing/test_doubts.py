"""When forecasts at a horizon pass the test of trust."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.bank.kits import typical
from twinmatch.comparing import ForecastScore, Shortfall, doubt_words

HORIZON = 10.0
LATER = 60.0
FIGURES_BY_HORIZON = (
    "persistence_skill",
    "persistence_skill_high",
    "arx_skill",
    "arx_skill_high",
    "coverage",
    "independent",
)


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
    """An error of 1.2 times that of ARX: at least 1.02 times, or perhaps 0.95 times."""
    assert not is_trusted(score(arx=(-0.2, -0.02)), before=True)
    assert is_trusted(score(arx=(-0.2, 0.05)), before=True)


def test_the_more_forecasts_have_been_compared_the_closer_to_arx_a_twin_has_to_be() -> (
    None
):
    """An error of 1.07 times that of ARX is chance among few forecasts, and 1.8 standard errors among many."""
    assert is_trusted(score(arx=(-0.07, 0.10)))
    assert not is_trusted(score(arx=(-0.07, -0.005)))


@pytest.mark.parametrize(
    ("sooner", "is_trusted_later"),
    [((-0.8, -0.3), False), ((-0.08, -0.02), True), ((-0.8, 0.1), True)],
    ids=["far behind ARX", "hardly behind ARX", "not surely behind ARX"],
)
def test_where_arx_is_surely_far_better_sooner_nothing_is_trusted_later(
    sooner: tuple[float, float], is_trusted_later: bool
) -> None:
    """Of long forecasts few do not overlap: their own figures say nothing against the twin here."""
    short, long = score(arx=sooner), score(arx=(-0.1, 0.5))
    both = replace(
        short,
        **{
            field: getattr(short, field) + getattr(long, field)
            for field in FIGURES_BY_HORIZON
        },
    )
    doubts = both.doubts([HORIZON, LATER])
    assert (LATER not in doubts) == is_trusted_later
    if not is_trusted_later:
        assert doubt_words({LATER: doubts[LATER]}) == (
            "60 s ahead its forecasts are not surely better than a linear model without physics (ARX), which is "
            "better sooner"
        )


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
def test_what_is_trusted_is_better_than_standing_still_and_not_surely_worse_than_arx(
    persistence: float, wider: float, arx: float, wide: float, before: bool
) -> None:
    """Whatever was trusted before: the figures of this very verdict must allow it."""
    persistence_high = min(persistence + wider, 0.999)
    arx_high = min(arx + wide, 0.999)
    scored = score((persistence, persistence_high), (arx, arx_high))
    if is_trusted(scored, before=before):
        assert persistence > 0.0
        assert math.log(1.0 - arx_high) <= 1e-9


def test_horizons_of_fast_plants_are_said_to_three_digits() -> None:
    worse = Shortfall("its forecasts are off by {}", "2.00", certain=True)
    words = doubt_words({2 / 75: worse, 22500.0: worse})
    assert words == "0.0267 and 22500 s ahead its forecasts are off by 2.00 and 2.00"
