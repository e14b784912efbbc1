"""The ν-gaps of a verdict: between which plants, at which points, and who is known how well."""

from __future__ import annotations

import numpy as np
import pytest

from bags.make_four_setpoints import SET_POINTS
from twinmatch.comparing import Candidate, LoopConditions, Verdict, plant_gaps, spans_of
from twinmatch.emulation.virtual_rig import RICH_RIG
from twinmatch.plants import Peltier
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin, TwinSettings

MASSIVE = Peltier.model("sink with mass").parameters(
    seebeck=0.06,
    conductance=0.6,
    heat_capacity=28.0,
    sink_heat_capacity=300.0,
    sink_convection=5.0,
)


@pytest.fixture(scope="module")
def judged(simulated_outcomes: list[Outcome]) -> list[Verdict]:
    return [v for o in simulated_outcomes for v in o.verdicts if not v.stands]


def test_it_is_the_gap_between_the_candidates_plants(judged: list[Verdict]) -> None:
    last = judged[-1]
    settings = TwinSettings()
    terms = LoopConditions(settings.law, spans_of(Peltier), settings.schedule.span)
    recomputed = plant_gaps(
        [c.parameters for c in last.candidates], last.nu_gap_points, terms
    )
    np.testing.assert_array_equal(last.nu_gap, recomputed.matrix)


def test_the_points_are_those_of_the_family_and_the_ends_of_what_was_asked_for(
    judged: list[Verdict],
) -> None:
    for verdict in judged:
        points = {c.operating_point for c in verdict.modelled}
        assert points <= set(verdict.nu_gap_points) <= set(SET_POINTS)
        assert list(verdict.nu_gap_points) == sorted(verdict.nu_gap_points)
    assert judged[-1].nu_gap_points[0] == min(SET_POINTS)
    assert judged[-1].nu_gap_points[-1] == max(SET_POINTS)


def test_the_gap_between_identified_models_stands_beside_it(
    judged: list[Verdict],
) -> None:
    """It chooses nothing, and is one of its own."""
    last = judged[-1]
    identified = np.array(last.identified_gap)
    np.testing.assert_array_equal(identified, identified.T)
    np.testing.assert_allclose(
        [c.identified_gap_sum for c in last.modelled], identified.sum(axis=0)
    )
    assert all(
        0 < c.identified_gap_to_plant <= 1
        for c in last.modelled
        if c.identified_gap_to_plant
    )
    count = len(last.modelled)
    assert not np.allclose(identified, np.array(last.nu_gap)[:count, :count])


def test_what_matches_leave_open_makes_the_intervals(judged: list[Verdict]) -> None:
    for verdict in judged:
        count = len(verdict.modelled)
        gaps = np.array(verdict.nu_gap)[:count, :count]
        low = np.array([c.nu_gap_low for c in verdict.modelled])
        high = np.array([c.nu_gap_high for c in verdict.modelled])
        assert np.all((low <= gaps) & (gaps <= high))
        off_diagonal = ~np.eye(len(gaps), dtype=bool)
        assert np.all((high - low)[off_diagonal] > 0)


def test_the_nominal_plant_is_near_the_rig(judged: list[Verdict]) -> None:
    """The rig has a sink with mass, the candidates have none; a plate half as heavy is farther off."""
    last = judged[-1]
    settings = TwinSettings()
    terms = LoopConditions(settings.law, spans_of(Peltier), settings.schedule.span)
    nominal = next(c.parameters for c in last.candidates if c.name == last.nominal)
    light = nominal.replace(heat_capacity=nominal["heat_capacity"] / 2)
    gaps = plant_gaps([RICH_RIG, nominal, light], last.nu_gap_points, terms).matrix
    assert gaps[0, 1] < 0.5 * gaps[0, 2]


def test_a_given_candidate_of_another_structure_is_compared_and_exact(
    simulated_session: list[Sample],
) -> None:
    candidates = [
        Candidate("massive", 20.0, MASSIVE, None),
        Candidate("again", 100.0, MASSIVE, None),
    ]
    twin = Twin(TwinSettings(), candidates)
    verdicts = [
        v
        for s in simulated_session[:900]
        for v in twin.push(s).verdicts
        if not v.stands
    ]
    last = verdicts[-1]
    names = [c.name for c in last.candidates]
    assert {"massive", "again"} < set(names)
    massive_index = names.index("massive")
    again_index = names.index("again")
    assert last.nu_gap[massive_index][again_index] == 0.0
    assert last.candidates[massive_index].nu_gap_high[again_index] == 0.0
    matched = next(
        k for k, name in enumerate(names) if name not in {"massive", "again"}
    )
    assert 0.0 < last.nu_gap[massive_index][matched] < 1.0
    assert (
        last.candidates[massive_index].nu_gap_low[matched]
        < last.candidates[massive_index].nu_gap_high[matched]
    )
