"""What the line makes of real hours of the real rig, from the file to the verdict."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinmatch.discrimination import TrustLevel
from twinmatch.judging.judgement import Judgement, judge_session

HEALTHY = (1, 2, 5, 9, 14, 20)
LOST_DRIVE = 27


def judge(recordings: dict[int, Path], number: int) -> Judgement:
    if number not in recordings:
        pytest.skip(f"recording {number} is not among those present")
    return judge_session(recordings[number])


@pytest.mark.parametrize("number", HEALTHY)
def test_a_healthy_hour_has_a_nominal_twin_that_follows_it(number: int, recordings: dict[int, Path]) -> None:
    judgement = judge(recordings, number)
    identified = [v for v in judgement.verdicts if not v.stands]
    assert len(identified) >= 8
    assert judgement.summary.nominal is not None
    assert judgement.summary.fit_y >= 0.97
    assert judgement.summary.fit_u >= 0.75
    assert not any(v.level is TrustLevel.FAULT for v in judgement.verdicts)


def test_the_frozen_sensor_at_the_start_of_an_hour_gives_no_candidate(recordings: dict[int, Path]) -> None:
    """The first 30 s of recording 1: the camera is frozen, then lags; the window that has them is refused."""
    judgement = judge(recordings, 1)
    first = judgement.matches[0].match
    assert first.samples[0] < 30
    assert not first.accepted


def test_a_lost_drive_is_told_in_time_and_never_matched(recordings: dict[int, Path]) -> None:
    """Recording 27: lost at 2155 s, visible from about 2235 s, to be told by 2355 s."""
    judgement = judge(recordings, LOST_DRIVE)
    for report in judgement.matches:
        if report.match.samples[1] > 2155:
            assert not report.match.accepted
    assert all(v.level is not TrustLevel.FAULT for v in judgement.verdicts if v.sample <= 2155)
    assert any(v.level is TrustLevel.FAULT for v in judgement.verdicts if 2155 < v.sample <= 2355)
    assert all(v.level is TrustLevel.FAULT for v in judgement.verdicts if v.sample > 2355)
