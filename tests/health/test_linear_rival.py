"""Who misses what a linear model without physics forecasts accuses nobody."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.literature import (
    Recorded,
    aeration_basin,
    evaporator,
    fermenter,
    quadruple_tank,
    three_tanks,
)
from twinmatch.adding import files_of
from twinmatch.adding.several import propose_several
from twinmatch.health import Fault
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.linear_rival import LinearRival
from twinmatch.health.mixture_forecasts import NewestForecasts, ScoredForecast
from twinmatch.importing.table_files import open_table
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import parse_map
from twinmatch.signals import FloatArray, Sample

VARIANCE = np.array([0.01, 0.01])


def first_monitor(
    recorded: Recorded, name: str, monkeypatch: pytest.MonkeyPatch, folder: Path
) -> ChannelMonitor:
    """A monitor with the first plant file of a recording, as `new-plant` writes it."""
    monkeypatch.chdir(folder)
    path = Path("log.csv")
    signal_map = parse_map(recorded.write(path))
    proposal = propose_several(open_table(path), signal_map)
    for file_name, text in files_of(name, proposal).items():
        Path(file_name).write_text(text)
    model = find_plant(f"{name}.py").model()
    return ChannelMonitor(model.parameters(), recorded.period)


def watch(monitor: ChannelMonitor, outputs: FloatArray, inputs: FloatArray) -> None:
    rows = zip(outputs.tolist(), inputs.tolist(), strict=True)
    for k, (y, u) in enumerate(rows):
        monitor.push(Sample(k, k, (), tuple(y), tuple(u)))


@pytest.mark.parametrize(
    "process", [quadruple_tank, three_tanks, evaporator, fermenter, aeration_basin]
)
def test_healthy_processes_in_a_first_plant_file_get_no_alarm(
    process: Callable[[], Recorded], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Roots, flows both ways and a level that integrates, in a file of lags: the tanks got a `disturbance`, the
    evaporator's level a `sensor-drift`. What dilution does to a fermenter depends on where it is: `drive-weak`. A
    blower does more to oxygen than the equations say where it blows little, and within minutes, beside ammonia that
    takes hours: `sensor-drift`."""
    recorded = process()
    monitor = first_monitor(recorded, process.__name__, monkeypatch, tmp_path)
    watch(monitor, recorded.outputs, recorded.inputs)
    assert monitor.alarms == ()


def test_a_reading_that_jumps_is_named_beside_a_linear_model(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    recorded = quadruple_tank(2200)
    monitor = first_monitor(recorded, "tank_that_jumps", monkeypatch, tmp_path)
    slipped = recorded.outputs + np.where(np.arange(2200) >= 2000, 4.0, 0.0)[
        :, None
    ] * np.array([1.0, 0.0])
    watch(monitor, slipped, recorded.inputs)
    assert [alarm.fault for alarm in monitor.alarms] == [Fault.SENSOR_DRIFT]
    assert monitor.alarms[0].signal == "reading1"
    assert 2000 <= monitor.alarms[0].flagged <= 2010


def test_a_linear_plant_is_forecast_under_the_inputs_that_followed() -> None:
    """y[k+1] = 0.9 y[k] + 0.5 u[k] − 0.2 d[k]."""
    random = np.random.default_rng(2)
    rival = LinearRival(places=2, longest=60, kept=1.0)
    y = 3.0
    for k in range(400):
        u = float(random.integers(0, 4))
        d = float(random.integers(0, 2))
        sample = Sample(k, k, (), (y,), (u,), (d,))
        rival.take(sample, np.array([y]), np.array([True]))
        if k == 340:
            rival.begin(1)
        if k == 380:
            assert rival.forecast(1, 40) == pytest.approx([y], abs=1e-6)
        y = 0.9 * y + 0.5 * u - 0.2 * d


def test_before_a_first_reading_nothing_is_forecast() -> None:
    rival = LinearRival(places=1, longest=10, kept=1.0)
    for k in range(4):
        sample = Sample(k, k, (), (np.nan,), (1.0,))
        rival.take(sample, np.array([0.0]), np.array([False]))
        if k == 1:
            rival.begin(0)
    assert rival.forecast(0, 2).tolist() == [np.inf]


def scored(at: int, error: float, linear: float, ahead: int = 3) -> ScoredForecast:
    """A forecast of two outputs, of which the second comes true."""
    squares, linear_squares = (np.array([size**2, 0.0]) for size in (error, linear))
    return ScoredForecast(at, ahead, 1.0, squares, squares, linear_squares)


@pytest.mark.parametrize(
    ("error", "linear", "is_explained"),
    [(2.1, 1.0, True), (1.9, 1.0, False), (0.5, 0.0, False), (1.0, 2.0, False)],
)
def test_what_equations_miss_twice_as_far_is_theirs(
    error: float, linear: float, is_explained: bool
) -> None:
    """Beyond three standard deviations of a reading, here 0.3, each way: 0.6."""
    newest = NewestForecasts()
    for at in range(3):
        newest.take(scored(at, error, linear), reach=10)
    assert newest.explained(0, VARIANCE).tolist() == [is_explained, False]


def test_forecasts_count_from_the_onset_on_and_three_of_them_are_needed() -> None:
    newest = NewestForecasts()
    newest.take(scored(0, 9.0, 1.0), reach=10)
    for at in (20, 21, 22):
        newest.take(scored(at, 9.0, 1.0), reach=10)
        newest.take(scored(at, 9.0, 1.0, ahead=0), reach=10)
    assert newest.explained(20, VARIANCE).tolist() == [True, False]
    assert newest.explained(21, VARIANCE).tolist() == [False, False]
    assert newest.explained(0, VARIANCE).tolist() == [True, False]
    assert newest.missed(22, VARIANCE).tolist() == [True, False]
    newest.clear()
    assert newest.missed(0, VARIANCE).tolist() == [True, True]
