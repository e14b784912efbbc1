"""The comparison with otwin skips what is not here, and its side finds a plant that it can describe."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.places import PROJECT
from twinmatch.plants import TCLab
from twinmatch.signals import KELVIN, FloatArray, Window


@pytest.fixture
def otwin_peer(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(PROJECT))
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(variable, "1")
    from benchmarks import otwin_peer

    return otwin_peer


def test_without_otwin_it_refuses_in_one_sentence(
    otwin_peer: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from benchmarks.__main__ import main

    monkeypatch.setattr(otwin_peer, "peer", lambda _: None)
    monkeypatch.setattr(sys, "argv", ["benchmarks", "otwin_peer"])
    assert main() == 1
    refusal, verdict = capsys.readouterr().err.splitlines()
    assert refusal.startswith(
        "benchmarks: otwin_peer: otwin is not installed; run `make bench`"
    )
    assert verdict == "benchmarks: failed: otwin_peer"


def test_a_recording_that_is_absent_is_skipped(
    otwin_peer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    absent = [
        replace(recording, path=Path("nowhere") / recording.path.name)
        for recording in otwin_peer.recordings()
    ]
    monkeypatch.setattr(otwin_peer, "recordings", lambda: absent)
    monkeypatch.setattr(otwin_peer, "peer", lambda _: otwin_peer)
    rows = otwin_peer.run(quick=False)
    assert [row.case for row in rows] == [
        "rig 1",
        "rig 9",
        "one heater",
        "two heaters",
        "incubator",
    ]
    assert all(
        row.note.startswith("no nowhere") and np.isnan(row.seconds) for row in rows
    )


def heated_kit(noise: float) -> tuple[FloatArray, FloatArray]:
    """Inputs and readings, °C, of the heater with a sensor that the network of a kit describes."""
    inputs = np.repeat([0.0, 60.0, 20.0, 80.0, 40.0, 70.0], 100)
    heater = sensor = room = 22.0 + KELVIN
    readings = []
    for u in inputs:
        readings.append(sensor - KELVIN)
        for _ in range(50):
            conducted = 0.0075 * (heater - sensor)
            radiated = 0.9 * 5.67e-8 * 10e-4 * (heater**4 - room**4)
            heater += (
                0.02 * (0.01 * u - 0.005 * (heater - room) - conducted - radiated) / 2.5
            )
            sensor += 0.02 * conducted / 0.1
    return inputs, np.array(readings) + noise * np.random.default_rng(3).normal(
        size=inputs.size
    )


def test_otwin_forecasts_a_plant_that_is_its_network(otwin_peer: Any) -> None:
    """Known truth: fitted to two thirds of it, its forecast of the rest is within the sensor's noise."""
    pytest.importorskip(
        "otwin", reason="otwin is a peer that only `make bench` installs"
    )
    inputs, readings = heated_kit(0.05)
    window = Window(
        readings, readings, inputs, period=1.0, disturbances=np.zeros((600, 1))
    )
    recording = next(
        candidate
        for candidate in otwin_peer.recordings()
        if candidate.title == "one heater"
    )
    forecast = otwin_peer.OtwinTwin(recording, window).forecast(399, 200)
    assert (
        np.sqrt(np.mean(np.square(forecast - readings[400:])))
        < 2 * TCLab.outputs["temperature"].noise
    )
    at_sample = [
        past_forecast
        for past_forecast in otwin_peer.forecasts_of(recording, window)
        if past_forecast.sample == 399
    ]
    assert np.all(at_sample[0].output.low < at_sample[0].output.mean)
