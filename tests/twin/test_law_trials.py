"""Samples that a law on trial drove, and the forecasts that nothing is compared with because of it."""

from __future__ import annotations

import pytest

from twinmatch.twin.law_trials import LawTrials


def test_without_a_trial_all_is_compared() -> None:
    trials = LawTrials()
    assert not trials.between(0, 1000)
    assert not trials.why_not_compared(newest=1000, samples=60, horizon=300)


@pytest.mark.parametrize(
    ("first", "last", "drove"),
    [(0, 99, False), (90, 100, True), (150, 160, True), (200, 210, True), (201, 300, False)],
)  # fmt: skip
def test_a_trial_drove_from_its_first_to_its_last_sample(
    first: int, last: int, drove: bool
) -> None:
    trials = LawTrials()
    trials.note(100)
    trials.note(100, 200)
    expected = "a law on trial has driven since sample 100" if drove else ""
    assert trials.between(first, last) == expected


def test_the_newest_of_several_trials_is_named() -> None:
    trials = LawTrials()
    trials.note(100, 200)
    trials.note(300, 400)
    assert trials.between(150, 350).endswith("since sample 300")


def test_while_a_trial_lasts_nothing_is_compared() -> None:
    trials = LawTrials()
    trials.note(100)
    assert trials.why_not_compared(newest=120, samples=10, horizon=50) == (
        "a law is on trial: its samples are not compared with forecasts for the law before"
    )


def test_after_a_trial_nothing_is_compared_until_all_forecasts_are_of_the_law_after_it() -> (
    None
):
    """Ten samples with forecasts up to fifty samples ahead: sample 261 is the first without any from the trial."""
    trials = LawTrials()
    trials.note(100, 200)
    reason = trials.why_not_compared(newest=260, samples=10, horizon=50)
    assert reason == (
        "a law on trial drove until sample 200: "
        "measurements are compared with forecasts again after sample 260"
    )
    assert not trials.why_not_compared(newest=261, samples=10, horizon=50)
