"""When triggers fire, and on which samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.signals import Sample
from twinmatch.twin import Schedule, ScheduleSettings
from twinmatch.twin.schedule import ScheduleError, Trigger


def samples(reference: np.ndarray, first: int = 0) -> list[Sample]:
    return [
        Sample(first + i, i * 10**9, float(r), float(r), 0.0)
        for i, r in enumerate(reference)
    ]


def run(
    reference: np.ndarray, settings: ScheduleSettings | None = None
) -> list[Trigger]:
    schedule = Schedule(settings)
    return [t for t in map(schedule.push, samples(reference)) if t is not None]


def steps(*levels_and_lengths: tuple[float, int]) -> np.ndarray:
    return np.concatenate([np.full(n, level) for level, n in levels_and_lengths])


def test_a_constant_set_point_gives_quiet_triggers_only() -> None:
    triggers = run(steps((50.0, 300)))
    assert [t.sample for t in triggers] == [59, 119, 179, 239, 299]
    assert not any(t.excited for t in triggers)
    assert [(t.window.first, t.window.last) for t in triggers][:2] == [
        (0, 59),
        (60, 119),
    ]


def test_a_regime_is_judged_when_the_next_step_ends_it() -> None:
    excited = [t for t in run(steps((30.0, 100), (50.0, 130), (70.0, 10))) if t.excited]
    assert len(excited) == 1
    assert excited[0].sample == 230
    assert (excited[0].window.first, excited[0].window.last) == (0, 229)
    assert excited[0].operating_point == 50.0


def test_a_long_regime_is_judged_after_span_samples_and_only_once() -> None:
    excited = [
        t
        for t in run(steps((30.0, 100), (50.0, 130), (70.0, 700), (30.0, 5)))
        if t.excited
    ]
    assert [t.sample for t in excited] == [230, 230 + 240]
    # From the lead before the previous regime's step to the span after its own.
    assert (excited[1].window.first, excited[1].window.last) == (80, 470)


def test_a_short_regime_joins_the_next() -> None:
    excited = [t for t in run(steps((30.0, 100), (50.0, 20), (70.0, 400))) if t.excited]
    assert [t.sample for t in excited] == [100 + 240]
    assert excited[0].operating_point == 70.0


def test_a_slow_ramp_is_judged_too() -> None:
    ramp = np.concatenate(
        [np.full(100, 30.0), np.linspace(30.0, 90.0, 900), np.full(300, 90.0)]
    )
    excited = [t for t in run(ramp) if t.excited]
    assert excited
    assert all(np.ptp(t.window.reference) > 2.0 for t in excited)


def test_a_gap_starts_over() -> None:
    schedule = Schedule()
    for sample in samples(steps((30.0, 100), (50.0, 50))):
        schedule.push(sample)
    later = [
        schedule.push(s) for s in samples(steps((50.0, 120), (70.0, 260)), first=1000)
    ]
    triggers = [t for t in later if t is not None]
    assert min(t.window.first for t in triggers) >= 1000
    assert [t.sample for t in triggers if t.excited] == [1120 + 240]


def test_small_changes_are_not_a_step() -> None:
    assert not any(t.excited for t in run(steps((50.0, 300), (50.15, 600))))


def test_a_lesser_step_counts_once_it_has_lasted() -> None:
    """Three quarters of a step for 107 samples say as much as a step for 60: the sum of squares counts. The
    window at 359 was quiet; the regime is counted from there."""
    excited = [t for t in run(steps((50.0, 300), (51.5, 600))) if t.excited]
    assert [t.sample for t in excited] == [360 + 240]


def test_many_small_steps_are_a_movement() -> None:
    """Half a step up and down again, forty times, 20 samples each."""
    excited = [t for t in run(steps(*((50.0, 20), (51.0, 20)) * 20)) if t.excited]
    assert excited
    assert np.ptp(excited[0].window.reference) == 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stride": 0}, "stride is 0"),
        ({"min_step": 0.0}, "min_step is 0.0"),
        ({"span": 720}, "increasing order"),
        ({"min_span": 500}, "increasing order"),
    ],
)
def test_settings_that_cannot_work_are_refused(
    changes: dict[str, float], message: str
) -> None:
    with pytest.raises(ScheduleError, match=message):
        dataclasses.replace(ScheduleSettings(), **changes)  # type: ignore[arg-type]


@given(
    st.lists(
        st.tuples(st.floats(10, 110).map(lambda x: round(x, 1)), st.integers(1, 400)),
        min_size=1,
        max_size=12,
    )
)
def test_windows_are_whole_bounded_and_in_order(
    regimes: list[tuple[float, int]],
) -> None:
    reference = steps(*regimes)
    settings = ScheduleSettings()
    triggers = run(reference, settings)
    for t in triggers:
        assert len(t.window) <= settings.capacity
        assert t.sample - 1 <= t.window.last <= t.sample
        np.testing.assert_array_equal(
            t.window.reference, reference[t.window.first : t.window.last + 1]
        )
        if t.excited:
            assert np.ptp(t.window.reference) >= 0.1 * settings.min_step
    ends = [t.sample for t in triggers]
    assert ends == sorted(set(ends))
    # Nobody waits for a word longer than a stride.
    assert np.all(np.diff([-1, *ends, len(reference) - 1]) <= settings.stride + 1)
