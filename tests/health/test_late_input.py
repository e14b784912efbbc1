"""An input that acts, or is recorded, some seconds apart from what the file says accuses nobody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.abroad import KINDS, AbroadPlant
from tests.support.recorded_kits import kit_rows
from twinmatch.dynamics import advance, begin, read
from twinmatch.health import Alarm, Fault, HealthSettings, Monitor, Refusals
from twinmatch.health.late_input import LateInput, later_inputs
from twinmatch.plants import Peltier, TCLab
from twinmatch.signals import Sample

PERIOD = 5.0
SETTINGS = HealthSettings.of(TCLab, PERIOD)


def kit(delay: int, seed: int, size: int = 480, lost: int = 1_000_000) -> list[Sample]:
    """A kit under steps of its heater, which acts `delay` samples late; one within 15 % of the typical."""
    random = np.random.default_rng(seed)
    typical = TCLab.model("sensor lag").typical()
    moved = {
        n: typical[n] * random.uniform(0.85, 1.15)
        for n in ("losses", "heating", "sensor_lag")
    }
    plant = typical.replace(**moved, ambient=random.uniform(291.0, 298.0))
    states = begin(plant, plant["ambient"] - 273.15)
    power = list[float]()
    while len(power) < size:
        power += [float(random.uniform(0.0, 100.0))] * int(random.integers(8, 30))
    samples = []
    for k in range(size):
        reading = read(plant, states) + 0.1 * random.standard_normal()
        samples.append(Sample(k, round(k * PERIOD * 1e9), reading, reading, power[k]))
        acts = 0.0 if k >= lost else power[max(0, k - delay)]
        states = advance(plant, states, acts, PERIOD)
    return samples


def alarms(samples: list[Sample]) -> tuple[Alarm, ...]:
    monitor = Monitor(SETTINGS)
    for sample in samples:
        monitor.push(sample)
    return monitor.alarms


@pytest.mark.parametrize("seed", [1, 3])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_a_healthy_kit_that_acts_late_is_not_accused(delay: int, seed: int) -> None:
    assert alarms(kit(delay, seed)) == ()


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("delay", [0, 2, 3])
def test_the_delay_is_found(delay: int, seed: int) -> None:
    late = LateInput(SETTINGS.followed, PERIOD)
    for sample in kit(delay, seed):
        late.push(sample)
    assert delay in late.credible
    assert late.delay == delay


def test_nothing_is_known_before_the_input_has_moved_the_plant() -> None:
    late = LateInput(SETTINGS.followed, PERIOD)
    for sample in kit(2, 1, size=20):
        late.push(sample)
    assert len(late.credible) > 3
    assert late.delay == 0


@pytest.mark.parametrize("delay", [0, 2])
def test_a_heater_that_is_lost_is_still_reported(delay: int) -> None:
    for seed in (1, 2):
        samples = kit(delay, seed, size=400, lost=300)[:320]
        kit_alarms = alarms(samples)
        assert {alarm.fault for alarm in kit_alarms} <= {Fault.DRIFT, Fault.DRIVE_LOST}
        assert 300 < kit_alarms[0].flagged <= 300 + (12 + delay)
        assert kit_alarms[-1].fault is Fault.DRIVE_LOST
        assert kit_alarms[-1].flagged <= 300 + (14 + delay)


@pytest.mark.parametrize("name", ["mpc_1", "mpc_44"])
def test_a_real_kit_whose_table_holds_the_input_early_is_not_accused(name: str) -> None:
    rows = kit_rows("tclab_other", name)
    samples = [
        Sample(
            k, round(row["Time"] * 1e9), row["TSP1"], row["T1"], row["Q1"], (row["Q2"],)
        )
        for k, row in enumerate(rows)
    ]
    assert alarms(samples) == ()


def test_lost_samples_leave_the_delay_known() -> None:
    late = LateInput(SETTINGS.followed, PERIOD)
    for sample in kit(2, 1):
        late.push(replace(sample, seen=sample.index % 7 != 3))
    assert late.delay == 2


def test_later_inputs_are_delayed_or_lag_behind() -> None:
    """The lag of first order to a step has the closed form 1 - exp(-t / lag)."""
    step = np.repeat([0.0, 1.0], 30)
    late_versions = list(later_inputs(step, 40, 0.5))
    onsets = [
        int(np.argmax(late))
        for late in late_versions
        if set(late.tolist()) == {0.0, 1.0}
    ]
    # half a second to six seconds: rounded, and none twice
    assert onsets == [11, 12, 13, 14, 16]
    lags = [late for late in late_versions if set(late.tolist()) != {0.0, 1.0}]
    for lag, late in zip([0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 6.0], lags, strict=True):
        np.testing.assert_allclose(
            late[10:], 1.0 - np.exp(-np.arange(1.0, 31.0) / lag), atol=1e-12
        )
        assert not late[:10].any()


def test_an_input_at_rest_is_the_same_however_late() -> None:
    assert all(
        np.array_equal(late, np.full(5, 7.0))
        for late in later_inputs(np.full(9, 7.0), 5, 1.0)
    )


def test_what_a_late_input_explains_is_not_a_change() -> None:
    """Without this rival, a dead time of a rig looks like a shift after 1009 s."""
    plant = AbroadPlant(KINDS["rig"], 500)
    monitor = Monitor(HealthSettings.of(Peltier, 1.0))
    assert plant.lacks == ("dead time",)
    for sample in plant.run(1200):
        monitor.push(sample)
    assert monitor.alarms == ()


def test_a_jump_that_a_late_input_explains_is_plausible() -> None:
    """A motor is reversed, and turns a tenth of a second later: its file says at once."""
    kind = KINDS["motor"]
    plant = AbroadPlant(kind, 503)
    settings = HealthSettings.of(kind.plant, kind.period)
    assert "dead time" in (plant.lacks or ())
    refusals = Refusals(settings, longest=5)
    settled = [refusals.settle(sample) for sample in plant.run(4300)]
    assert not any(sample.refused for sample in settled)
    last = settled[-1]
    spike = replace(
        last,
        index=last.index + 1,
        stamp=last.stamp + 50_000_000,
        outputs=(last.output + 150.0,),
    )
    assert refusals.settle(spike).refused == spike.outputs
