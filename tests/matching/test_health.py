"""Faults that show in the signals alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from twinmatch.matching.health import fault_in_signals
from twinmatch.signals import PWM_LIMIT, Window


def window(temperature: np.ndarray, pwm: np.ndarray) -> Window:
    return Window(np.full(temperature.size, 40.0), temperature, pwm, first=500)


def wandering(size: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    return 40.0 + 0.1 * random.standard_normal(size), 50.0 + 10.0 * random.standard_normal(size)


def test_ordinary_signals_show_none() -> None:
    assert fault_in_signals(window(*wandering(200)), PWM_LIMIT) is None


def test_a_temperature_that_no_plate_can_have_is_seen() -> None:
    temperature, pwm = wandering(200)
    temperature[70] = -273.15
    assert fault_in_signals(window(temperature, pwm), PWM_LIMIT) == (
        "the temperature was -273.15 °C at sample 570, which no plate can be: look at the camera"
    )


def test_a_frozen_sensor_is_seen_while_the_control_moves() -> None:
    temperature, pwm = wandering(200)
    temperature[80:92] = 40.5
    pwm[80:92] += np.arange(12) * 5.0
    assert fault_in_signals(window(temperature, pwm), PWM_LIMIT) == (
        "the temperature stood still at 40.5 °C from sample 580 to 591 "
        "while the control moved: look at the camera"
    )
    pwm[80:92] = 50.0  # an idle rig may read the same for long
    assert fault_in_signals(window(temperature, pwm), PWM_LIMIT) is None


def test_a_short_pause_of_the_camera_is_no_fault() -> None:
    temperature, pwm = wandering(200)
    temperature[80:86] = 40.5
    pwm[80:86] = np.arange(6) * 40.0
    assert fault_in_signals(window(temperature, pwm), PWM_LIMIT) is None


def test_a_plate_that_cools_at_full_heat_is_seen() -> None:
    temperature, pwm = wandering(200)
    pwm[100:120] = PWM_LIMIT
    temperature[100:120] = np.linspace(40.0, 35.0, 20)
    assert fault_in_signals(window(temperature, pwm), PWM_LIMIT) == (
        "the control was saturated at +255 from sample 600 to 619 "
        "while the plate went -5.0 °C: look at the drive"
    )
    pwm[100:120] = -PWM_LIMIT  # cooling at full cooling is what it should do
    assert fault_in_signals(window(temperature, pwm), PWM_LIMIT) is None


def test_a_plate_that_warms_at_full_cooling_is_seen_to_the_last_sample() -> None:
    temperature, pwm = wandering(40)
    pwm[20:], temperature[20:] = -PWM_LIMIT, np.linspace(40.0, 44.0, 20)
    assert "saturated at -255 from sample 520 to 539" in str(
        fault_in_signals(window(temperature, pwm), PWM_LIMIT)
    )


def test_healthy_recordings_show_none_and_the_lost_drive_is_seen(
    recordings: dict[int, Path], recorded_hour: Callable[[int], Window]
) -> None:
    for number in set(recordings) - {27}:
        assert fault_in_signals(recorded_hour(number), PWM_LIMIT) is None
    hour = recorded_hour(27)
    assert fault_in_signals(hour.part(0, 2150), PWM_LIMIT) is None
    assert "look at the drive" in str(fault_in_signals(hour.part(2150, 3600), PWM_LIMIT))
