"""What was refused counts nowhere: a twin that met implausible readings ends as one that never saw them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support import untaught
from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.fitting.arx import Arx
from twinmatch.health import Fault
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, Window
from twinmatch.twin import Schedule, Twin, TwinSettings, filled_stretches
from twinmatch.twin.door import Door, filled

SETTINGS = TwinSettings()
LONGEST = SETTINGS.schedule.gap

Judged = tuple[Twin, list[Verdict]]


def judged(samples: list[Sample]) -> Judged:
    twin = Twin()
    return twin, [
        verdict for sample in samples for verdict in twin.push(sample).verdicts
    ]


def spiked(samples: list[Sample], readings: dict[int, float]) -> list[Sample]:
    """The same samples, with other readings at these indices."""
    return [replace(s, outputs=readings.get(s.index, s.output)) for s in samples]


def ending(twin: Twin, verdicts: list[Verdict]) -> tuple[object, ...]:
    """What a user reads at the end: level, leader, nominal, range, and all faults but that of the reading."""
    last = verdicts[-1]
    faults = [
        (alarm.fault, alarm.first)
        for alarm in twin.discriminator.monitor.alarms
        if alarm.fault is not Fault.SENSOR_IMPLAUSIBLE
    ]
    return (
        last.level,
        last.leader,
        last.nominal,
        round(last.held_low, 2),
        round(last.held_high, 2),
        faults,
    )


def test_a_reading_that_is_refused_changes_nothing(
    recorded_hour: Callable[[int], Window],
) -> None:
    """Of a session that begins in the middle of an hour: forecasts are saved at 1800; the drive is lost from
    2235 on."""
    samples = samples_of(recorded_hour(27))[1320:2400]
    instants = (1360, 1559, 1800, 2037, 2240)
    twin, verdicts = judged(
        spiked(samples, {k: samples[k - 1320].output + 30.0 for k in instants})
    )
    alarms = [
        v.sample
        for v in verdicts
        if v.fault == Fault.SENSOR_IMPLAUSIBLE.value and v.fault_since == v.sample
    ]
    assert tuple(sorted(set(alarms))) == instants
    assert ending(twin, verdicts) == ending(*judged(samples))


@given(
    spikes=st.dictionaries(
        st.integers(1, 278),
        st.sampled_from([math.nan, math.inf, -273.15, 400.0, 150.0]),
    ),
    lost=st.sets(st.integers(1, 278), max_size=30),
)
def test_neither_range_nor_windows_hold_a_refused_reading(
    spikes: dict[int, float], lost: set[int], simulated_session: list[Sample]
) -> None:
    session = simulated_session[:280]
    came = [s for s in spiked(session, spikes) if s.index not in lost]
    low = min(s.output for s in session)
    high = max(s.output for s in session)
    door = Door(SETTINGS)
    schedule = Schedule(SETTINGS.schedule)
    arx = Arx(SETTINGS.law, 0.99)
    windows = []
    for sample in came:
        door.push(sample)
        *before, settled = door.settled()
        assert settled.seen == (sample.index not in spikes)
        assert settled.refused == (() if settled.seen else sample.outputs)
        for settled_sample in (*before, settled):
            if settled_sample.usable:
                arx.push(settled_sample)
                trigger = schedule.push(settled_sample)
                windows += [] if trigger is None else [trigger.window]
    assert [(low <= a, b <= high) for a, b in arx.visited] == [(True, True)]
    for window in (*windows, *filled_stretches(came, SETTINGS)):
        measured = [] if window.seen is None else window.received(window.output)
        assert set(window.lost) >= {
            k for k in spikes if window.first <= k <= window.last
        }
        assert all(low <= y <= high for y in measured)
        assert np.all(np.abs(window.output) < 149.0), "nor is one a stand-in's value"


def test_after_more_than_a_gap_may_have_everything_starts_over(
    simulated_session: list[Sample],
) -> None:
    """A camera that has moved by 12 °C is taken again where it is now, but nothing reaches across."""
    moved = {s.index: s.output + 12.0 for s in simulated_session[130:180]}
    door = Door(SETTINGS)
    for sample in spiked(simulated_session[:300], moved):
        door.push(sample)
    came = door.settled()
    refused = [s.index for s in came if s.refused]
    unusable = [s.index for s in came if not s.usable]
    assert refused == [*range(130, 131 + LONGEST), *range(180, 181 + LONGEST)]
    assert unusable == [130 + LONGEST, 180 + LONGEST]
    breaks = [
        after.index for before, after in pairwise(came) if not after.follows(before)
    ]
    assert breaks == [130 + LONGEST, 131 + LONGEST, 180 + LONGEST, 181 + LONGEST]
    stretches = filled_stretches(spiked(simulated_session[:300], moved), SETTINGS)
    assert [(w.first, w.last) for w in stretches] == [
        (0, 129 + LONGEST),
        (131 + LONGEST, 179 + LONGEST),
        (181 + LONGEST, 299),
    ]


def test_a_stand_in_for_a_refused_reading_moves_as_the_plant_does(
    simulated_session: list[Sample],
) -> None:
    """On the way up to a set-point the plate moves by 2 °C a second."""
    step = next(
        k
        for k in range(100, 2000)
        if simulated_session[k].reference > simulated_session[k - 1].reference
    )
    gone = range(step + 3, step + 3 + LONGEST)
    settled = filled(
        spiked(simulated_session[: step + 20], dict.fromkeys(gone, 240.0)), SETTINGS
    )
    error_of_stand_ins = [settled[k].output - simulated_session[k].output for k in gone]
    error_if_held = [
        settled[gone[0] - 1].output - simulated_session[k].output for k in gone
    ]
    assert np.linalg.norm(error_of_stand_ins) < np.linalg.norm(error_if_held) / 3
    assert all(
        s.inputs == true.inputs
        for s, true in zip(settled, simulated_session, strict=False)
    )


@pytest.mark.parametrize("count", [1, LONGEST, 60])
def test_a_sensor_that_fails_from_the_first_sample_is_reported(
    count: int, simulated_session: list[Sample]
) -> None:
    """Nothing stands in for readings before the first that the plant can have."""
    twin, verdicts = judged(
        spiked(simulated_session[:400], dict.fromkeys(range(count), -273.15))
    )
    assert (verdicts[0].sample, verdicts[0].level, verdicts[0].fault) == (
        0,
        TrustLevel.FAULT,
        "sensor-implausible",
    )
    assert all(v.first >= count for v in verdicts if v.match)
    assert twin.discriminator.monitor.alarms[0].last == count - 1


def test_an_input_that_is_not_finite_is_replaced_by_the_one_before(
    simulated_session: list[Sample],
) -> None:
    came = [
        replace(s, inputs=math.nan) if s.index == 50 else s
        for s in simulated_session[:60]
    ]
    settled = filled(came, SETTINGS)[50]
    assert (settled.seen, settled.refused) == (False, came[50].outputs)
    assert settled.input == simulated_session[49].input


def test_a_sample_waits_while_a_verdict_to_come_may_decide_how_it_is_settled() -> None:
    """A plant without a typical twin; also behind a door that has started over."""
    samples = untaught.clean()[:3]
    door = Door(untaught.settings())
    for sample in samples:
        door.push(sample)
    assert door.next(lambda _: False) is None
    assert door.next(lambda index: index < samples[0].index) == samples[0]
    assert door.settled(lambda index: index < samples[0].index) == []
    door.restart()
    assert (door.oldest, door.waiting) == (samples[1], 2)
    assert door.settled() == list(samples[1:])
    assert door.oldest is None
