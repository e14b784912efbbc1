"""The candidates with their windows and models."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.support.rig import rig, run
from twinmatch.comparing import Candidate, Verdict, score
from twinmatch.offline.summary import summarise
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.showing.family import Member, family
from twinmatch.showing.figures.drawing import png, svg
from twinmatch.showing.figures.family import draw_criteria, draw_matrix, draw_responses, draw_uncertainty
from twinmatch.showing.summary import document, sentence
from twinmatch.signals import Sample
from twinmatch.twin import MatchReport, Twin, TwinSettings

GIVEN = Candidate("from the paper", 90.0, rig(seebeck=0.0295, conductance=0.38, heat_capacity=13.7), None)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    reference = np.repeat([30.0, 60.0], [60, 250])
    return samples_of(run(rig(seebeck=0.06, conductance=0.5, heat_capacity=27.0), reference, seed=11))


Judged = tuple[list[MatchReport], list[Verdict]]


@pytest.fixture(scope="module")
def judged(samples: list[Sample]) -> Judged:
    twin = Twin(TwinSettings(), [GIVEN])
    outcomes = [twin.push(sample) for sample in samples]
    return [o.match for o in outcomes if o.match], [v for o in outcomes for v in o.verdicts]


@pytest.fixture(scope="module")
def members(samples: list[Sample], judged: Judged) -> tuple[Member, ...]:
    matches, verdicts = judged
    return family(samples, matches, verdicts[-1], TwinSettings())


def test_matched_and_given_candidates_have_their_window_and_their_own_models(
    members: tuple[Member, ...], judged: Judged
) -> None:
    """The models that are found again explain the measured window exactly as the verdict says."""
    assert [m.score.name for m in members] == ["60 °C", "from the paper"]
    assert [m.match is not None for m in members] == [True, False]
    assert sum(m.nominal for m in members) == 1
    for member in members:
        assert (member.window.first, member.window.last) == judged[0][0].match.samples
        found = [
            score(model, member.measured, 2, absolute=Peltier.output.absolute) for model in member.models
        ]
        assert [s.total.gain for s in found] == [o.total.gain for o in member.score.orders]
        assert [s.u.bic for s in found] == [o.u.bic for o in member.score.orders]


def test_matches_go_into_the_json_with_what_is_known_of_them(judged: Judged, samples: list[Sample]) -> None:
    matches, verdicts = judged
    summary = summarise(samples, verdicts, TwinSettings().gains)
    entry = json.loads(json.dumps(document("s", verdicts, summary, matches), allow_nan=False))
    (match,) = entry["matches"]
    assert match["status"] == "accepted"
    assert match["free"] == ["seebeck", "conductance", "heat_capacity"]
    for name, (low, high) in zip(match["free"], match["intervals"], strict=True):
        value = match["parameters"][name]
        assert low is None or low <= value
        assert high is None or value <= high
    assert entry["summary"]["sentence"] == sentence(summary)


def test_the_simulated_model_is_the_one_of_the_gain(members: tuple[Member, ...]) -> None:
    """Its first samples are the measured ones, which the gain's table copies."""
    member = members[0]
    answer = member.simulated("33331")
    assert answer.output.shape == answer.input.shape == (len(member.window) - 2,)
    np.testing.assert_allclose(answer.output[:4], member.measured.output[:4])
    assert np.sqrt(np.mean((answer.output - member.measured.output) ** 2)) < 1.0


def test_a_candidate_from_before_the_recording_is_left_out(samples: list[Sample], judged: Judged) -> None:
    matches, verdicts = judged
    assert family(samples[100:], matches, verdicts[-1], TwinSettings()) == ()
    assert family(samples, matches, None, TwinSettings()) == ()


def test_the_family_is_drawn(members: tuple[Member, ...], judged: Judged) -> None:
    verdict = judged[1][-1]
    figures = [
        draw_responses(members),
        draw_uncertainty(members),
        draw_criteria(verdict),
        draw_matrix(verdict),
    ]
    for figure in figures:
        assert png(figure, 50).startswith(b"\x89PNG")
    assert svg(draw_matrix(verdict)) == svg(draw_matrix(verdict)), "the same on every run"
