"""Windows and horizons follow the plant's time constant, from 200 Hz to hours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import Lag, Motor, Tank
from tests.support.servo import Servo
from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.dynamics import (
    Equations,
    Parameter,
    Plant,
    PlantError,
    Structure,
    begin,
    simulate_driven,
)
from twinmatch.dynamics.pace import plant_scale, time_constant, time_scale
from twinmatch.forecasting import HORIZONS, leads_of
from twinmatch.health import HealthSettings
from twinmatch.offline.judging import judge_samples
from twinmatch.parameters.twin import (
    recorded_values,
    settings_from,
    twin_table,
    twin_values,
    values_of,
)
from twinmatch.plants import PLANTS, Incubator, Peltier, TCLab
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import ForecastSettings, ScheduleSettings, TwinSettings

CLOCK = 720.0
"""Five seconds become an hour."""


class House(Lag, name="house"):
    """The same plant by a slower clock."""

    lag = Parameter(
        unit="s", default=5.0 * CLOCK, bounds=(0.5 * CLOCK, 50.0 * CLOCK), positive=True
    )


class Shaft(Lag, name="shaft"):
    """Only integrates."""

    structures = {"all": Structure(free=("gain",))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """One line."""
        return Equations(
            rates={self.x: self.gain * self.u}, output=self.x, start={self.x: self.y}
        )


class Stated(Lag, name="stated"):
    """Its file says how slow it is."""

    time_constant = 20.0


@pytest.mark.parametrize(
    ("plant", "period"), [(Peltier, 1.0), (TCLab, 1.0), (Incubator, 3.0)]
)
def test_shipped_plants_keep_their_windows_and_horizons(
    plant: type[Plant], period: float
) -> None:
    settings = TwinSettings.of(plant, period=period)
    assert settings.schedule == replace(
        ScheduleSettings(), min_step=plant.output.least_step
    )
    assert settings.forecasts == ForecastSettings()


@pytest.mark.parametrize(
    ("plant", "seconds"),
    [
        (Lag, 5.0),
        (House, 3600.0),
        (Servo, 0.3),
        (Motor, 0.183),
        (Tank, 47.3),
        (Shaft, 0.0),
        (Stated, 20.0),
    ],
)
def test_the_slow_time_constant_is_that_of_the_equations_or_the_files(
    plant: type[Plant], seconds: float
) -> None:
    """Of a servo it is that of its speed: the angle integrates, and friction makes it faster."""
    assert time_constant(plant) == pytest.approx(seconds, rel=0.01)


def test_what_only_integrates_goes_by_its_samples() -> None:
    assert plant_scale(Shaft, 0.01) == time_scale(0.01) == pytest.approx(0.02)
    assert plant_scale(Shaft, 3600.0) == pytest.approx(720.0)


def test_a_time_constant_is_a_number_of_seconds() -> None:
    with pytest.raises(PlantError, match="`time_constant` is 'slow'; give seconds"):
        type("Slow", (Lag,), {"time_constant": "slow"}, name="slow")


@given(st.floats(0.05, 500.0))
def test_windows_and_horizons_last_some_time_constants(samples: float) -> None:
    """Whatever the number of samples in one; with very few or very many, the number of samples decides."""
    period = 5.0 / samples
    schedule = ScheduleSettings.of(Lag, period)
    forecasts = TwinSettings.of(Lag, period=period).forecasts
    longest = forecasts.horizons[-1] / period
    assert 60 <= round(longest, 6) <= 1200
    assert 432 <= schedule.capacity <= 2880
    assert schedule.span >= 0.95 * schedule.capacity / 3
    if 20 <= samples <= 400:
        assert longest == pytest.approx(3 * samples, abs=0.51)
        assert 7.1 <= schedule.capacity / samples <= 21.7
        assert 2.3 <= schedule.span / samples <= 7.3
        assert schedule.gap / samples <= 0.2
    assert schedule.stride <= longest  # or no forecast were compared at a verdict
    assert forecasts.every >= 10 * period * (1 - 1e-9)
    assert forecasts.memory == pytest.approx(60 * forecasts.every)
    assert leads_of(period / forecasts.scale, round(longest))[-1] == round(longest)


def test_one_setting_lengthens_all_and_what_is_given_wins() -> None:
    given_ = {"plant": "peltier", "schedule.scale": 2.0, "schedule.span": 300}
    settings = settings_from(twin_values("here", given_))
    assert settings.schedule.span == 300
    assert (settings.schedule.capacity, settings.schedule.gap) == (1440, 10)
    assert settings.forecasts.horizons == tuple(2 * h for h in HORIZONS)
    with_horizons = settings_from(
        twin_values("here", given_ | {"forecasts.horizons": [5.0, 50.0]})
    )
    assert with_horizons.forecasts.horizons == (5.0, 50.0)
    assert settings_from(values_of(with_horizons)) == with_horizons


@pytest.mark.parametrize("period", [0.005, 0.01, 1.0, 60.0, 3600.0])
def test_settings_are_recorded_as_they_are(
    period: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    for plant in (Lag, House):
        monkeypatch.setitem(PLANTS, plant.name, plant)
        usual = TwinSettings.of(plant, period=period)
        read_back = settings_from(values_of(usual))
        assert (read_back.schedule, read_back.forecasts) == (
            usual.schedule,
            usual.forecasts,
        )


def test_sessions_without_recorded_horizons_keep_those_of_their_sample_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(PLANTS, "lag", Lag)
    recorded = {
        p.name: p.default
        for p in twin_table(Lag)
        if not p.name.startswith("forecasts.")
    }
    recorded |= {"period": 30.0}
    scaled_forecasts = settings_from(recorded_values("here", recorded)).forecasts
    del recorded["schedule.scale"]
    before = settings_from(recorded_values("here", recorded))
    assert before.forecasts.horizons == (60.0, 360.0, 1800.0)
    assert (before.forecasts.every, before.forecasts.memory) == (180.0, 10800.0)
    assert scaled_forecasts.every == 300.0


def watched(
    plant: type[Plant], lag: float, samples: int, lost: int = 600
) -> list[Verdict]:
    """Verdicts on a simulated plant with so many samples in its lag, whose drive is lost at a sample."""
    period = lag / samples
    random = np.random.default_rng(1)
    u = np.repeat(random.choice([-6.0, -2.0, 0.0, 3.0, 7.0], 24), 25)
    truth = plant.model().parameters(gain=2.3)
    acting = np.where(np.arange(u.size) < lost, u, 0.0)
    run = simulate_driven(truth, acting, states=begin(truth, 0.0), period=period)
    readings = run.output + random.normal(0.0, plant.output.noise, u.size)
    came = samples_of(Window(np.zeros(u.size), readings, u, period=period))
    return list(
        judge_samples("one", came, TwinSettings.of(plant, period=period)).verdicts
    )


@pytest.mark.parametrize("samples", [5, 60])
def test_two_plants_that_differ_in_their_clock_get_the_same_verdicts(
    samples: int,
) -> None:
    """Sample by sample. No fault is named on the healthy plants."""
    verdicts = watched(Lag, 5.0, samples)
    slow_verdicts = watched(House, 5.0 * CLOCK, samples)
    for verdict, slow in zip(verdicts, slow_verdicts, strict=True):
        assert (verdict.sample, verdict.level) == (slow.sample, slow.level)
        assert (verdict.nominal, verdict.leader) == (slow.nominal, slow.leader)
    levels = {verdict.level for verdict in verdicts}
    assert TrustLevel.TRUSTED in levels
    assert TrustLevel.FAULT not in levels


def test_the_lost_drive_of_a_slow_plant_is_named() -> None:
    named = [v.fault for v in watched(House, 5.0 * CLOCK, 20, lost=500) if v.fault]
    assert named[0] == "drive-lost"


def test_a_slow_sensor_may_repeat_its_reading_for_longer() -> None:
    slow, fast = (
        HealthSettings.of(plant, 0.25 if plant is Lag else 180.0)
        for plant in (House, Lag)
    )
    assert (slow.frozen, slow.start) == (360.0, 1080.0)
    assert (fast.frozen, fast.start) == (
        HealthSettings().frozen,
        HealthSettings().start,
    )
