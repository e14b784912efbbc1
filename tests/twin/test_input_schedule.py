"""When a plant whose loop is not known is looked at: by the steps of its input."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import Lag
from twinmatch.dynamics import Equations, maximum
from twinmatch.dynamics.movement import ExpectedMovement, InputEffect, effect_of
from twinmatch.signals import Sample
from twinmatch.twin import ScheduleSettings
from twinmatch.twin.schedule import Schedule, Trigger

SETTINGS = ScheduleSettings(min_step=10.0)
QUICK = ScheduleSettings(
    stride=15, min_step=10.0, min_span=15, span=60, lead=15, capacity=180
)
"""All times a quarter as long: what holds at any times is shown with a quarter of the samples."""


class Unmoved(Lag, name="unmoved"):
    """Its input is at a limit: it moves nothing there."""

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """The input acts above 5 V only; the plant is linearised at rest."""
        rate = (self.gain * maximum(self.u - 5.0, 0.0) - self.x) / self.lag
        return Equations(rates={self.x: rate}, output=self.x, start={self.x: self.y})


PROMPT = InputEffect(
    np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
)
"""The output follows the input at once, unit by unit."""
CAPACITY = SETTINGS.capacity
SPAN = SETTINGS.span
LEAD = SETTINGS.lead


HARDLY = InputEffect(
    np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.full((1, 1), 0.004)
)
"""What a plant file says of that output whose gain is 250 times too small."""


def run(
    heater: np.ndarray,
    output: np.ndarray | None = None,
    first: int = 0,
    effect: InputEffect = PROMPT,
    settings: ScheduleSettings = SETTINGS,
) -> list[Trigger]:
    schedule = Schedule(settings, effect=effect, width=5.0)
    output = np.zeros(heater.size) if output is None else output
    pushed = (
        schedule.push(Sample(first + k, k, 0.0, float(y), float(u)))
        for k, (u, y) in enumerate(zip(heater, output, strict=True))
    )
    return [t for t in pushed if t is not None]


def excited(heater: np.ndarray) -> list[Trigger]:
    return [t for t in run(heater) if t.excited]


def steps(*levels_and_lengths: tuple[float, int]) -> np.ndarray:
    return np.concatenate([np.full(n, level) for level, n in levels_and_lengths])


def test_an_input_that_stands_still_gives_quiet_triggers_only() -> None:
    triggers = run(steps((50.0, 300)))
    assert [t.sample for t in triggers] == [59, 119, 179, 239, 299]
    assert {t.reason for t in triggers} == {"the input did not move"}


def test_a_step_test_is_judged_as_set_points_are() -> None:
    """When the next step ends a level, or `span` samples after it began; from the session's start on."""
    triggers = excited(steps((0.0, 100), (50.0, 130), (20.0, 300), (80.0, 10)))
    assert [t.sample for t in triggers] == [230, 230 + SPAN]
    assert [(t.window.first, t.window.last) for t in triggers] == [
        (0, 229),
        (0, 230 + SPAN),
    ]


def test_one_level_without_the_way_to_it_has_to_wait() -> None:
    """An input that jumps as the session begins did not rest before: its regime lasts for `span` samples."""
    triggers = excited(
        steps((0.0, 5), (50.0, 195), (20.0, 200), (80.0, 200), (0.0, 10))
    )
    assert [t.sample for t in triggers] == [5 + SPAN, 600]
    assert np.unique(triggers[0].window.input).size == 3


def test_a_window_begins_where_the_input_had_rested() -> None:
    """At 1000 and more samples the first steps are out of reach: it begins before the oldest that is not."""
    triggers = excited(steps((0.0, 300), *((50.0, 350), (20.0, 350)) * 2, (80.0, 300)))
    # The steps come at 300, 650, 1000, 1350 and 1700.
    assert [t.sample for t in triggers] == [540, 890, 1240, 1590, 1940]
    assert [t.window.first for t in triggers] == [0, 280, 630, 980, 1330]


def test_an_input_that_switches_all_the_time_is_judged_every_span() -> None:
    """On for 7 samples and off for 10: nobody can wait for a rest."""
    triggers = excited(np.tile(steps((100.0, 7), (0.0, 10)), 150))
    gaps = np.diff([t.sample for t in triggers])
    assert gaps.min() >= SPAN
    assert gaps.max() <= SPAN + 10  # the next regime begins with the next switch
    assert {len(t.window) for t in triggers[3:]} == {CAPACITY}


def test_noise_is_not_a_step() -> None:
    """A controller's output that trembles: least steps are 20 units of noise."""
    tremble = 50.0 + 0.5 * np.random.default_rng(4).standard_normal(2000)
    assert excited(tremble) == []


def following(heater: np.ndarray, lag: float = 20.0) -> np.ndarray:
    """Readings of a plant with a gain of 1, after its input."""
    output = np.random.default_rng(8).normal(0.0, 0.2, heater.size)
    state = 50.0
    for k in range(heater.size):
        output[k] += state
        state += (heater[k] - state) / lag
    return output


