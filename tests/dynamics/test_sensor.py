"""The sensor: what it adds, what it rounds, when it stands still."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.dynamics import PlantError, Sensor, SensorRealisation, begin, simulate_closed_loop
from twinmatch.plants import Peltier

CAMERA = Peltier.sensor or Sensor()

HOUR = 3600


def test_the_same_seed_gives_the_same_run() -> None:
    one, two, other = (CAMERA.realise(HOUR, 1.0, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.noise, two.noise)
    np.testing.assert_array_equal(one.frozen, two.frozen)
    assert not np.array_equal(one.noise, other.noise)


def test_noise_has_its_size() -> None:
    noise = Sensor(noise=0.2).realise(20000, 1.0, 1).noise
    assert np.std(noise) == pytest.approx(0.2, rel=0.02)  # four standard errors of 20000 values
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.03


def test_corrections_come_once_a_period() -> None:
    frozen = Sensor(pause_period=180.0, pause_duration=2.5).realise(HOUR, 1.0, 2).frozen
    starts = np.flatnonzero(np.diff(frozen.astype(int)) == 1)
    np.testing.assert_array_equal(np.diff(starts), 180)
    assert len(starts) in (19, 20)
    assert 2 * 19 <= frozen.sum() <= 3 * 20
    assert not Sensor(pause_period=None).realise(HOUR, 1.0, 2).frozen.any()


def test_a_frozen_camera_repeats_itself_in_the_loop() -> None:
    camera = Sensor(0.1, pause_period=30.0, pause_duration=3.0).realise(300, 1.0, 4)
    rig = Peltier.model().parameters()
    response = simulate_closed_loop(rig, np.full(300, 60.0), states=begin(rig, 23.0), sensor=camera)
    again = np.diff(response.output) == 0.0
    assert camera.frozen.sum() >= 27
    assert again[camera.frozen[1:]].all()


@given(st.floats(-20.0, 130.0), st.sampled_from([0.01, 0.05, 0.5]), st.floats(-1.0, 1.0))
def test_a_reading_is_a_multiple_of_the_resolution_next_to_the_output(
    output: float, resolution: float, noise: float
) -> None:
    camera = SensorRealisation(np.array([noise]), np.array([False]), resolution)
    value = camera.reading(0, output)
    assert value / resolution == pytest.approx(round(value / resolution), abs=1e-6)
    assert abs(value - (output + noise)) <= resolution / 2 + 1e-9


def test_a_camera_frozen_from_the_start_shows_the_output_once() -> None:
    camera = SensorRealisation(np.zeros(3), np.ones(3, dtype=bool), 0.0)
    rig = Peltier.model().parameters()
    response = simulate_closed_loop(rig, [60.0] * 3, states=begin(rig, 27.0), sensor=camera)
    np.testing.assert_array_equal(response.output, np.full(3, 300.15 - 273.15))
    assert camera.reading(0, 27.0) == 27.0
    assert camera.reading(2, 37.0, last=12.0) == 12.0


def test_impossible_cameras_are_refused() -> None:
    with pytest.raises(PlantError, match=r"sensor: noise is -0\.1"):
        Sensor(noise=-0.1)
    with pytest.raises(PlantError, match="sensor: resolution is nan"):
        Sensor(resolution=math.nan)
    with pytest.raises(PlantError, match=r"a pause every 0.5 s leaves no time"):
        Sensor(pause_period=0.5)
    with pytest.raises(PlantError, match="cannot realise -1 samples"):
        CAMERA.realise(-1, 1.0, 0)
    with pytest.raises(PlantError, match=r"cannot realise 3 samples of 0\.0 s"):
        CAMERA.realise(3, 0.0, 0)
    with pytest.raises(PlantError, match=r"noise has shape \(2,\) and frozen \(3,\)"):
        SensorRealisation(np.zeros(2), np.zeros(3, dtype=bool), 0.0)
    with pytest.raises(PlantError, match="must be finite"):
        SensorRealisation(np.full(2, np.nan), np.zeros(2, dtype=bool), 0.0)
    with pytest.raises(PlantError, match="reading 2 of 2"):
        SensorRealisation(np.zeros(2), np.zeros(2, dtype=bool), 0.0).reading(2, 27.0)
