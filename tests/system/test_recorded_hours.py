"""What the line makes of real hours of the real rig, from the file to the verdict; a warning is an error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from twinmatch.comparing import TrustLevel
from twinmatch.offline.judging import Judgement, judge_samples, judge_session
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import TwinSettings, choose_structure

HEALTHY = (1, 2, 5, 9, 14, 20)
LOST_DRIVE = 27


@pytest.fixture(scope="module")
def judge(recordings: dict[int, Path]) -> Callable[[int], Judgement]:
    """Judge a recorded hour, each but once: `judge(5)`."""

    @cache
    def judged(number: int) -> Judgement:
        if number not in recordings:
            pytest.skip(f"recording {number} is not among those present")
        return judge_session(recordings[number])

    return judged


@pytest.mark.parametrize("number", HEALTHY)
def test_a_healthy_hour_has_a_nominal_twin_that_follows_it(
    number: int, judge: Callable[[int], Judgement]
) -> None:
    judgement = judge(number)
    identified = [v for v in judgement.verdicts if not v.stands]
    assert len(identified) >= 8
    assert judgement.summary.nominal is not None
    assert judgement.summary.fit_y >= 0.97
    assert judgement.summary.fit_u >= 0.75
    assert not any(v.level is TrustLevel.FAULT for v in judgement.verdicts)


def test_the_frozen_sensor_at_the_start_of_an_hour_gives_no_candidate(
    judge: Callable[[int], Judgement],
) -> None:
    """The first 30 s of recording 1: the camera is frozen, then lags; the window that has them is refused."""
    judgement = judge(1)
    first = judgement.matches[0].match
    assert first.samples[0] < 30
    assert not first.accepted


def test_a_lost_drive_is_reported_in_time_and_never_matched(judge: Callable[[int], Judgement]) -> None:
    """Recording 27: lost at 2155 s, visible from about 2235 s, to be reported by 2355 s."""
    judgement = judge(LOST_DRIVE)
    for report in judgement.matches:
        if report.match.samples[1] > 2155:
            assert not report.match.accepted
    assert all(v.level is not TrustLevel.FAULT for v in judgement.verdicts if v.sample <= 2155)
    assert any(v.level is TrustLevel.FAULT for v in judgement.verdicts if 2155 < v.sample <= 2355)
    assert all(v.level is TrustLevel.FAULT for v in judgement.verdicts if v.sample > 2355)


def frozen(hour: Window, first: int, last: int) -> Window:
    """The hour as a camera that stops at a sample and continues at another would have shown it."""
    output = hour.output.copy()
    output[first:last] = output[first]
    return replace(hour, output=output)


def test_a_sensor_that_freezes_in_a_real_hour_is_reported(recorded_hour: Callable[[int], Window]) -> None:
    samples = samples_of(frozen(recorded_hour(9), 1000, 1600))[:2000]
    verdicts = judge_samples("frozen", samples, TwinSettings()).verdicts
    told = next(v for v in verdicts if v.level is TrustLevel.FAULT)
    assert told.fault == "sensor-frozen"
    assert 1000 < told.sample <= 1030
    assert all(v.level is not TrustLevel.FAULT for v in verdicts if v.sample > 1650)


def test_structures_are_compared_where_controller_and_twins_are_at_their_end(
    recorded_hour: Callable[[int], Window],
) -> None:
    """The lost drive of recording 27: for minutes the twin's control is the recorded one exactly."""
    window = recorded_hour(LOST_DRIVE).part(2100, 2399)
    choice = choose_structure(window, [Peltier.model("held sink")], thorough=False)
    assert all(np.isfinite(score.loss).all() for score in choice.scores)