SWITCHED = 50.0 + 40.0 * np.random.default_rng(9).choice([-1.0, 1.0], 1500)
ALTERNATING = np.resize([90.0, 90.0, 10.0, 10.0], 1500) + np.repeat(
    np.resize([0.0, 10.0, -10.0], 30), 50
)


@pytest.mark.parametrize(
    "heater", [SWITCHED, ALTERNATING], ids=["at random", "at every second sample"]
)
def test_what_the_samples_show_counts_where_the_defaults_are_far_off(
    heater: np.ndarray,
) -> None:
    """A gain 250 times too small in the plant file: the input has moved the output all the same, and windows
    come as often as with the right one."""
    output = following(heater)
    shown = [t for t in run(heater, output, effect=HARDLY) if t.excited]
    assert len(shown) >= 4
    assert len(shown) >= len([t for t in run(heater, output) if t.excited]) - 1
    assert shown[0].window.first == 0
    assert shown[0].sample <= 2 * SETTINGS.stride + SPAN


def test_an_output_that_moves_by_itself_is_quiet() -> None:
    wandering = np.cumsum(np.random.default_rng(10).normal(0.0, 2.0, 1500))
    assert not any(t.excited for t in run(SWITCHED, wandering, effect=HARDLY))


def test_what_counts_is_what_the_output_does() -> None:
    """Of a lag with a gain of 2 and a time constant of 5 s: 63 % after 5 s, and never more than twice the
    input's movement. However noisy a drive is said to be, what it moves is a movement."""
    movement = ExpectedMovement(effect_of(Lag, 1.0))
    course = [
        float(movement.take(np.array([u]))[0]) for u in steps((0.0, 3), (10.0, 60))
    ]
    gain = Lag.model().typical()["gain"]
    assert course[3 + 5] == pytest.approx(10.0 * gain * (1.0 - np.exp(-1.0)), rel=1e-3)
    assert course[-1] == pytest.approx(10.0 * gain, rel=1e-3)


def test_equations_that_say_nothing_leave_a_quarter_of_the_range() -> None:
    """A drive that does nothing where the plant is linearised: its range has to do."""
    moved = ExpectedMovement(effect_of(Unmoved, 1.0))
    moved.take(np.zeros(1))
    low, high = Unmoved.drive.limits
    assert moved.take(np.array([(high - low) / 4]))[0] == pytest.approx(
        Unmoved.output.least_step
    )


@pytest.mark.parametrize(("width", "point"), [(5.0, 37.2), (50.0, 37.0), (100.0, 40.0)])
def test_the_operating_point_is_where_the_output_came_to(
    width: float, point: float
) -> None:
    schedule = Schedule(SETTINGS, effect=PROMPT, width=width)
    heater = steps((0.0, 100), (50.0, 300))
    output = np.linspace(20.0, 37.2, 400)
    output[280:] = 37.2
    pushed = [
        schedule.push(Sample(k, k, 0.0, output[k], heater[k])) for k in range(400)
    ]
    assert [t.operating_point for t in pushed if t is not None and t.excited] == [point]


def test_a_gap_starts_over() -> None:
    schedule = Schedule(SETTINGS, effect=PROMPT)
    for k in range(200):
        schedule.push(Sample(k, k, 0.0, 0.0, 50.0 * (k >= 100)))
    later = [
        schedule.push(Sample(1000 + k, k, 0.0, 0.0, 20.0 * (k >= 50)))
        for k in range(400)
    ]
    triggers = [t for t in later if t is not None]
    assert min(t.window.first for t in triggers) == 1000
    assert [t.sample for t in triggers if t.excited] == [1050 + SPAN]


REGIMES = st.lists(
    st.tuples(st.sampled_from([0.0, 4.0, 50.0, 100.0]), st.integers(1, 100)),
    max_size=12,
)


@given(regimes=REGIMES, cut=st.integers(1, 500))
def test_triggers_depend_on_the_samples_before_them_alone(
    regimes: list[tuple[float, int]], cut: int
) -> None:
    heater = steps((0.0, 15), *regimes)
    whole = run(heater, settings=QUICK)
    part = run(heater[:cut], settings=QUICK)
    assert [t.sample for t in part] == [t.sample for t in whole if t.sample < cut]
    for trigger, uncut_trigger in zip(part, whole, strict=False):
        assert (trigger.excited, trigger.window.first) == (
            uncut_trigger.excited,
            uncut_trigger.window.first,
        )
        np.testing.assert_array_equal(trigger.window.input, uncut_trigger.window.input)


@given(regimes=REGIMES)
def test_excited_windows_hold_a_movement_and_do_not_come_too_often(
    regimes: list[tuple[float, int]],
) -> None:
    heater = steps((0.0, 15), *regimes)
    triggers = [t for t in run(heater, settings=QUICK) if t.excited]
    for trigger in triggers:
        assert np.ptp(trigger.window.input) >= 0.1 * QUICK.min_step
        assert len(trigger.window) <= QUICK.capacity
        assert trigger.window.last in {trigger.sample, trigger.sample - 1}
    ends = [t.window.last for t in triggers]
    assert all(b - a >= QUICK.min_span for a, b in itertools.pairwise(ends))
