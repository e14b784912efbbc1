"""One column of values for many series: taken apart, mapped by name, brought to one clock."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tests.support.plant_files import plant_file
from twinmatch.cli import main
from twinmatch.dynamics import Plant
from twinmatch.importing.column_map import columns_of, proposed
from twinmatch.importing.mapped import Mapped, map_samples, with_plant_names
from twinmatch.importing.table_files import open_table
from twinmatch.plants import find_plant
from twinmatch.sampling.sources import parse_map
from twinmatch.sessions.files import RecordingError


@pytest.fixture(scope="module")
def heated(tmp_path_factory: pytest.TempPathFactory) -> type[Plant]:
    return find_plant(
        str(plant_file(tmp_path_factory.mktemp("plant"), "block_stacked"))
    )


def guess(path: Path) -> dict[str, str]:
    table = open_table(path)
    return {
        signal: source.text
        for signal, source in proposed(columns_of(table), table).items()
    }


def mapped(path: Path, plant: type[Plant], *entries: str) -> Mapped:
    table = open_table(path)
    return map_samples(
        table, with_plant_names(table, plant, parse_map(entries)), plant, gaps="split"
    )


def stamp(seconds: float) -> str:
    return f"2026-03-01T00:{int(seconds) // 60:02d}:{seconds % 60:06.3f}Z"


def history(path: Path, *, in_order_of_time: bool) -> Path:
    """Temperatures each 10 s, a switch that turns between two of them, and a minute without the sensor."""
    rows = [
        (0.0, "switch.heater", "off"),
        (104.0, "switch.heater", "on"),
        (251.0, "switch.heater", "off"),
    ]
    rows += [
        (10.0 * k, "sensor.tank_temperature", f"{20 + 0.5 * k:g}") for k in range(12)
    ]
    rows += [(120.0, "sensor.tank_temperature", "unavailable")]
    rows += [
        (10.0 * k, "sensor.tank_temperature", f"{20 + 0.5 * k:g}")
        for k in range(18, 30)
    ]
    rows += [
        (0.0, "weather.home", "sunny"),
        (40.0, "weather.home", "rainy"),
        (80.0, "weather.home", "fog"),
    ]
    if in_order_of_time:
        rows.sort()
    lines = [f"{name},{state},{stamp(time)}" for time, name, state in rows]
    path.write_text("\n".join(["entity_id,state,last_changed", *lines]) + "\n")
    return path


@pytest.mark.parametrize("in_order_of_time", [False, True])
def test_a_history_of_home_assistant_is_its_entities(
    tmp_path: Path, heated: type[Plant], *, in_order_of_time: bool
) -> None:
    path = history(tmp_path / "history.csv", in_order_of_time=in_order_of_time)
    assert guess(path) == {
        "time": "last_changed",
        "output": "state[sensor.tank_temperature]",
        "input": "state[switch.heater]",
    }
    for output in ("state[sensor.tank_temperature]", "sensor.tank_temperature"):
        run = mapped(path, heated, f"output={output}", "input=switch.heater; scale=100")
        assert run.period == 10.0
        values = {round(sample.stamp / 1e9) % 3600: sample for sample in run.samples}
        assert values[50].output == 22.5
        assert 130 not in values  # it was not available
        assert 170 not in values
        assert values[180].output == 29.0
        # It was on from 104 s, so for 6 s of the ten behind the reading at 100 s.
        assert [
            values[k].input for k in (90, 100, 110, 240, 250, 260)
        ] == pytest.approx([0.0, 60.0, 100.0, 100.0, 10.0, 0.0])


def test_of_a_house_the_weather_is_what_acts_on_it(tmp_path: Path) -> None:
    """Words at the foot of an export are states of another entity, not remarks."""
    rows = [
        ("sensor.living_room_temperature", f"{20 + k % 3}", 10.0 * k)
        for k in range(200)
    ]
    rows += [("sensor.outdoor_temperature", f"{5 + k}", 500.0 * k) for k in range(4)]
    rows += [("switch.heater", "on" if k % 2 else "off", 100.0 * k) for k in range(20)]
    rows += [("weather.home", "sunny" if k % 2 else "fog", 100.0 * k) for k in range(5)]
    path = tmp_path / "history.csv"
    lines = [f"{name},{state},{stamp(time)}" for name, state, time in rows]
    path.write_text("\n".join(["entity_id,state,last_changed", *lines]) + "\n")
    assert open_table(path).notes == ()
    assert guess(path) == {
        "time": "last_changed",
        "output": "state[sensor.living_room_temperature]",
        "input": "state[switch.heater]",
        "room": "state[sensor.outdoor_temperature]",
    }


def test_a_state_that_does_not_change_stands(
    tmp_path: Path, heated: type[Plant]
) -> None:
    rows = [(0.0, "switch.heater", "on")]
    rows += [
        (t, "sensor.t", f"{v:g}")
        for t, v in ((0, 20.0), (10, 20.5), (20, 21.0), (120, 21.5), (130, 22.0))
    ]
    path = tmp_path / "history.csv"
    lines = [f"{name},{state},{stamp(time)}" for time, name, state in rows]
    path.write_text("\n".join(["entity_id,state,last_changed", *lines]) + "\n")
    run = mapped(path, heated, "output=sensor.t", "input=switch.heater")
    assert [sample.index for sample in run.samples] == list(range(14))
    assert [sample.output for sample in run.samples][2:12] == [21.0] * 10


ANNOTATIONS = "#group,false,false\n#datatype,string,long\n#default,_result,\n"


def influx(path: Path, *, blocks: bool) -> Path:
    """Two fields of two measurements, in one table or in one for each, which has a tag of its own."""
    header = ",result,table,_time,_value,_field,_measurement"
    temperature = [f",,0,{stamp(5 * k)},{20 + k},temperature,tank" for k in range(8)]
    duty = [f",,1,{stamp(5 * k)},{10 * (k // 4)},duty,heater" for k in range(8)]
    if blocks:
        tagged = [row + ",shed" for row in duty]
        text = (
            "\n".join([header, *temperature])
            + "\n\n"
            + ANNOTATIONS
            + "\n".join([header + ",host", *tagged])
        )
    else:
        text = "\n".join([header, *temperature, *duty])
    path.write_text(ANNOTATIONS + text + "\n")
    return path


@pytest.mark.parametrize("blocks", [False, True])
def test_fields_of_influx_are_columns(
    tmp_path: Path, heated: type[Plant], *, blocks: bool
) -> None:
    path = influx(tmp_path / "influx.csv", blocks=blocks)
    assert guess(path) == {
        "time": "_time",
        "output": "_value[_field=temperature]",
        "input": "_value[_field=duty]",
    }
    for output in ("_value[_field=temperature]", "_value[temperature]", "temperature"):
        run = mapped(path, heated, f"output={output}", "input=_value[_field = duty]")
        assert [sample.output for sample in run.samples] == [20 + k for k in range(8)]
        assert [sample.input for sample in run.samples] == [
            10 * (k // 4) for k in range(8)
        ]


def test_a_series_that_is_not_there_is_named(
    tmp_path: Path, heated: type[Plant]
) -> None:
    path = influx(tmp_path / "influx.csv", blocks=False)
    with pytest.raises(
        RecordingError, match=r"has no column 'pressure'; it has .*_field=temperature"
    ):
        mapped(path, heated, "output=pressure", "input=duty")


def test_series_may_have_numbers_for_names(tmp_path: Path) -> None:
    """Their rows alternate, so that the times rise: nothing but the title says that these are names."""
    rows = [
        f"{k},{k % 2 + 1},{20 + k if k % 2 else 50 * (k // 20 % 2)}" for k in range(80)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,sensor_id,value", *rows]) + "\n")
    assert set(open_table(path).columns) == {"time", "value[1]", "value[2]"}


def test_each_row_may_have_the_values_of_one_device(
    tmp_path: Path, heated: type[Plant]
) -> None:
    rows = []
    for k in range(40):
        rows += [f"{k},kiln,{20 + k},{k // 20 * 50}", f"{k + 0.3:g},room,19.5,0"]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,device,temp (°C),duty (%)", *rows]) + "\n")
    table = open_table(path)
    assert table.unit(table.find("temp (°C)[kiln]")) == "°C"
    run = mapped(
        path, heated, "output=temp (°C)[kiln]", "input=kiln.duty", "room=room.temp"
    )
    # At the kiln's first row the room has not been read yet.
    assert [sample.output for sample in run.samples] == [20.0 + k for k in range(1, 40)]
    assert [sample.input for sample in run.samples] == [
        k // 20 * 50 for k in range(1, 40)
    ]


def test_a_table_with_a_word_in_each_row_stays_as_it_is(tmp_path: Path) -> None:
    """A mode beside readings does not name series: the times do not repeat."""
    path = tmp_path / "log.csv"
    rows = [
        f"{k},{20 + k % 3},{'heat' if k % 4 else 'cool'},{k % 2}" for k in range(40)
    ]
    path.write_text("\n".join(["time,value,mode,input", *rows]) + "\n")
    assert set(open_table(path).columns) == {"time", "value", "mode", "input"}


def recorder(path: Path, *, old: bool) -> Path:
    """A database as the recorder of Home Assistant writes it, by its newer and by its older tables."""
    unit = '{"unit_of_measurement": "°F"}'
    states = [("sensor.tank", 10.0 * k, str(68 + 1.8 * k), unit) for k in range(12)]
    states += [("light.hall", 3.0, "dim", "{}"), ("switch.heater", 0.0, "on", "{}")]
    attributes = (
        '{"current_temperature": 20.5, "hvac_action": "heating", "preset_mode": "eco"}'
    )
    states += [("climate.bath", 20.0 * k, "heat", attributes) for k in range(6)]
    with closing(sqlite3.connect(path)) as database:
        if old:
            database.execute(
                "CREATE TABLE states (entity_id TEXT, state TEXT, last_updated TEXT)"
            )
            for name, seconds, state, _ in states:
                time = stamp(seconds).replace("T", " ").replace("Z", "")
                database.execute(
                    "INSERT INTO states VALUES (?, ?, ?)", (name, state, time)
                )
        else:
            database.execute(
                "CREATE TABLE states_meta (metadata_id INTEGER, entity_id TEXT)"
            )
            database.execute(
                "CREATE TABLE state_attributes (attributes_id INTEGER, shared_attrs TEXT)"
            )
            database.execute(
                "CREATE TABLE states "
                "(metadata_id INTEGER, state TEXT, last_updated_ts REAL, attributes_id INTEGER)"
            )
            names = sorted({name for name, *_ in states})
            database.executemany(
                "INSERT INTO states_meta VALUES (?, ?)", enumerate(names)
            )
            for number, (name, seconds, state, text) in enumerate(states):
                database.execute(
                    "INSERT INTO state_attributes VALUES (?, ?)", (number, text)
                )
                values = (names.index(name), state, 1.7723232e9 + seconds, number)
                database.execute("INSERT INTO states VALUES (?, ?, ?, ?)", values)
        database.commit()
    return path


@pytest.mark.parametrize("old", [False, True])
def test_the_recorder_of_home_assistant_is_imported_by_name(
    tmp_path: Path, heated: type[Plant], *, old: bool
) -> None:
    path = recorder(tmp_path / "home-assistant_v2.db", old=old)
    before = path.read_bytes()
    # the older tables do not say it
    output = "sensor.tank; unit=°F" if old else "sensor.tank"
    run = mapped(path, heated, f"output={output}", "input=switch.heater; scale=100")
    assert [sample.output for sample in run.samples] == pytest.approx(
        [20.0 + k for k in range(12)]
    )
    assert {sample.input for sample in run.samples} == {100.0}
    assert run.samples[0].stamp == 1_772_323_200 * 10**9
    assert path.read_bytes() == before
    titles = set(open_table(path).columns)
    assert "state[light.hall]" not in titles  # it never had a number
    assert ("state[climate.bath.hvac_action]" in titles) is not old


def test_a_database_of_something_else_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "other.db"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE notes (text TEXT)")
        database.commit()
    assert main(["import", str(path), "--list"]) == 2
    assert "give a copy of home-assistant_v2.db" in capsys.readouterr().err


def test_a_mean_over_time_knows_what_is_missing(
    tmp_path: Path, heated: type[Plant]
) -> None:
    """While the input is not available, the rows have no input: they are a gap, not a zero."""
    path = tmp_path / "influx.csv"
    rows = [f"{stamp(5 * k)},{20 + k},temperature" for k in range(40)]
    rows += [
        f"{stamp(5 * k)},{'unknown' if 10 <= k < 25 else 50},duty" for k in range(40)
    ]
    path.write_text("\n".join(["_time,_value,_field", *rows]) + "\n")
    run = mapped(path, heated, "output=temperature", "input=duty")
    outputs = np.array([sample.output for sample in run.samples])
    assert {sample.input for sample in run.samples} == {50.0}
    assert not ((outputs > 29.5) & (outputs < 44.5)).any()
