"""Candidates that forecast, on a plant whose truth is known."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.support.faulty_rig import profile
from tests.support.rig import rig, run
from twinmatch.comparing import Candidate
from twinmatch.dynamics import Parameters
from twinmatch.forecasting import ForecastError, Outlook
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample
from twinmatch.twin import Forecaster, ForecastSettings, Twin, TwinSettings

RICH = "sink with mass, free ambient, switched drive"
TRUTH = rig(
    RICH,
    seebeck=0.058,
    conductance=0.7,
    heat_capacity=29.0,
    ambient=291.0,
    sink_heat_capacity=300.0,
    sink_convection=3.2,
)
PLAIN = rig(seebeck=0.05, conductance=0.55, heat_capacity=24.0)
GAINS = TwinSettings().law


def hour(seed: int, samples: int = 1700) -> list[Sample]:
    window = run(TRUTH, np.clip(profile(seed, samples), 22.0, 90.0), seed=seed)
    return list(samples_of(window))


def candidates_of(**parameters: Parameters) -> list[Candidate]:
    return [Candidate(name, 50.0, p, None) for name, p in parameters.items()]


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return hour(3)


def test_who_has_the_right_physics_leads(samples: list[Sample]) -> None:
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(plain=PLAIN, truth=TRUTH))
    assert forecaster.leader == "plain", (
        "as long as nothing has come, the one named first"
    )
    for sample in samples[:1500]:
        forecaster.push(sample)
    assert forecaster.leader == "truth"
    plain, truth = forecaster.scores
    assert truth.gain > plain.gain > 0.0
    assert len(truth.gains) == 3
    assert truth.gain == pytest.approx(sum(truth.gains))
    assert forecaster.confidence > 0.9, (
        "the truth is the best in hindsight, and had to be"
    )


def test_only_a_wrong_twin_is_beaten_by_forecasts_that_need_none(
    samples: list[Sample],
) -> None:
    """Its module is three times too strong, so that ten minutes of other levels ahead are nonsense."""
    forecaster = Forecaster(GAINS)
    forecaster.enter(
        candidates_of(wrong=rig(seebeck=0.15, heat_capacity=8.0), truth=TRUTH)
    )
    for sample in samples[:1500]:
        forecaster.push(sample)
    wrong, truth = forecaster.scores
    horizons = forecaster.settings.horizons
    assert not truth.doubts(horizons)
    assert all(skill > 0.9 for skill in truth.persistence_skill[1:])
    assert set(wrong.doubts(horizons)) == set(horizons)
    assert [doubt.certain for doubt in wrong.doubts(horizons).values()] == [True] * 3
    assert re.match(
        r"truth forecasts best: it saves [\d.]+ characters .*, and in \d+ % of cases",
        forecaster.sentence,
    )


def test_a_leader_that_is_beaten_boasts_of_no_savings() -> None:
    """At rest nobody is better than the newest reading; a twin of another plant is far off."""
    truth = Forecaster(GAINS)
    truth.enter(candidates_of(wrong=rig(seebeck=0.15, heat_capacity=8.0)))
    for sample in samples_of(run(TRUTH, np.repeat([45.0, 46.0], 400), seed=5)):
        truth.push(sample)
    assert truth.scores[0].gain < 0.0
    assert (
        truth.sentence == "wrong forecasts best: it saves 0.00 characters per forecast"
    )


def test_bands_of_the_truth_hold(samples: list[Sample]) -> None:
    """Forecast from every twentieth sample; 65 forecasts that overlap are worth some twenty, so that the
    share within has a standard error of 0.06."""
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH))
    inside = []
    for k, sample in enumerate(samples[:1400]):
        forecaster.push(sample)
        if k % 20 or k < 100:
            continue
        ahead = samples[k + 1 : k + 301]
        forecast = forecaster.outlook().forecast([s.reference for s in ahead])
        for h in (9, 59, 299):
            for band, value in (
                (forecast.output, ahead[h].output),
                (forecast.input, ahead[h].input),
            ):
                inside.append(band.low[h] <= value <= band.high[h])
    assert np.mean(inside) == pytest.approx(0.9, abs=0.1)


@dataclass
class Judged:
    """The whole twin, from nothing, after all samples."""

    twin: Twin
    leaders: list[str | None]
    outlooks: dict[str, Outlook]
    """Of every candidate at sample 711."""


@pytest.fixture(scope="module")
def judged(samples: list[Sample]) -> Judged:
    judgement = Judged(Twin(), [], {})
    for sample in samples:
        judgement.leaders += [v.leader for v in judgement.twin.push(sample).verdicts]
        if sample.index == 711:
            forecaster = judgement.twin.discriminator.forecaster
            judgement.outlooks |= {
                name: forecaster.outlook(name) for name in forecaster.names
            }
    return judgement


def test_a_forecast_knows_nothing_of_what_comes(
    samples: list[Sample], judged: Judged
) -> None:
    """Whether the session is cut there or continues, the bits are the same, for every candidate."""
    cut_twin = Twin()
    for sample in samples[:712]:
        cut_twin.push(sample)
    forecaster = cut_twin.discriminator.forecaster
    assert set(forecaster.names) == set(judged.outlooks)
    for name in forecaster.names:
        whole_forecast, cut_forecast = (
            o.forecast([60.0] * 300)
            for o in (judged.outlooks[name], forecaster.outlook(name))
        )
        for band, cut_band in (
            (whole_forecast.output, cut_forecast.output),
            (whole_forecast.input, cut_forecast.input),
        ):
            for side in ("mean", "low", "high"):
                assert (
                    getattr(band, side).tobytes() == getattr(cut_band, side).tobytes()
                )


def test_the_mean_is_what_the_plant_does_when_nothing_disturbs_it() -> None:
    """A plant without noise, and its own parameters: the observer has nothing to correct."""
    quiet = list(samples_of(run(TRUTH, [40.0] * 200 + [70.0] * 400)))
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH))
    for sample in quiet[:250]:
        forecaster.push(sample)
    forecast = forecaster.outlook().forecast([s.reference for s in quiet[250:550]])
    assert forecast.output.mean == pytest.approx(
        [s.output for s in quiet[250:550]], abs=1e-6
    )
    assert forecast.input.mean == pytest.approx(
        [s.input for s in quiet[250:550]], abs=1e-3
    )


def test_nothing_is_learned_from_a_spoilt_stretch(samples: list[Sample]) -> None:
    forecaster = Forecaster(GAINS, spoilt=lambda _first, _last: True)
    forecaster.enter(candidates_of(truth=TRUTH))
    for sample in samples[:700]:
        forecaster.push(sample)
    assert np.isnan(forecaster.scores[0].gain)
    assert forecaster.scores[0].forecasts == 0.0


def test_what_was_learned_since_a_sample_is_taken_back(samples: list[Sample]) -> None:
    """It is as if the samples since the note before it, at 840, had taught nothing."""
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH, plain=PLAIN))
    for sample in samples[:841]:
        forecaster.push(sample)
    scores = forecaster.scores
    confidence = forecaster.confidence
    widths = forecaster.outlook().widths
    forecaster.enter(candidates_of(truth=TRUTH, plain=PLAIN, late=TRUTH))
    for sample in samples[841:1000]:
        y = (sample.output + 8.0,)
        forecaster.push(replace(sample, outputs=y))
    spoilt_scores = forecaster.scores
    forecaster.forget_since(0)
    assert forecaster.scores == spoilt_scores, "nothing from before it is kept"
    forecaster.forget_since(930)
    truth, plain, late = forecaster.scores
    assert (truth, plain) == scores
    assert (late.gain, late.forecasts) == (0.0, 0.0)
    assert np.isnan(late.coverage).all()
    assert forecaster.confidence == confidence
    np.testing.assert_array_equal(forecaster.outlook("truth").widths, widths)
    for sample in samples[1000:1100]:
        forecaster.push(sample)
    assert forecaster.scores[0].forecasts > truth.forecasts


def test_after_a_gap_it_follows_again_and_keeps_what_it_learned(
    samples: list[Sample],
) -> None:
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH))
    for sample in samples[:800]:
        forecaster.push(sample)
    learned = forecaster.scores[0].forecasts
    for sample in samples[1000:1010]:
        forecaster.push(sample)
    assert forecaster.outlook().sample.index == samples[1009].index
    assert forecaster.scores[0].forecasts == learned
    assert forecaster.check_bands(60) is None, "nothing was forecast since the gap"


def test_a_plant_that_changes_leaves_its_bands(samples: list[Sample]) -> None:
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH))
    misses = []
    for sample in samples[:1200]:
        # From sample 1000 on the camera reads 3 °C too much: thirty times its noise.
        shifted = sample if sample.index < 1000 else Sample(
            sample.index, sample.stamp, sample.reference, sample.output + 3.0, sample.input
        )  # fmt: skip
        forecaster.push(shifted)
        check = forecaster.check_bands(60)
        misses.append(np.nan if check is None else check.miss)
    assert np.nanmax(misses[400:1000]) < 2.0
    assert misses[1030] > 2.0


def test_a_question_too_early_or_to_a_wrong_name_is_refused() -> None:
    forecaster = Forecaster(GAINS)
    with pytest.raises(ForecastError, match="there is no candidate yet"):
        forecaster.outlook()
    forecaster.enter(candidates_of(truth=TRUTH))
    forecaster.push(Sample(0, 0, 40.0, 23.0, 0.0))
    with pytest.raises(
        ForecastError, match="no candidate 'other'; at this sample there are: truth"
    ):
        forecaster.outlook("other")
    with pytest.raises(ForecastError, match="not a list of finite numbers"):
        forecaster.outlook().forecast([40.0, float("nan")])
    with pytest.raises(ForecastError, match=r"every is 0\.0 s; it must be positive"):
        ForecastSettings(every=0.0)


def test_a_forecast_says_that_it_leaves_what_was_visited(samples: list[Sample]) -> None:
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH))
    for sample in samples[:150]:
        forecaster.push(sample)
    reference_now = samples[149].reference
    assert not forecaster.outlook().forecast([reference_now] * 100).notes
    (note,) = forecaster.outlook().forecast([99.0] * 300).notes
    assert "was visited" in note


def test_a_structure_leads_the_family_on_a_rig_that_has_it(judged: Judged) -> None:
    """Structures compete with matches, and the one that is there wins."""
    leaders = judged.leaders
    assert leaders[-1] == RICH
    assert leaders.count(RICH) > len(leaders) / 2
    scores = judged.twin.discriminator.forecaster.scores
    parameters = next(s for s in scores if s.name == RICH).parameters
    for name, tolerance in (
        ("conductance", 0.1),
        ("heat_capacity", 0.25),
        ("seebeck", 0.25),
    ):
        assert parameters[name] == pytest.approx(TRUTH[name], rel=tolerance), name


def test_no_bands_are_compared_once_nobody_leads(samples: list[Sample]) -> None:
    """What the last of the candidates has forecast is still kept; it belongs to a leader no longer."""
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH))
    for sample in samples[:300]:
        forecaster.push(sample)
    assert forecaster.check_bands(60) is not None
    forecaster.enter([])
    assert forecaster.check_bands(60) is None
    assert not forecaster.standings.alone


def test_the_arx_model_from_which_is_forecast_is_fitted_once_at_a_sample(
    samples: list[Sample],
) -> None:
    """A backtest asks for it at samples at which the forecaster has used it."""
    forecaster = Forecaster(GAINS)
    forecaster.enter(candidates_of(truth=TRUTH))
    every = round(forecaster.settings.every / forecaster.period)
    for sample in samples[: 10 * every + 1]:
        forecaster.push(sample)
    at_departure = forecaster.arx
    assert samples[10 * every].index % every == 0
    assert forecaster.arx is at_departure
    following = samples[10 * every + 1]
    forecaster.push(following)
    assert forecaster.arx.standing[0] == following.output
