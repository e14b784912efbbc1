"""The camera: what it adds, what it rounds, when it stands still."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.plant import Camera, CameraRealisation, PlantError, RigParameters, simulate_closed_loop

HOUR = 3600


def test_the_same_seed_gives_the_same_run() -> None:
    one, two, other = (Camera().realise(HOUR, 1.0, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.noise, two.noise)
    np.testing.assert_array_equal(one.frozen, two.frozen)
    assert not np.array_equal(one.noise, other.noise)


def test_noise_has_its_size() -> None:
    noise = Camera(noise=0.2).realise(20000, 1.0, 1).noise
    assert np.std(noise) == pytest.approx(0.2, rel=0.02)  # four standard errors of 20000 values
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.03


def test_corrections_come_once_a_period() -> None:
    frozen = Camera(flat_field_period=180.0, flat_field_duration=2.5).realise(HOUR, 1.0, 2).frozen
    starts = np.flatnonzero(np.diff(frozen.astype(int)) == 1)
    np.testing.assert_array_equal(np.diff(starts), 180)
    assert len(starts) in (19, 20)
    assert 2 * 19 <= frozen.sum() <= 3 * 20
    assert not Camera(flat_field_period=None).realise(HOUR, 1.0, 2).frozen.any()


def test_a_frozen_camera_repeats_itself_in_the_loop() -> None:
    camera = Camera(flat_field_period=30.0, flat_field_duration=3.0).realise(300, 1.0, 4)
    response = simulate_closed_loop(RigParameters(), np.full(300, 60.0), plate=296.0, camera=camera)
    again = np.diff(response.output) == 0.0
    assert camera.frozen.sum() >= 27
    assert again[camera.frozen[1:]].all()


@given(st.floats(250.0, 400.0), st.sampled_from([0.01, 0.05, 0.5]), st.floats(-1.0, 1.0))
def test_a_reading_is_a_multiple_of_the_resolution_next_to_the_plate(
    plate: float, resolution: float, noise: float
) -> None:
    camera = CameraRealisation(np.array([noise]), np.array([False]), resolution)
    value = camera.reading(0, plate)
    assert value / resolution == pytest.approx(round(value / resolution), abs=1e-6)
    assert abs(value - (plate - 273.15 + noise)) <= resolution / 2 + 1e-9


def test_a_camera_frozen_from_the_start_shows_the_plate_once() -> None:
    camera = CameraRealisation(np.zeros(3), np.ones(3, dtype=bool), 0.0)
    response = simulate_closed_loop(RigParameters(), [60.0] * 3, plate=300.0, camera=camera)
    np.testing.assert_array_equal(response.output, np.full(3, 300.0 - 273.15))
    assert camera.reading(0, 300.0) == 300.0 - 273.15
    assert camera.reading(2, 310.0, last=12.0) == 12.0


def test_impossible_cameras_are_refused() -> None:
    with pytest.raises(PlantError, match=r"camera: noise is -0\.1"):
        Camera(noise=-0.1)
    with pytest.raises(PlantError, match="camera: resolution is nan"):
        Camera(resolution=math.nan)
    with pytest.raises(PlantError, match=r"flat-field period of 0.5 s leaves no time"):
        Camera(flat_field_period=0.5)
    with pytest.raises(PlantError, match="cannot realise -1 samples"):
        Camera().realise(-1, 1.0, 0)
    with pytest.raises(PlantError, match=r"cannot realise 3 samples of 0\.0 s"):
        Camera().realise(3, 0.0, 0)
    with pytest.raises(PlantError, match=r"noise has shape \(2,\) and frozen \(3,\)"):
        CameraRealisation(np.zeros(2), np.zeros(3, dtype=bool), 0.0)
    with pytest.raises(PlantError, match="must be finite"):
        CameraRealisation(np.full(2, np.nan), np.zeros(2, dtype=bool), 0.0)
    with pytest.raises(PlantError, match="reading 2 asked of 2"):
        CameraRealisation(np.zeros(2), np.zeros(2, dtype=bool), 0.0).reading(2, 300.0)
