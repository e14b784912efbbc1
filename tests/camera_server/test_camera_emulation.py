"""The emulated Lepton does what its settings say, and the same again with the same seed."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twinmatch_camera.emulation import (
    PLATE,
    EmulatedLepton,
    LeptonError,
    LeptonSettings,
    PlateFeed,
    PlateReceiver,
)

from twinmatch.links.thermal_client import Region, celsius, region
from twinmatch.links.thermal_frame import LEPTON_SHAPE, Exposure, FlatField, FrameFlags

QUIET = LeptonSettings(pixel_noise=0.0, common_noise=0.0, drift=0.0, gradient=0.0)


def film(
    camera: EmulatedLepton, plate: float, seconds: float, rate: float = 9.0
) -> list[Exposure]:
    return [
        camera.expose(plate, tick / rate, tick) for tick in range(round(seconds * rate))
    ]


def not_frozen(exposures: list[Exposure]) -> list[Exposure]:
    return [e for e in exposures if not e.frozen]


def test_the_plate_is_seen_at_its_temperature_and_the_rest_at_ambient() -> None:
    last = film(EmulatedLepton(QUIET), 41.5, 2)[-1]
    plate = region(last, PLATE)
    # Half a count of rounding.
    assert plate.minimum == pytest.approx(41.5, abs=0.0051)
    assert plate.maximum == pytest.approx(41.5, abs=0.0051)
    assert region(last, Region(0, 0, PLATE.row, 80)).mean == pytest.approx(
        23.0, abs=0.0051
    )
    assert last.image.shape == LEPTON_SHAPE
    assert last.flags is FrameFlags.EMULATED


@given(st.floats(-20, 120))
def test_any_temperature_is_seen_to_half_a_count(plate: float) -> None:
    camera = EmulatedLepton(QUIET)
    camera.expose(plate, 0.0, 0)
    assert region(camera.expose(plate, 1.0, 0), PLATE).mean == pytest.approx(
        plate, abs=0.0051
    )


def test_the_plate_is_warmest_in_its_middle() -> None:
    settings = LeptonSettings(
        pixel_noise=0.0, common_noise=0.0, drift=0.0, gradient=0.05
    )
    degrees = celsius(film(EmulatedLepton(settings), 63.0, 2)[-1])
    row = PLATE.row + PLATE.rows // 2
    column = PLATE.column + PLATE.columns // 2
    corner = degrees[PLATE.row, PLATE.column]
    assert degrees[row, column] == pytest.approx(63.0, abs=0.02)
    # The corner pixel's centre lies half a pixel inside the plate's corner.
    inside = ((1 - 1 / PLATE.rows) ** 2 + (1 - 1 / PLATE.columns) ** 2) / 2
    assert corner == pytest.approx(63.0 - 0.05 * 40.0 * inside, abs=0.0051)


def test_noise_has_the_deviations_asked_for() -> None:
    settings = LeptonSettings(
        pixel_noise=0.05, common_noise=0.08, drift=0.0, gradient=0.0
    )
    stack = np.array(
        [
            celsius(e)
            for e in not_frozen(film(EmulatedLepton(settings, seed=3), 40.0, 60))
        ]
    )
    means = stack.mean(axis=(1, 2))
    n = means.size
    # Four standard errors of a deviation estimated from n values.
    assert means.std() == pytest.approx(0.08, rel=4 / np.sqrt(2 * n))
    residual = (
        stack - means[:, None, None] - (stack - means[:, None, None]).mean(axis=0)
    )
    # Rounding to 0.01 K adds a variance of 0.01² / 12.
    assert residual.std() == pytest.approx(np.hypot(0.05, 0.01 / np.sqrt(12)), rel=0.01)


def test_drift_grows_until_the_next_flat_field_correction() -> None:
    settings = LeptonSettings(
        pixel_noise=0.0,
        common_noise=0.0,
        gradient=0.0,
        drift=0.6,
        flat_field_period=60.0,
    )
    camera = EmulatedLepton(settings)
    assert region(camera.expose(40.0, 57.0, 0), PLATE).mean == pytest.approx(
        40.57, abs=0.0051
    )
    assert region(camera.expose(40.0, 61.0, 0), PLATE).mean == pytest.approx(
        40.01, abs=0.0051
    )


def test_nine_new_images_a_second_however_often_it_is_asked() -> None:
    camera = EmulatedLepton(
        LeptonSettings(flat_field_duration=0.0, flat_field_warning=0.0)
    )
    exposures = [camera.expose(40.0, tick / 27, tick) for tick in range(27 * 3)]
    counters = [e.frame_counter for e in exposures]
    assert counters == [1 + tick // 3 for tick in range(27 * 3)]
    assert np.array_equal(exposures[0].image, exposures[2].image)
    assert not np.array_equal(exposures[2].image, exposures[3].image)


def test_a_flat_field_correction_is_announced_freezes_the_image_and_ends() -> None:
    settings = LeptonSettings(flat_field_period=20.0)
    exposures = film(EmulatedLepton(settings), 40.0, 45)
    for start in (20, 40):
        tick = 9 * start
        states = [e.flat_field for e in exposures[tick - 19 : tick + 10]]
        assert states[0] is FlatField.COMPLETE
        assert states[1:19] == [FlatField.IMMINENT] * 18
        assert states[19:28] == [FlatField.RUNNING] * 9
        assert states[28] is FlatField.COMPLETE
        frozen = exposures[tick - 1 : tick + 9]
        assert len({e.frame_counter for e in frozen}) == 1
        assert all(np.array_equal(e.image, frozen[0].image) for e in frozen)
        after = exposures[tick + 9]
        assert after.frame_counter == frozen[0].frame_counter + 1
        assert after.flat_field_age == 1000
        assert exposures[tick].flat_field_age == 0


def test_it_begins_with_a_correction_an_image_of_nothing_but_ambient_and_a_cold_sensor() -> (
    None
):
    camera = EmulatedLepton()
    first = camera.expose(80.0, 0.0, 5)
    assert first.frozen
    assert (first.frame_counter, first.stamp) == (0, 5)
    assert np.unique(celsius(first)) == pytest.approx([23.0])
    assert first.sensor_temperature == round((23.0 + 273.15) * 100)
    warm = camera.expose(40.0, 3600.0, 0).sensor_temperature
    assert warm == pytest.approx((31.0 + 273.15) * 100, abs=1)


def test_same_seed_same_image_however_often_the_camera_was_asked_before() -> None:
    first, second = (
        film(EmulatedLepton(seed=seed), 40.0, 23 / 9)[-1].image for seed in (1, 2)
    )
    assert np.array_equal(first, EmulatedLepton(seed=1).expose(40.0, 2.5, 0).image)
    assert not np.array_equal(first, second)


def test_an_impossible_temperature_and_time_that_goes_back() -> None:
    camera = EmulatedLepton()
    camera.expose(40.0, 1.0, 0)
    for plate in (float("nan"), float("inf")):
        with pytest.raises(LeptonError, match="it must be finite"):
            camera.expose(plate, 1.0, 0)
    with pytest.raises(
        LeptonError, match=r"time 0\.5 s is before that of the last image, 1\.0 s"
    ):
        camera.expose(40.0, 0.5, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pixel_noise": -1.0}, "pixel_noise is -1.0"),
        ({"ambient": float("nan")}, "ambient is nan"),
        ({"rate": 0.0}, "rate 0.0 and resolution 0.01 must be positive"),
        ({"flat_field_period": 2.0}, "has no room for a warning"),
    ],
)
def test_settings_that_cannot_be_are_refused(
    change: dict[str, Any], message: str
) -> None:
    with pytest.raises(LeptonError, match=message):
        LeptonSettings(**change)


# The socket between a simulated plate and an emulated camera.


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "plate.sock"


def test_the_newest_temperature_arrives_to_the_last_bit(path: Path) -> None:
    receiver = PlateReceiver(path)
    with PlateFeed(path) as feed:
        assert receiver.newest() is None
        assert feed.send(20.0)
        assert feed.send(1 / 3)
        assert receiver.newest() == 1 / 3
        assert receiver.newest() is None
    receiver.close()
    assert not path.exists()


def test_the_sender_does_not_mind_a_camera_that_comes_and_goes(path: Path) -> None:
    with PlateFeed(path) as feed:
        assert not feed.send(20.0)
        receiver = PlateReceiver(path)
        assert feed.send(21.0)
        receiver.close()
        assert not feed.send(22.0)
        receiver = PlateReceiver(path)
        assert feed.send(23.0)
        assert receiver.newest() == 23.0
        receiver.close()


def test_a_camera_that_does_not_read_is_not_waited_for(path: Path) -> None:
    receiver = PlateReceiver(path)
    with PlateFeed(path) as feed:
        assert not all(feed.send(20.0) for _ in range(10_000))
    receiver.close()


def test_the_socket_of_a_killed_camera_is_replaced(path: Path) -> None:
    abandoned = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    abandoned.bind(str(path))
    abandoned.close()
    PlateReceiver(path).close()


def test_a_file_is_not_replaced_and_a_folder_has_to_be_there(path: Path) -> None:
    path.write_text("mine")
    for place in (path, path.parent / "nowhere" / "plate.sock"):
        with pytest.raises(
            LeptonError, match=r"plate feed at .*plate\.sock.* give a path in a folder"
        ):
            PlateReceiver(place)
    assert path.read_text() == "mine"


@pytest.mark.parametrize("sent", [b"warm", b"", b"nan", b"1e9"])
def test_what_is_not_a_temperature_is_refused_by_receiver_and_sender(
    path: Path, sent: bytes
) -> None:
    receiver = PlateReceiver(path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(sent, str(path))
    with pytest.raises(LeptonError, match=r"is not a temperature|must be between"):
        receiver.newest()
    receiver.close()
    with (
        PlateFeed(path) as feed,
        pytest.raises(LeptonError, match=r"500\.0 °C; it must be between"),
    ):
        feed.send(500.0)
