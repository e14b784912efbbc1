"""A session that begins with what earlier ones have shown: right from the first minute, left if wrong."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.support.rich_rig import RIG, recorded
from tests.support.rig import rig
from twinmatch.comparing import Candidate, TrustLevel
from twinmatch.sessions import samples_of
from twinmatch.twin import Twin, TwinSettings
from twinmatch.twin.settings import TwinError

FREE = RIG.model.structure.free
FIRST = 59
"""Sample of the first verdict."""


def remembered(**factors: float) -> list[Candidate]:
    """A centre so many times off the rig, known to some 8 %, and two sessions near it."""
    centre = RIG.replace(
        **{name: RIG[name] * factor for name, factor in factors.items()}
    )
    spread = [1.5 if name == "ambient" else 0.08 * centre[name] for name in FREE]
    near = [
        centre.replace(conductance=centre["conductance"] * share)
        for share in (0.95, 1.05)
    ]
    named = zip(("remembered", "monday", "tuesday"), (centre, *near), strict=True)
    return [
        Candidate(name, 50.0, parameters, None, FREE, np.diag(np.square(spread)))
        for name, parameters in named
    ]


@cache
def judged(*wrong: tuple[str, float], with_memory: bool = True) -> tuple[Twin, list]:
    """The thousand samples of a rig, judged with a memory that is so wrong."""
    twin = Twin(TwinSettings(), remembered(**dict(wrong)) if with_memory else ())
    verdicts = [
        v
        for sample in samples_of(recorded(RIG, seed=5))
        for v in twin.push(sample).verdicts
    ]
    return twin, verdicts


def test_the_first_verdict_trusts_a_remembered_twin() -> None:
    _, (first, *_) = judged()
    assert (first.sample, first.level) == (FIRST, TrustLevel.TRUSTED)
    assert first.leader in {"remembered", "monday", "tuesday"}
    _, (unknown, *_) = judged(with_memory=False)
    assert (unknown.sample, unknown.level) == (FIRST, TrustLevel.UNKNOWN)


def test_matches_are_made_in_the_remembered_structure_and_agree_with_one_another() -> (
    None
):
    twin, verdicts = judged()
    matched = [
        c.parameters
        for c in verdicts[-1].candidates
        if c.last >= c.first and c.chosen_order
    ]
    assert len(matched) >= 3
    assert {parameters.model for parameters in matched} == {RIG.model}
    for name in ("seebeck", "conductance", "heat_capacity"):
        values = np.array([parameters[name] for parameters in matched])
        assert values.max() / values.min() <= 1.25, name
        assert np.median(values) == pytest.approx(RIG[name], rel=0.1), name
    assert (
        twin.discriminator.settings.prior[RIG.model.structure_name]["conductance"].mean
        == RIG["conductance"]
    )


def test_the_same_samples_and_candidates_give_the_same_verdicts() -> None:
    twin = Twin(TwinSettings(), remembered())
    second_run = [
        v
        for sample in samples_of(recorded(RIG, seed=5).part(0, 400))
        for v in twin.push(sample).verdicts
    ]
    for verdict, expected in zip(second_run, judged()[1], strict=False):
        assert (verdict.sample, verdict.leader, verdict.level, verdict.miss_y) == (
            expected.sample,
            expected.leader,
            expected.level,
            pytest.approx(expected.miss_y, abs=0, nan_ok=True),
        )


WRONG = (
    ("seebeck", 1.3),
    ("conductance", 0.7),
    ("heat_capacity", 0.7),
    ("sink_convection", 1.3),
)


def test_another_rigs_memory_is_noticed_named_and_left() -> None:
    twin, verdicts = judged(*WRONG)
    noticed = [
        v
        for v in verdicts
        if "this is not the plant that the memory describes: " in v.certainty
    ]
    assert noticed
    assert noticed[0].sample <= 850, "four steps of the set-point"
    assert verdicts[-1] in noticed, "it stays known"
    names = {score.name for score in verdicts[-1].forecasts}
    assert not names & {"remembered", "monday", "tuesday"}
    leading = next(s for s in verdicts[-1].forecasts if s.name == verdicts[-1].leader)
    if "conductance" in leading.parameters and leading.parameters.model is RIG.model:
        assert abs(leading.parameters["conductance"] / RIG["conductance"] - 1.0) <= 0.15
    assert not any("not the plant" in v.certainty for v in judged()[1]), (
        "the right one is kept"
    )
    assert twin.discriminator.forecaster.leader is not None


def test_settings_that_ask_for_a_structure_keep_it() -> None:
    asked = TwinSettings.of(RIG.model.plant, "sink with mass")
    informed = asked.informed_by(remembered())
    assert informed.start is asked.start
    assert RIG.model.structure_name in informed.prior
    assert asked.informed_by([Candidate("exact", 50.0, rig(), None)]) is asked
    usual = TwinSettings().informed_by(remembered())
    assert (usual.start, usual.free) == (remembered()[0].parameters, FREE)


def test_remembered_twins_of_another_plant_are_refused() -> None:
    from twinmatch.plants import TCLab

    model = TCLab.model()
    kit_candidate = Candidate(
        "kit",
        40.0,
        model.parameters(),
        None,
        model.structure.free,
        np.eye(len(model.structure.free)),
    )
    with pytest.raises(TwinError, match=r"parameters of .*; give"):
        TwinSettings().informed_by([replace(kit_candidate)])
