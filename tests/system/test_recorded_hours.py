"""What the programs make of real hours of the real rig, from the file to verdict and forecast, each judged
once; a warning is an error.

Of the forecasts, the limits are promises, not records: bands that promise 90 % hold 87 to 94 % over all hours
and 78 % in each; the leader is worse than the best in hindsight by 4 % at most in the mean; the ν-gap of two
candidates goes with how differently they behave.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from tests.golden import compare, digest
from tests.support.documented_trust import check_trust
from twinmatch.comparing import TrustLevel
from twinmatch.dynamics import Parameters, begin, simulate_closed_loop
from twinmatch.forecasting import Outlook
from twinmatch.importing import open_any
from twinmatch.offline.backtest import Choices, Listener, graded
from twinmatch.offline.backtest.scoring import LEADER, TWINS
from twinmatch.offline.judging import Judgement, judge, judge_samples, terms_from_files
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.showing.summary import document
from twinmatch.signals import FloatArray, Sample, Window
from twinmatch.twin import Outcome, Twin, TwinSettings, choose_structure

HEALTHY = (1, 2, 5, 9, 14, 20)
SHORTEST = 2
"""The healthy hour that costs least to judge; the others take a minute."""
OTHERS = tuple(number for number in HEALTHY if number != SHORTEST)
ALL_HOURS = pytest.mark.long(
    "judges six real hours, and forecasts from every twentieth sample of them"
)
LOST_DRIVE = 27
AHEAD = 300
EVERY = 20
AT = (10, 60, 300)
BEGINNING = 400
"""Samples within which the first window of an hour is complete."""
SETTINGS = TwinSettings()
NOISE = np.array([[SETTINGS.noise.output], [SETTINGS.noise.input]])
BACKTESTED = Choices(every=300.0)


@dataclass
class Hour:
    """One recording, judged once."""

    samples: list[Sample]
    graded: Listener
    judgement: Judgement = field(init=False)
    leading: list[float] = field(default_factory=list)
    """Error of the leader over the next 300 s, after every verdict on a window that moved."""
    best: list[float] = field(default_factory=list)
    """Of the best candidate in hindsight."""
    decided: list[bool] = field(default_factory=list)
    inside: list[list[bool]] = field(default_factory=list)
    """Whether output and input lay in the band at 10, 60 and 300 s."""
    gaps: list[float] = field(default_factory=list)
    apart: list[float] = field(default_factory=list)
    """ν-gaps between candidates, and RMS differences of their answers to the hour's set-points."""

    def __post_init__(self) -> None:
        self._signals = np.array(
            [[s.output for s in self.samples], [s.input for s in self.samples]]
        )
        self._reference = np.array([s.reference for s in self.samples])

    def listen(self, twin: Twin, sample: Sample, outcome: Outcome) -> None:
        """Compare what the twin forecasts now with the samples after it."""
        self.graded(twin, sample, outcome)
        k = sample.index - self.samples[0].index
        if k + AHEAD >= len(self.samples):
            return
        coming = slice(k + 1, k + 1 + AHEAD)
        forecaster = twin.discriminator.forecaster
        reference = self._reference[coming]
        signals = self._signals
        for verdict in outcome.verdicts:
            if verdict.stands:
                continue
            errors = {
                name: error(forecaster.outlook(name), reference, signals[:, coming])
                for name in forecaster.names
            }
            self.leading.append(errors[str(verdict.leader)])
            self.best.append(min(errors.values()))
            self.decided.append(verdict.decided)
            start = self.samples[0].output
            answers = [
                answer(c.parameters, self._reference, start) for c in verdict.candidates
            ]
            for i, j in zip(*np.tril_indices(len(answers), -1), strict=True):
                self.gaps.append(verdict.nu_gap[i][j])
                self.apart.append(rms(answers[i] - answers[j]))
        if k % EVERY == 0 and forecaster.leader is not None:
            forecast = forecaster.outlook().forecast(reference)
            bands = ((forecast.output, 0), (forecast.input, 1))
            self.inside.append(
                [
                    b.low[h - 1] <= signals[row, k + h] <= b.high[h - 1]
                    for h in AT
                    for b, row in bands
                ]
            )


