"""Alignment of traces: by hand, against every way there is, and the published twins of the incubator."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.fidelity import fidelity
from tests.support.incubator import FIRST, SECOND, published_twin, read_run
from twinmatch.dynamics import Experiment
from twinmatch.fitting import fit_structure
from twinmatch.plants import Incubator


def test_by_hand() -> None:
    """The twin is a reading late: one gap at either end, three pairs, of which one is off by half."""
    found = fidelity([1.0, 1.0, 2.0, 3.1], [1.0, 2.0, 3.0, 9.0], 0.2, opening=0.3, extending=0.1)
    # 1–1 and 2–2 earn 1 each, 3.1–3.0 earns half; a reading alone at either end costs 0.4.
    assert found.score == pytest.approx(2.5 - 0.8)
    assert found.pairs.tolist() == [[1, 0], [2, 1], [3, 2]]
    assert found.matched == pytest.approx(3 / 4)
    assert found.mean == pytest.approx(0.1 / 3)
    assert found.gaps == 2


def test_gaps_that_cost_too_much_are_not_opened() -> None:
    """Side by side: only the first reading is alike, the pairs after it earn nothing."""
    found = fidelity([1.0, 1.0, 2.0, 3.1], [1.0, 2.0, 3.0, 9.0], 0.2, opening=2.0)
    assert found.gaps == 0
    assert found.matched == pytest.approx(1 / 4)
    assert found.score == pytest.approx(1.0)


readings = st.lists(st.sampled_from([0.0, 0.5, 1.0, 1.5, 3.0]), min_size=1, max_size=5)


@given(twin=readings, plant=readings, opening=st.sampled_from([0.0, 0.3, 1.0]))
def test_no_way_earns_more(twin: list[float], plant: list[float], opening: float) -> None:
    """Against trying all of them."""

    @cache
    def best(i: int, j: int, last: str) -> float:
        if i == len(twin) and j == len(plant):
            return 0.0
        ways = []
        if i < len(twin) and j < len(plant):
            ways.append(max(1.0 - abs(twin[i] - plant[j]), 0.0) + best(i + 1, j + 1, "pair"))
        if i < len(twin):
            ways.append(best(i + 1, j, "twin") - 0.1 - opening * (last != "twin"))
        if j < len(plant):
            ways.append(best(i, j + 1, "plant") - 0.1 - opening * (last != "plant"))
        return max(ways)

    found = fidelity(twin, plant, 1.0, opening=opening, extending=0.1)
    assert found.score == pytest.approx(best(0, 0, "pair"))


def test_a_trace_is_wholly_like_itself() -> None:
    trace = np.random.default_rng(0).normal(size=300)
    found = fidelity(trace, trace, 0.2)
    assert (found.matched, found.mean, found.gaps) == (1.0, 0.0, 0)


@pytest.mark.parametrize(
    ("twin", "options", "words"),
    [
        ([], {"tolerance": 1.0}, "trace of the twin is invalid; give a row of finite readings"),
        ([math.nan], {"tolerance": 1.0}, "trace of the twin is invalid"),
        ([1.0], {"tolerance": 0.0}, "the tolerance is 0.0; it must be positive"),
        ([1.0], {"tolerance": 1.0, "opening": -1.0}, "neither may be negative"),
    ],
)
def test_what_has_no_meaning_is_refused(twin: list[float], options: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        fidelity(twin, [1.0], **options)


THEIR_SCORES = {
    (FIRST, 2): (573.0684, 0.8008),
    (FIRST, 4): (558.7732, 0.7865),
    (SECOND, 2): (391.0504, 0.5424),
    (SECOND, 4): (742.2105, 0.8974),
}
"""Score and share alike by the recurrence of the authors' repository, with its gaps of −1 and −0.1."""


@pytest.mark.parametrize(("name", "parameters"), THEIR_SCORES)
def test_the_score_is_the_authors(incubator_folder: Path, name: str, parameters: int) -> None:
    """Their way back follows one table and not three, so that their pairs do not quite add up to it."""
    score, alike = THEIR_SCORES[name, parameters]
    found = fidelity(*published_twin(incubator_folder, name, parameters), 0.2)
    assert found.score == pytest.approx(score, abs=1e-4)
    assert found.matched == pytest.approx(alike, abs=0.006)


def test_by_the_authors_own_measure_ours_is_more_like_the_box_than_theirs(incubator_folder: Path) -> None:
    """At their tolerance of 0.2 °C, fitted to both runs as theirs."""
    runs = [read_run(incubator_folder, name) for name in (FIRST, SECOND)]
    fitted = fit_structure(runs, Incubator.model("box with mass"))
    for window, name, starts in zip(runs, (FIRST, SECOND), fitted.starts, strict=True):
        theirs = fidelity(*published_twin(incubator_folder, name, 4), 0.2)
        runs_from = Experiment(fitted.parameters, (), window, free_starts=tuple(starts))
        twin = runs_from.simulate(np.array(list(starts.values()))).output
        ours = fidelity(twin, window.output[2:], 0.2)
        assert ours.matched > max(theirs.matched, 0.9)
