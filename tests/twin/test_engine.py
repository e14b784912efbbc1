"""One family, one schedule: what a match has to beat, and what is reported about it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import twinmatch.twin.matcher
from twinmatch.comparing import ADMITTED, REFUSED, Candidate, Verdict
from twinmatch.dynamics import Controller, Parameters, advance, begin, read
from twinmatch.plants import Peltier
from twinmatch.signals import Sample, Window
from twinmatch.twin import (
    Discriminator,
    MatchRequest,
    Outcome,
    Twin,
    TwinSettings,
    carry_out,
)


def drive_lost_for_a_while(
    lost_at: int = 550, back_at: int = 570, ticks: int = 1410
) -> list[Sample]:
    """Steps between 40 and 70 °C; the drive is lost for twenty samples and comes back."""
    rig = Peltier.model().parameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
    noise = np.random.default_rng(5).normal(0.0, 0.1, ticks)
    pid = Controller(Peltier.loop)
    states = begin(rig, 22.85)
    samples = []
    for k in range(ticks):
        r = (40.0, 70.0)[(k // 200) % 2]
        y = read(rig, states) + float(noise[k])
        u = pid.step(r, y)[0]
        samples.append(Sample(k, k * 10**9, r, y, u))
        states = advance(rig, states, 0.0 if lost_at <= k < back_at else u, 1.0)
    return samples


@pytest.fixture(scope="module")
def story() -> Iterator[tuple[list[Outcome], list[Any]]]:
    """The outcome of that run, and the rival of every match."""
    rivals: list[Any] = []
    real = twinmatch.twin.matcher.match

    def watched(window: Any, **given: Any) -> Any:
        rivals.append(given["incumbent"])
        return real(window, **given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twinmatch.twin.matcher.match", watched)
        twin = Twin()
        yield [twin.push(sample) for sample in drive_lost_for_a_while()], rivals


def test_what_a_match_has_to_beat_is_in_the_family(
    story: tuple[list[Outcome], list[Any]],
) -> None:
    outcomes, rivals = story
    family: list[Parameters] = []
    verdicts: list[Verdict] = []
    asked = iter(rivals)
    for outcome in outcomes:
        if outcome.match is not None:
            rival = next(asked)
            assert rival is None or rival in family, outcome.match.sample
        verdicts += outcome.verdicts
        family = [c.parameters for c in verdicts[-1].candidates] if verdicts else []
    assert next(asked, None) is None


def test_the_verdict_says_what_became_of_the_match(
    story: tuple[list[Outcome], list[Any]],
) -> None:
    """A window in which the drive was lost is refused, though its samples alone would pass the gate."""
    verdicts = {
        v.sample: v for outcome in story[0] for v in outcome.verdicts if v.match
    }
    faulty = verdicts[1000]
    assert faulty.match == REFUSED
    assert "drive-lost since sample 550" in faulty.reason
    for outcome in story[0]:
        if outcome.match is None:
            continue
        verdict = verdicts[outcome.match.sample]
        joined = [
            c
            for c in verdict.candidates
            if (c.first, c.last) == outcome.match.match.samples
        ]
        assert (verdict.match == ADMITTED) == bool(joined), verdict.sample


def test_a_window_with_a_known_fault_is_not_asked_about(
    story: tuple[list[Outcome], list[Any]],
) -> None:
    asked = [
        outcome.match.match.samples for outcome in story[0] if outcome.match is not None
    ]
    assert asked
    assert not [window for window in asked if window[0] <= 582 and window[1] >= 550]


def test_given_candidates_are_who_a_match_of_their_regime_has_to_beat() -> None:
    candidate = Candidate(
        "given",
        71.0,
        Peltier.model().parameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0),
        None,
    )
    judge = Discriminator(TwinSettings(), [candidate])
    steps = (judge.push_sample(sample) for sample in drive_lost_for_a_while(ticks=500))
    request = next(step.request for step in steps if step.request is not None)
    assert request.operating_point == 70.0
    assert request.incumbent == request.start == candidate.parameters


def test_what_cannot_be_matched_is_refused_in_words() -> None:
    """An answer comes to every request, or the discriminator would wait for ever."""
    window = Window(np.full(9, 50.0), np.full(9, 50.0), np.full(9, 90.0), period=2.0)
    report = carry_out(
        MatchRequest(8, 50.0, window, Peltier.model().parameters(), None),
        TwinSettings(),
    )
    assert not report.match.accepted
    assert "the controller runs every 1.0 s" in report.match.reason