def rms(difference: FloatArray) -> float:
    """Of output and input together, in units of their noise."""
    return float(np.sqrt(np.mean(np.square(difference / NOISE))))


def error(outlook: Outlook, reference: FloatArray, came: FloatArray) -> float:
    prediction = outlook.predicted(reference, banded=False)
    return rms(prediction.means - came)


def answer(parameters: Parameters, reference: FloatArray, start: float) -> FloatArray:
    run = simulate_closed_loop(
        parameters, reference, states=begin(parameters, start), law=SETTINGS.law
    )
    return np.stack([run.output, run.input])


@pytest.fixture(scope="module")
def hour(recordings: dict[int, Path]) -> Callable[[int], Hour]:
    """Judge a recorded hour, each but once: `hour(5)`."""

    @cache
    def judged(number: int) -> Hour:
        if number not in recordings:
            pytest.skip(f"recording {number} is not among those present")
        session = open_any(recordings[number])
        samples = list(session.samples)
        measured_hour = Hour(samples, Listener(session.name, SETTINGS, BACKTESTED))
        measured_hour.judgement = judge(
            session, terms_from_files(session), beside=measured_hour.listen
        )
        return measured_hour

    return judged


@pytest.fixture
def hours(hour: Callable[[int], Hour]) -> list[Hour]:
    return [hour(number) for number in HEALTHY]


NUMBERS = [
    pytest.param([SHORTEST], id="shortest"),
    pytest.param(OTHERS, id="others", marks=ALL_HOURS),
]


@pytest.mark.parametrize("numbers", NUMBERS)
def test_a_healthy_hour_has_a_nominal_twin_that_follows_it(
    numbers: Sequence[int], hour: Callable[[int], Hour]
) -> None:
    for number in numbers:
        judgement = hour(number).judgement
        identified = [v for v in judgement.verdicts if not v.stands]
        assert len(identified) >= 8, number
        assert judgement.summary.nominal is not None, number
        assert judgement.summary.fit_y >= 0.97, number
        assert judgement.summary.fit_u >= 0.75, number
        assert not any(v.level is TrustLevel.FAULT for v in judgement.verdicts), number


@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param([SHORTEST], id="shortest"),
        pytest.param([*OTHERS, LOST_DRIVE], id="others", marks=ALL_HOURS),
    ],
)
def test_results_are_the_golden_ones(
    numbers: Sequence[int], hour: Callable[[int], Hour]
) -> None:
    """What `twinmatch replay --json` writes; forecasts that are asked for beside it move no bit."""
    for number in numbers:
        judgement = hour(number).judgement
        written = document(
            judgement.name, judgement.verdicts, judgement.summary, judgement.matches
        )
        as_read = json.loads(json.dumps(written))
        check_trust(as_read["verdicts"])
        different, compared = compare(f"rig_{number}", digest({"replay": as_read}))
        assert not different, f"hour {number}, compared: {compared}"


def test_the_frozen_sensor_at_the_start_of_an_hour_gives_no_candidate(
    recorded_hour: Callable[[int], Window],
) -> None:
    """The first 30 s of recording 1: the camera is frozen, then lags; the window that has them is refused."""
    samples = samples_of(recorded_hour(1))[:BEGINNING]
    first = judge_samples("beginning", samples, SETTINGS).matches[0].match
    assert first.samples[0] < 30
    assert not first.accepted


def test_a_lost_drive_is_reported_in_time_and_never_matched(
    recorded_hour: Callable[[int], Window],
) -> None:
    """Recording 27: lost at 2155 s, visible from about 2235 s, to be reported by 2355 s."""
    samples = samples_of(recorded_hour(LOST_DRIVE))[1500:2700]
    judgement = judge_samples("lost drive", samples, SETTINGS)
    for report in judgement.matches:
        if report.match.samples[1] > 2155:
            assert not report.match.accepted
    assert any(report.match.accepted for report in judgement.matches), (
        "it is healthy before"
    )
    assert all(
        v.level is not TrustLevel.FAULT for v in judgement.verdicts if v.sample <= 2155
    )
    assert any(
        v.level is TrustLevel.FAULT
        for v in judgement.verdicts
        if 2155 < v.sample <= 2355
    )
    after = [v for v in judgement.verdicts if v.sample > 2355]
    assert after
    assert all(v.level is TrustLevel.FAULT for v in after)


