"""What is remembered of the newest samples, and of what was believed before changes."""

from __future__ import annotations

import numpy as np

from twinmatch.health.recent_samples import REMEMBERED, RecentSamples

BETWEEN_ONSETS = 2
"""Samples between two onsets, of a plant as fast as the rig that is sampled once a second."""


def with_beliefs(samples: int) -> RecentSamples:
    """So many samples of one output and two drives; readings and beliefs are the number of their sample."""
    recent = RecentSamples(second=1.0, latest=5)
    for k in range(samples):
        if k and k % recent.between_onsets == 0:
            recent.take_belief(np.array([float(k)]))
        recent.take(np.array([float(k)]), np.array([k, 2.0 * k]))
        recent.take_arrived(np.array([0.5 * k, k]))
    return recent


def test_what_was_believed_before_a_change_is_half_a_minute_older_than_its_onset() -> (
    None
):
    recent = with_beliefs(200)
    assert recent.between_onsets == BETWEEN_ONSETS
    for age in (1, 10, 101):
        believed = recent.believed_before(age)
        assert believed is not None
        onset = 200 - age
        late = onset - REMEMBERED.before - believed[0]
        assert 0.0 <= late < 2 * BETWEEN_ONSETS


def test_before_the_oldest_belief_that_one_counts_and_without_any_none() -> None:
    assert with_beliefs(BETWEEN_ONSETS).believed_before(1) is None
    oldest = with_beliefs(20).believed_before(1000)
    assert oldest is not None
    assert oldest[0] == BETWEEN_ONSETS


def test_samples_are_kept_as_long_as_onsets_are_followed() -> None:
    samples = 2000
    recent = with_beliefs(samples)
    assert recent.reach == REMEMBERED.reach
    assert len(recent.commands) == recent.reach + 5
    for newest in (recent.commands[:, 0], recent.arrived[:, 1], recent.readings_of(0)):
        assert recent.reach <= newest.size < samples
        assert newest[-1] == samples - 1
        assert np.all(np.diff(newest) == 1.0)


def test_after_a_gap_nothing_is_remembered() -> None:
    recent = with_beliefs(100)
    recent.restart()
    assert recent.believed_before(1) is None
    assert (
        recent.commands.size == recent.arrived.size == recent.readings_of(0).size == 0
    )
