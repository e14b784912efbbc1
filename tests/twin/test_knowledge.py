"""What is known at a sample: the level and its reason that follow from it, and the verdict."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.support.rig import rig
from twinmatch.comparing import Candidate, ForecastScore, TrustLevel, Verdict
from twinmatch.health import Fault, Health, HealthState
from twinmatch.plants import Peltier
from twinmatch.signals import Sample
from twinmatch.twin import ForecastSettings, Outcome, Twin, TwinSettings
from twinmatch.twin.candidates import CandidatePool
from twinmatch.twin.entrants import Standings
from twinmatch.twin.knowledge import Knowledge, MatchResult, trust_of, verdict_of
from twinmatch.twin.mirror import Residuals
from twinmatch.twin.structures import StructureChoice
from twinmatch.twin.trust import BandCheck, BandHistory

INSIDE = BandCheck(0.6, 0.9, 0.6, 0.9)
OUTSIDE = BandCheck(0.6, 0.9, 3.0, 0.1)
WELL = (0.5, 0.5)
POOR = (-0.5, -0.5)
MIXED = (0.5, -0.5)
UNSURE = (
    "60 s ahead its forecasts are not surely better than saying that nothing changes, "
    "with 1.50 times the error"
)
EVERYWHERE = UNSURE.replace("60", "10 and 60").replace("1.50", "1.50 and 1.50")
BEFORE = "its forecasts have held so far, and were trusted in earlier sessions"
GOOD = (0.9, 20.0)
FEW = "too few of its forecasts have been compared"
ARX = "a linear model without physics (ARX)"
HELD = "measurements lie within the forecast bands"


def score(
    name: str = "leader",
    skill: tuple[float, ...] = WELL,
    high: tuple[float, ...] | None = None,
    structure: str = "plate",
    gain: float = 5.0,
) -> ForecastScore:
    """Beside both baselines the same skill; by default certain."""
    parameters = (
        rig()
        if structure == "plate"
        else Peltier.model(structure).parameters(seebeck=gain / 100)
    )
    ends = skill if high is None else high
    return ForecastScore(
        name, parameters, 0, 299, gain, (gain,), 7.0, skill, skill, ends, ends
    )


def compared(
    errors: tuple[float, float], errs: float, coverage: tuple[float, float]
) -> ForecastScore:
    """At the first horizon, with so many times the errors of both baselines, the standard error of the
    logarithms, a share in the bands, and of how many forecasts; at the second too little is known."""
    skills = [(1.0 - error, math.nan) for error in errors]
    highs = [
        (1.0 - error * math.exp(-1.6448536269514722 * errs), math.nan)
        for error in errors
    ]
    share, number = ((figure, math.nan) for figure in coverage)
    return ForecastScore(
        "leader", rig(), 0, 299, 5.0, (5.0,), 7.0, *skills, *highs, share, number
    )


class Given(Standings):
    """Standings with these scores; the candidate called `leader` leads."""

    def __init__(self, scores: Sequence[ForecastScore]) -> None:
        super().__init__()
        self._given = tuple(scores)

    @property
    def leader(self) -> str | None:
        return "leader"

    @property
    def scores(self) -> tuple[ForecastScore, ...]:
        return self._given


class Said(NamedTuple):
    """What a monitor says beside its judgement."""

    reservation: str = ""
    doubt: str = ""


def knowledge(
    forecasts: Sequence[ForecastScore] | None = None,
    *,
    remembered: bool = False,
    structure: str = "",
    outside: bool = False,
    miss_since: int | None = None,
    reservation: str = "",
    doubt: str = "",
    **changes: Any,
) -> Knowledge:
    """At a sample at which nothing speaks against the leader, but for these changes."""
    settings = TwinSettings(forecasts=ForecastSettings(horizons=(10.0, 60.0)))
    known_before = Candidate(
        "leader", 50.0, rig(), None, ("seebeck",), np.full((1, 1), 1e-6)
    )
    before = [known_before] if remembered else []
    pool = CandidatePool(settings, lambda *_: False, before)
    pool.forecaster.standings = Given((score(),) if forecasts is None else forecasts)
    if structure:
        pool.structures.choice = StructureChoice((), structure, (0, 299))
    history = BandHistory(2.0, 0.1)
    history.lasts = outside
    history.since = miss_since
    fields: dict[str, Any] = {
        **{
            "sample": 300,
            "window": (0, 299),
            "match": MatchResult(),
            "scored": False,
            "dismissed": (),
        },
        **{
            "pool": pool,
            "bands": INSIDE,
            "history": history,
            "residuals": Residuals(0.5, 7.0),
        },
        **{
            "health": None,
            "monitor": Said(reservation, doubt),
            "trial": "",
            "trusted": (),
            "decimals": 2,
        },
    }
    return Knowledge(**fields | changes)


def faulty(fault: Fault, state: HealthState = HealthState.FAULT) -> Health:
    return Health(300, state, fault, 281, "why", math.nan, 0.0)


@pytest.mark.parametrize(
    ("changes", "level", "reason"),
    [
        ({}, TrustLevel.TRUSTED, "measurements lie within the forecast bands"),
        (
            {"bands": BandCheck()},
            TrustLevel.UNKNOWN,
            "no forecast has been compared with measurements yet",
        ),
        (
            {"bands": OUTSIDE, "outside": True},
            TrustLevel.DOUBTFUL,
            "measurements lie outside the forecast bands",
        ),
        (
            {"bands": OUTSIDE, "miss_since": 241},
            TrustLevel.TRUSTED,
            "measurements have just left",
        ),
        ({"forecasts": (score(skill=POOR),)}, TrustLevel.DOUBTFUL, EVERYWHERE),
        (
            {"forecasts": (score(skill=POOR, high=(0.9, 0.9)),)},
            TrustLevel.UNKNOWN,
            EVERYWHERE,
        ),
        (
            {"forecasts": (score(skill=(-0.5, math.nan)),)},
            TrustLevel.DOUBTFUL,
            UNSURE.replace("60", "10"),
        ),
        ({"forecasts": (score(skill=(math.nan, math.nan)),)}, TrustLevel.UNKNOWN, FEW),
        (
            {"forecasts": (score(skill=MIXED),)},
            TrustLevel.TRUSTED,
            f"{HELD}, but {UNSURE}",
        ),
        (
            {"forecasts": (score(), score("other", POOR))},
            TrustLevel.TRUSTED,
            "measurements lie within the",
        ),
        (
            {"health": faulty(Fault.DRIVE_LOST)},
            TrustLevel.FAULT,
            "the plant shows drive-lost",
        ),
        (
            {"health": faulty(Fault.LOSSES_CHANGED)},
            TrustLevel.DOUBTFUL,
            "the plant shows losses-changed",
        ),
        (
            {"health": faulty(Fault.DISTURBANCE)},
            TrustLevel.DOUBTFUL,
            "the plant shows disturbance",
        ),
        (
            {"health": faulty(Fault.DRIVE_LOST, HealthState.SUSPECT)},
            TrustLevel.TRUSTED,
            "measurements lie",
        ),
        # What it did in earlier sessions counts until this one has shown enough, and never against it.
        (
            {"remembered": True, "forecasts": (score(skill=(math.nan, math.nan)),)},
            TrustLevel.TRUSTED,
            BEFORE,
        ),
        (
            {"remembered": True, "forecasts": (compared((0.9, 0.9), 0.1, GOOD),)},
            TrustLevel.TRUSTED,
            BEFORE,
        ),
        (
            {"remembered": True, "forecasts": (compared((1.5, 0.9), 0.1, GOOD),)},
            TrustLevel.DOUBTFUL,
            "10 s ahead",
        ),
        (
            {"remembered": True, "forecasts": (score(skill=POOR, high=(0.9, 0.9)),)},
            TrustLevel.UNKNOWN,
            EVERYWHERE,
        ),
        (
            {"remembered": True, "bands": OUTSIDE, "outside": True},
            TrustLevel.DOUBTFUL,
            "measurements lie outside",
        ),
        (
            {"remembered": True, "bands": BandCheck()},
            TrustLevel.UNKNOWN,
            "no forecast has been compared",
        ),
        (
            {"remembered": True},
            TrustLevel.TRUSTED,
            "measurements lie within the forecast bands",
        ),
        # The first reason that applies is given.
        (
            {"health": faulty(Fault.DRIVE_LOST), "bands": OUTSIDE, "outside": True},
            TrustLevel.FAULT,
            "the plant shows drive-lost",
        ),
        (
            {"reservation": "not yet", "bands": BandCheck()},
            TrustLevel.UNKNOWN,
            "not yet",
        ),
        (
            {"reservation": "not yet"},
            TrustLevel.TRUSTED,
            "measurements lie within the forecast bands",
        ),
        ({"doubt": "readings may be off"}, TrustLevel.DOUBTFUL, "readings may be off"),
        (
            {"doubt": "readings may be off", "health": faulty(Fault.ROOM_CHANGED)},
            TrustLevel.DOUBTFUL,
            "readings may be off",
        ),
        (
            {"doubt": "readings may be off", "health": faulty(Fault.SENSOR_FROZEN)},
            TrustLevel.FAULT,
            "the plant shows sensor-frozen",
        ),
    ],
)
def test_the_level_has_one_reason(
    changes: dict[str, Any], level: TrustLevel, reason: str
) -> None:
    trust = trust_of(knowledge(**changes))
    assert trust.level is level
    assert trust.reason.startswith(reason)
    verdict = verdict_of(knowledge(**changes))
    assert (verdict.level, verdict.level_reason) == trust


@pytest.mark.parametrize(
    ("errors", "errs", "coverage", "new", "standing"),
    [
        # Half the error is 6.9 standard errors, 0.85 of it 1.6: that may stand, but not begin.
        ((0.5, 0.5), 0.1, GOOD, "", ""),
        (
            (0.85, 0.5),
            0.1,
            GOOD,
            "not surely better than saying that nothing changes, with 0.85",
            "",
        ),
        (
            (1.05, 0.5),
            0.1,
            GOOD,
            *["not surely better than saying that nothing changes, with 1.05"] * 2,
        ),
        ((0.5, 0.5), 1.0, GOOD, "not surely better", ""),
        # As good as ARX but for a tenth is enough, unless the difference is sure.
        ((0.5, 1.09), 0.1, (0.9, 20.0), "", ""),
        ((0.5, 1.09), 0.01, (0.9, 20.0), *[f"worse than {ARX}, with 1.09 times"] * 2),
        ((0.5, 1.2), 0.12, (0.9, 20.0), f"worse than {ARX}, with 1.20 times", ""),
        ((0.5, 1.5), 0.1, (0.9, 20.0), *[f"worse than {ARX}, with 1.50 times"] * 2),
        ((0.05, 1.4), 1.0, (0.9, 20.0), "", ""),
        # Of 20 forecasts 90 % are held with a standard error of 0.067, of 2 with one of 0.21.
        ((0.5, 0.5), 0.1, (0.8, 20.0), "its bands hold 80 % of the readings", ""),
        ((0.5, 0.5), 0.1, (0.7, 20.0), *["its bands hold 70 % of the readings"] * 2),
        ((0.5, 0.5), 0.1, (0.7, 2.0), "", ""),
        ((0.5, 0.5), 0.1, (math.nan, math.nan), "", ""),
    ],
)
def test_trusted_is_more_than_chance(
    errors: tuple[float, float],
    errs: float,
    coverage: tuple[float, float],
    new: str,
    standing: str,
) -> None:
    """At a horizon not trusted before, and at one that was."""
    for before, doubt in (((), new), ((10.0,), standing)):
        verdict = verdict_of(
            knowledge(forecasts=(compared(errors, errs, coverage),), trusted=before)
        )
        assert verdict.trusted == (() if doubt else (10.0,))
        assert doubt in verdict.doubts
        assert bool(doubt) == bool(verdict.doubts)
        assert (verdict.level is TrustLevel.TRUSTED) == (not doubt)


def test_a_verdict_names_the_fault_that_there_is_and_not_a_suspicion() -> None:
    named_faults = [
        (v.fault, v.fault_since)
        for state in (HealthState.FAULT, HealthState.SUSPECT)
        for v in [verdict_of(knowledge(health=faulty(Fault.DRIVE_LOST, state)))]
    ]
    assert named_faults == [("drive-lost", 281), ("", None)]


def test_the_parameters_of_the_structure_are_those_of_its_best_twin() -> None:
    sink = "sink with mass"
    worse = score("one", structure=sink, gain=4.0)
    best = score("best", structure=sink, gain=6.0)
    new = dataclasses.replace(score("new", structure=sink, gain=9.0), gain=math.nan)
    scores = (score(gain=99.0), new, worse, best)
    assert (
        verdict_of(knowledge(structure=sink, forecasts=scores)).structure_parameters
        == best.parameters
    )
    assert (
        verdict_of(knowledge(structure=sink, forecasts=scores[:2])).structure_parameters
        == new.parameters
    )
    assert verdict_of(knowledge(structure=sink)).structure_parameters is None
    assert verdict_of(knowledge(forecasts=scores)).structure_parameters is None


def test_the_structure_has_parameters_of_its_own_and_a_leaders_if_it_has_that_structure(
    simulated_outcomes: list[Outcome],
) -> None:
    verdicts = [v for o in simulated_outcomes for v in o.verdicts if v.structure]
    assert verdicts
    for verdict in verdicts:
        assert verdict.structure_parameters is not None
        assert verdict.structure_parameters.model.structure_name == verdict.structure
        assert verdict.leading is not None
        if verdict.leading.parameters.model.structure_name == verdict.structure:
            assert verdict.structure_parameters == verdict.leading.parameters, (
                verdict.sample
            )


def test_a_reading_that_was_refused_widens_no_range(
    simulated_session: list[Sample],
) -> None:
    """The plate may have 120 °C, but cannot have jumped there and back."""
    twin = Twin()
    spike = 911
    verdicts: list[Verdict] = []
    for sample in simulated_session[: spike + 120]:
        reading = 120.0 if sample.index == spike else sample.output
        verdicts += twin.push(dataclasses.replace(sample, outputs=reading)).verdicts
    assert [v.sample for v in verdicts if v.fault == "sensor-implausible"][:1] == [
        spike
    ]
    with_range = [
        v for v in verdicts if v.sample >= spike and not math.isnan(v.held_high)
    ]
    highest = max(s.output for s in simulated_session[: spike + 120])
    assert with_range
    assert {v.sample: v.held_high for v in with_range if v.held_high > highest} == {}
    after = [v for v in verdicts if v.sample > spike and not v.fault]
    assert {v.level for v in after} == {TrustLevel.TRUSTED}, (
        "a refused reading is not a miss of the band"
    )