def frozen(hour: Window, first: int, last: int) -> Window:
    """The hour as a camera that stops at a sample and continues at another would have shown it."""
    output = hour.output.copy()
    output[first:last] = output[first]
    return replace(hour, outputs=output)


def test_a_sensor_that_freezes_in_a_real_hour_is_reported(
    recorded_hour: Callable[[int], Window],
) -> None:
    samples = samples_of(frozen(recorded_hour(9), 400, 700))[:900]
    verdicts = judge_samples("frozen", samples, TwinSettings()).verdicts
    first_fault = next(v for v in verdicts if v.level is TrustLevel.FAULT)
    assert first_fault.fault == "sensor-frozen"
    assert 400 < first_fault.sample <= 430
    after = [v for v in verdicts if v.sample > 750]
    assert after
    assert all(v.level is not TrustLevel.FAULT for v in after)


def test_structures_are_compared_where_controller_and_twins_are_at_their_end(
    recorded_hour: Callable[[int], Window],
) -> None:
    """The lost drive of recording 27: for minutes the twin's control is the recorded one exactly."""
    window = recorded_hour(LOST_DRIVE).part(2100, 2399)
    choice = choose_structure(window, [Peltier.model("held sink")], thorough=False)
    assert all(np.isfinite(score.held_back).all() for score in choice.scores)


@ALL_HOURS
def test_the_leader_is_hardly_worse_than_the_best_in_hindsight_and_right_when_it_is_decided(
    hours: list[Hour],
) -> None:
    leading = np.concatenate([hour.leading for hour in hours])
    best = np.concatenate([hour.best for hour in hours])
    decided = np.concatenate([hour.decided for hour in hours])
    assert np.mean(leading / best) <= 1.04
    assert np.median(leading) <= 1.35  # 1.29 was measured; the nominal twin has 1.66
    assert decided.mean() > 0.2, "a twin that never decides is right by silence"
    assert np.mean((leading <= 1.03 * best)[decided]) >= 0.9


@ALL_HOURS
def test_bands_hold_what_they_promise(hours: list[Hour]) -> None:
    shares = np.array([np.mean(h.inside, axis=0) for h in hours])
    together = np.mean(np.concatenate([np.array(h.inside) for h in hours]), axis=0)
    assert np.all((together >= 0.87) & (together <= 0.94)), together
    assert shares.min() >= 0.78, shares


@ALL_HOURS
def test_the_gap_goes_with_how_differently_two_candidates_behave(
    hours: list[Hour],
) -> None:
    gaps = np.concatenate([hour.gaps for hour in hours])
    apart = np.concatenate([hour.apart for hour in hours])
    assert spearmanr(gaps, apart).statistic >= 0.6
    assert gaps.max() < 0.9


@pytest.mark.parametrize("number", [SHORTEST, pytest.param(20, marks=ALL_HOURS)])
def test_the_leader_beats_everybody(number: int, hour: Callable[[int], Hour]) -> None:
    """Over five minutes: a smaller error than any peer, near the best twin, an honest band."""
    judged_hour = hour(number)
    at_five_minutes = [
        c
        for c in graded(judged_hour.judgement, judged_hour.graded).cards
        if c.horizon == 300
    ]
    (leader,) = (c for c in at_five_minutes if c.who == LEADER)
    peers = [c for c in at_five_minutes if c.who not in TWINS]
    assert peers
    assert {c.who for c in peers} == {"persistence", "ARX"}
    assert all(c.median > leader.median for c in peers)
    assert leader.ratio < 1.15
    assert leader.coverage_output == pytest.approx(0.9, abs=0.08)
    assert leader.coverage_input == pytest.approx(0.9, abs=0.08)
