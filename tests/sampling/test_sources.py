"""One map for tables, topics and bags: the same entry gives the same number, in the plant's unit."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plant_files import plant_file
from twinmatch.importing.mapped import map_samples
from twinmatch.importing.tables import read_table
from twinmatch.plants import find_plant
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.sources import SignalSource, parse_map, parse_source
from twinmatch.sessions.files import RecordingError

KIND = "sensor_msgs/msg/Temperature"
PRESSURE = "sensor_msgs/msg/FluidPressure"
numbers = st.floats(-1e3, 1e3)


@given(numbers, numbers, st.floats(0.1, 10.0), numbers)
def test_an_entry_gives_the_mean_of_its_places_scaled_and_converted(
    first: float, second: float, scale: float, offset: float
) -> None:
    source = parse_source(
        "here", f"/a:x, /b:x; unit=K; scale={scale!r}; offset={offset!r}"
    )
    followed = source.follow("output", "°C", source.channels("output"), [KIND, KIND])
    assert followed.value([first, second], 0.0) == pytest.approx(
        scale * (first + second) / 2 + offset - 273.15, abs=1e-8
    )


def test_each_place_has_a_unit_of_its_own() -> None:
    source = SignalSource(("/a:temperature", "/b:fluid_pressure"))
    channels = source.channels("output")
    assert channels == (Channel("/a", "temperature"), Channel("/b", "fluid_pressure"))
    assert source.follow("output", "K", channels[:1], [KIND]).value(
        [20.0], 0.0
    ) == pytest.approx(293.15)
    with pytest.raises(
        SamplingError,
        match=r"'/b:fluid_pressure' is in Pa \(according to .*FluidPressure\)",
    ):
        source.follow("output", "K", channels, [KIND, PRESSURE])
    # a number that is scaled is in no stated unit
    scaled = SignalSource(source.places, scale=2.0)
    assert (
        scaled.follow("output", "K", channels, [KIND, PRESSURE]).value([1.0, 2.0], 0.0)
        == 3.0
    )


def test_what_is_written_is_read_again() -> None:
    for text in ("T", "a, b; unit=K", "/t:x[1].y; scale=0.1; offset=-40"):
        source = parse_source("here", text)
        assert parse_source("here", source.text) == SignalSource(
            (", ".join(source.places),), source.unit, source.scale, source.offset
        )


def test_a_unit_that_nobody_knows_is_refused_for_a_table_as_for_a_topic(
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,T (as read),u\n0,20,1\n1,21,1\n2,22,1\n")
    plant = find_plant(str(plant_file(tmp_path, "block_of_maps")))
    entries = ["time=t", "output=T; unit=wibble", "input=u"]
    with pytest.raises(RecordingError, match="'wibble' is not a known unit"):
        map_samples(read_table(path), parse_map(entries), plant)
    remark = parse_map(["time=t", "output=T", "input=u"])  # `as read` is a remark
    assert [s.output for s in map_samples(read_table(path), remark, plant).samples] == [
        20.0,
        21.0,
        22.0,
    ]
