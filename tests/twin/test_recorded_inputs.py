"""Real recordings of plants whose loop is not known: forecasts of one part against the next."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.support.incubator import SECOND, read_run
from twinmatch.plants import Incubator, TCLab
from twinmatch.signals import FloatArray, Sample, Window
from twinmatch.twin import Twin, TwinSettings


def foretold(
    window: Window, settings: TwinSettings, newest: int, count: int
) -> tuple[Twin, FloatArray]:
    """A twin that has seen the samples up to one, and the measurements minus its forecast after it."""
    twin = Twin(settings)
    for k in range(newest + 1):
        twin.push(
            Sample(
                k,
                round(k * window.period * 1e9),
                float(window.reference[k]),
                float(window.output[k]),
                float(window.input[k]),
                tuple(window.disturbances[k].tolist()),
            )
        )
    ahead = slice(newest + 1, newest + 1 + count)
    rows = window.disturbances[newest : newest + 1 + count]
    forecast = twin.discriminator.forecaster.outlook().forecast(
        window.input[ahead], rows
    )
    return twin, np.asarray(window.output[ahead] - forecast.output.mean)


def test_a_step_test_of_the_kit_forecasts_its_second_half(
    kit_recording: Callable[[str], Window],
) -> None:
    """Two levels of the heater tell what a third, much hotter one brings.

    Between there and the end the output changes by 20 °C; who says that it stays is off by ten.
    """
    window = kit_recording("one_heater_600s.csv")
    twin, errors = foretold(window, TwinSettings.of(TCLab, law=None), 400, 150)
    assert twin.discriminator.forecaster.leader is not None
    stays = window.output[401:551] - window.output[400]
    assert np.sqrt(np.mean(np.square(stays))) > 8.0
    assert np.sqrt(np.mean(np.square(errors))) < 2.0


def test_a_switched_incubator_forecasts_five_minutes(incubator_folder: Path) -> None:
    """Half an hour of on and off tells the next five minutes to a few steps of the sensor."""
    window = read_run(incubator_folder, SECOND)
    twin, errors = foretold(
        window, TwinSettings.of(Incubator, period=window.period), 700, 100
    )
    assert twin.settings.law is None
    assert twin.discriminator.forecaster.leader is not None
    assert np.ptp(window.output[700:801]) > 4.0
    assert np.sqrt(np.mean(np.square(errors))) < 0.5
