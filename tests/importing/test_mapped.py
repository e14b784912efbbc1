"""Tables of any columns become samples of a plant: what is read, and one clear line for what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from tests.support import exchanging
from tests.support.exchanging import Heaters
from tests.support.plant_files import plant_file
from tests.support.plants import Motor
from tests.support.processes import run_twinmatch
from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.importing import tables
from twinmatch.importing.cells import Cells
from twinmatch.importing.column_map import columns_of, proposed, read_map
from twinmatch.importing.mapped import (
    Mapped,
    map_samples,
    with_plant_names,
    without_marks,
)
from twinmatch.importing.tables import read_table
from twinmatch.importing.times import read_times
from twinmatch.offline.judging import terms_from_files
from twinmatch.plants import find_plant
from twinmatch.sampling.channels import SamplingError
from twinmatch.sampling.sources import SignalMap, SignalSource, parse_map
from twinmatch.sessions import read_session, write_session
from twinmatch.sessions.files import RecordingError
from twinmatch.sessions.metadata import PLANT
from twinmatch.sessions.recording import EPOCH
from twinmatch.signals import Sample


@pytest.fixture(scope="module")
def heated(tmp_path_factory: pytest.TempPathFactory) -> type[Plant]:
    return find_plant(
        str(plant_file(tmp_path_factory.mktemp("plants"), "block_mapped"))
    )


def written(folder: Path, text: str) -> Path:
    path = folder / "log.csv"
    path.write_text(text, "utf-8")
    return path


CSV = "t,T1,T2,on,room\n0,20,22,False,19.5\n1,21,23,True,19.5\n2,22,24,True,19.6\n3,23,25,False,19.6\n"
MAP = ["time=t", "output=T1, T2", "heater=on; scale=100", "room=room"]


def mapped(
    folder: Path, plant: type[Plant], text: str = CSV, entries: list[str] | None = None
) -> Mapped:
    return map_samples(
        read_table(written(folder, text)), parse_map(entries or MAP), plant
    )


TWO = "s,T1,T2,Q1,Q2,SP1,SP2\n0,21,31,10,20,40,50\n2,22,32,11,20,40,50\n4,23,33,12,20,45,55\n"
OF_TWO = [
    "time=s; unit=s",
    "first=T1",
    "second=T2",
    "first_power=Q1",
    "second_power=Q2",
]


def test_a_table_of_several_signals_is_imported(tmp_path: Path) -> None:
    closed = [*OF_TWO, "first_reference=SP1", "second_reference=SP2"]
    run = mapped(tmp_path, Heaters, TWO, closed)
    assert run.has_reference
    assert run.samples[2] == Sample(
        2, EPOCH + 4 * 10**9, (45.0, 55.0), (23.0, 33.0), (12.0, 20.0)
    )
    names = (
        "time",
        "output.1",
        "output.2",
        "input.1",
        "input.2",
        "reference.1",
        "reference.2",
    )
    numbered = [
        f"{name}={entry.partition('=')[2]}"
        for name, entry in zip(names, closed, strict=True)
    ]
    assert mapped(tmp_path, Heaters, TWO, numbered).samples == run.samples
    with pytest.raises(
        RecordingError,
        match=r"no signal 'output.3'; it has time, first \(output.1\), s",
    ):
        mapped(tmp_path, Heaters, TWO, [*numbered, "output.3=T1"])
    with pytest.raises(RecordingError, match=r"first and output.1 are the same signal"):
        mapped(tmp_path, Heaters, TWO, [*OF_TWO, "output.1=T1"])
    driven = mapped(tmp_path, Heaters, TWO, OF_TWO)
    assert not driven.has_reference
    assert {s.references for s in driven.samples} == {(21.0, 31.0)}
    with pytest.raises(
        RecordingError,
        match="first_reference is given, but not second_reference; give all",
    ):
        mapped(tmp_path, Heaters, TWO, closed[:-1])
    with pytest.raises(
        RecordingError, match="no column is mapped to second and none to second_power"
    ):
        mapped(tmp_path, Heaters, TWO, [OF_TWO[0], OF_TWO[1], OF_TWO[3]])
    with pytest.raises(
        RecordingError,
        match=r"first_power is 300 % \(and in 2 more\), beyond the limits of its",
    ):
        mapped(
            tmp_path,
            Heaters,
            TWO,
            [*OF_TWO[:3], "first_power=Q1; offset=290", OF_TWO[4]],
        )
    plant = Path(exchanging.__file__)
    session = tmp_path / "two"
    process = run_twinmatch(
        "import",
        written(tmp_path, TWO),
        "--plant",
        plant,
        "--map",
        *closed,
        "-o",
        session,
    )
    assert process.returncode == 0, process.stderr
    assert read_session(session).samples == run.samples


def test_means_switches_and_disturbances_are_taken_as_the_map_says(
    tmp_path: Path, heated: type[Plant]
) -> None:
    run = mapped(tmp_path, heated)
    assert [s.output for s in run.samples] == [21, 22, 23, 24]
    assert [s.input for s in run.samples] == [0, 100, 100, 0]
    assert [s.disturbances for s in run.samples] == [(19.5,), (19.5,), (19.6,), (19.6,)]
    assert [s.index for s in run.samples] == [0, 1, 2, 3]
    assert run.period == 1.0
    assert not run.has_reference
    assert {s.reference for s in run.samples} == {21.0}
    assert any("no set-point" in note for note in run.notes)


@pytest.mark.parametrize(
    "text",
    [
        CSV.replace(",", ";").replace("19.5", "19,5").replace("19.6", "19,6"),
        CSV.replace(",", "\t").replace("False", "off").replace("True", "on"),
        "# of a logger\n" + CSV.replace("t,T1,T2", " t , T1 (degC), T2 [K] ").replace(
            ",22,F", ",295.15,F").replace(",23,T", ",296.15,T").replace(",24,T", ",297.15,T").replace(
            ",25,F", ",298.15,F"),
        "\ufeff" + CSV.replace("\n", "\r\n"),
        CSV.replace("\n0,", "\n1611326938000000000,").replace("\n1,", "\n1611326939000000000,").replace(
            "\n2,", "\n1611326940000000000,").replace("\n3,", "\n1611326941000000000,"),
        CSV.replace("\n0,", "\n2021-01-22 14:48:58,").replace("\n1,", "\n2021-01-22 14:48:59,").replace(
            "\n2,", "\n2021-01-22T14:49:00Z,").replace("\n3,", "\n2021-01-22T14:49:01.0000000+00:00,"),
        CSV.replace("t,", "t (min),").replace("\n1,", "\n0.0166666666667,").replace(
            "\n2,", "\n0.0333333333333,").replace("\n3,", "\n0.05,"),
        CSV.replace("\n1,", "\n0.5,,,,\n1,"),
        CSV.replace("\n0,", "\n03.04.2021 14:48:58,").replace("\n1,", "\n3.4.2021 14:48:59.0,").replace(
            "\n2,", "\n03.04.2021 14:49:00.000,").replace("\n3,", "\n03.04.2021T14:49:01+00:00,"),
        "".join(2 * line if line.startswith("2,") else line for line in CSV.splitlines(keepends=True)),
    ],
    ids=["comma decimals", "tabs", "units", "windows", "ns since 1970", "dates", "minutes", "empty cells",
         "dotted dates", "a row twice"],
)  # fmt: skip
def test_a_table_may_be_written_in_several_ways(
    tmp_path: Path, heated: type[Plant], text: str
) -> None:
    run = mapped(tmp_path, heated, text)
    np.testing.assert_allclose(
        [s.output for s in run.samples], [21, 22, 23, 24], atol=1e-9
    )
    assert [s.input for s in run.samples] == [0, 100, 100, 0]
    assert run.period == 1.0


def test_rows_of_one_time_that_differ_are_refused(
    tmp_path: Path, heated: type[Plant]
) -> None:
    row = next(line for line in CSV.splitlines(keepends=True) if line.startswith("2,"))
    differing = row.replace(",23,", ",23.5,").replace(",24,", ",24.5,")
    assert differing != row
    with pytest.raises(
        RecordingError,
        match=r"time does not advance from 2 s in line 4 to 2 s in line 5",
    ):
        mapped(tmp_path, heated, CSV.replace(row, row + differing))


HEADLESS = "".join(f"{k},2{k % 3}.5,{k // 40 * 10}\n" for k in range(120))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            HEADLESS,
            "line 1: has numbers; .*: write one above it, such as time,output,input",
        ),
        (
            "time (s),output,input\n"
            + "".join(f"{k // 50},2{k % 3}.5,{k % 7}\n" for k in range(300)),
            "line 2 and line 3 have the same time, 0 s.*too few digits for rows about 0.02 s apart; .*"
            "--period 0.02",
        ),
        (
            "time,output,input\n"
            + "".join(f"{k % 60},2{k % 3}.5,{k // 40}\n" for k in range(120)),
            "does not advance from 59 s in line 61 to 0 s in line 62; if a clock was set back .*--gaps split",
        ),
    ],
    ids=["headless", "whole seconds", "restarted"],
)
def test_times_and_titles_that_loggers_get_wrong_have_one_message(
    tmp_path: Path, text: str, message: str
) -> None:
    table = tmp_path / "log.csv"
    table.write_text(text)
    with pytest.raises(RecordingError, match=message):
        map_samples(
            read_table(table),
            SignalMap(proposed(columns_of(read_table(table)))),
            Motor,
        )


def test_a_drive_may_be_called_output(tmp_path: Path) -> None:
    path = plant_file(tmp_path, "heated_by_output")
    path.write_text(path.read_text().replace("heater", "output"))
    plant = find_plant(str(path))
    table = tmp_path / "log.csv"
    table.write_text("time,temperature,output\n0,20,0\n1,21,50\n2,22,50\n")
    maps = SignalMap(), parse_map(["output=temperature", "input=output"])
    for given_map in maps:
        run = map_samples(
            read_table(table),
            with_plant_names(read_table(table), plant, given_map),
            plant,
        )
        assert [(sample.output, sample.input) for sample in run.samples] == [
            (20, 0),
            (21, 50),
            (22, 50),
        ]


def test_quoted_decimal_commas_are_read(tmp_path: Path) -> None:
    table = tmp_path / "log.csv"
    table.write_text(
        'time,output,input\n"0,0","20,25","1,5"\n"0,5","20,75","2,5"\n"1,0","21,25","3,5"\n'
    )
    assert read_table(table).columns["output"].tolist() == [20.25, 20.75, 21.25]
    table.write_text('time,output,input\n0,"1,234",1\n1,"2,345",1\n2,"3,456",1\n')
    with pytest.raises(RecordingError, match="without separators of thousands"):
        read_table(table).values("output")


def test_a_time_column_may_repeat_a_few_stamps(tmp_path: Path) -> None:
    """And a counter that stands still most of the time is not a time, whatever the first column is called."""
    stamps = [10 * k for k in range(100)]
    stamps[50] = stamps[49]
    path = tmp_path / "log.csv"
    path.write_text(
        "time (ms),speed,pwm\n"
        + "".join(f"{t},{(t * 7) % 11},{t % 3}\n" for t in stamps)
    )
    assert proposed(columns_of(read_table(path)))["time"].places == ("time (ms)",)
    path.write_text(
        "timer,speed,pwm\n"
        + "".join(f"{t // 300},{(t * 7) % 11},{t % 3}\n" for t in stamps)
    )
    assert "time" not in proposed(columns_of(read_table(path)))


def test_a_recording_that_knows_its_date_keeps_it(
    tmp_path: Path, heated: type[Plant]
) -> None:
    dated = CSV.replace("\n0,", "\n1611326938,").replace("\n1,", "\n1611326939,").replace(
        "\n2,", "\n1611326940,").replace("\n3,", "\n1611326941,")  # fmt: skip
    assert mapped(tmp_path, heated, dated).samples[0].stamp == 1_611_326_938 * 10**9
    assert mapped(tmp_path, heated).samples[0].stamp == 946_684_800 * 10**9


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (["output=T1", "heater=on"], r"no column is mapped to time; add --map time=COLUMN"),
        ([*MAP, "reference=set"], r"has no column 'set'; it has 't', 'T1'"),
        ([*MAP, "rom=room"], r"plant block_mapped has no signal 'rom'; .*output \(temperature\).*room"),
        ([*MAP, "output=T1"], "output is given twice"),
        ([*MAP, "input=on"], "heater and input are the same signal"),
        (["time"], "write SIGNAL=COLUMN"),
        (["time=t; unit=V", *MAP[1:]], "is in V, not a unit of time"),
        (["time=t", "output=T1; unit=V", *MAP[2:]], "'T1' is in V, but the plant's output in °C"),
        (["time=t", "output=T1; scale=much", *MAP[2:]], "scale: is 'much'; give a number"),
        (["time=t", "output=T1; scale=0", *MAP[2:]], "scale is 0"),
        (["time=t", "output=T1; factor=2", *MAP[2:]], "factor: is not a known key; there are column,"),
        (["time=t", "output=T1; offset=273.15", *MAP[2:]], r"line 2: output is 293.15 °C \(and in 3 more\), "
         r"beyond the span of its output, -10 to 120; if the column is in K, write 'output=COLUMN; unit=K'"),
        (["time=t", "output=T1", "input=on; scale=255"], r"line 3: input is 255 % .*'input=COLUMN; scale="),
        (["time=room", *MAP[1:]], "time does not advance"),
    ],
)  # fmt: skip
def test_maps_that_do_not_fit_are_explained(
    tmp_path: Path, heated: type[Plant], entries: list[str], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        mapped(tmp_path, heated, entries=entries)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            CSV.replace(",20,", ",cold,"),
            "line 2: 'T1' is 'cold', which is not a number",
        ),
        (
            CSV.replace("2,22,", "9,22,").replace("3,23", "10,23"),
            "a gap of 8 s after line 3",
        ),
        (CSV.replace("t,T1,T2,on,room\n", ""), "the first line must name the columns"),
        ("a,b\n", "has 1 lines"),
        (
            CSV.replace("\n0,", "\n45321.50000,")
            .replace("\n1,", "\n45321.50001,")
            .replace("\n2,", "\n45321.50002,")
            .replace("\n3,", "\n45321.50003,"),
            "'t' goes from 45321.5 to 45321.5 in small steps: .*Write time='t; unit=d' or",
        ),
        (
            CSV.replace("\n0,", "\n2021-01-22 14:48:58,")
            .replace("\n1,", "\n2021-01-22 14:48:59,")
            .replace("\n2,", "\n2021-01-22 14:49:00,")
            .replace("\n3,", "\n2021-01-22T15:49:01+01:00,"),
            "line 5: 't' has a time zone, but none in line 2; write all rows alike",
        ),
        (
            CSV.replace("\n1,", "\n1000,")
            .replace("\n2,", "\n2000,")
            .replace("\n3,", "\n3000,"),
            "its rows are 1000 s apart, but .* settles within 100 s: .*'time=COLUMN; unit=ms'",
        ),
    ],
)
def test_tables_that_cannot_be_used_are_explained(
    tmp_path: Path, heated: type[Plant], text: str, message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        mapped(tmp_path, heated, text)


@pytest.mark.parametrize("title", ["t_ms", "t (ms)", "elapsed ms", "time_ms"])
def test_the_unit_in_a_times_title_counts(
    tmp_path: Path, heated: type[Plant], title: str
) -> None:
    text = (
        CSV.replace("t,T1", f"{title},T1")
        .replace("\n1,", "\n1000,")
        .replace("\n2,", "\n2000,")
    )
    text = text.replace("\n3,", "\n3000,")
    assert proposed(columns_of(read_table(written(tmp_path, text))))["time"].places == (
        title,
    )
    assert mapped(tmp_path, heated, text, [f"time={title}", *MAP[1:]]).period == 1.0


def test_days_of_a_spreadsheet_are_dates_if_the_map_says_so(
    tmp_path: Path, heated: type[Plant]
) -> None:
    days = [45321.5 + k / 86400 for k in range(4)]
    text = CSV
    for k, day in enumerate(days):
        text = text.replace(f"\n{k},", f"\n{day:.9f},")
    run = mapped(tmp_path, heated, text, ["time=t; unit=d", *MAP[1:]])
    assert run.period == pytest.approx(1.0, abs=1e-3)
    # 45321 is 2024-01-30 in every spreadsheet.
    assert run.samples[0].stamp == round(1_706_616_000e9)


def test_a_mark_for_no_value_is_not_a_reading(
    tmp_path: Path, heated: type[Plant]
) -> None:
    run = mapped(
        tmp_path, heated, CSV.replace("2,22,24,True,19.6", "2,22,24,True,-999")
    )
    assert [s.disturbances for s in run.samples] == [
        (19.5,),
        (19.5,),
        (19.55,),
        (19.6,),
    ]
    assert any("1 rows lack a value" in note for note in run.notes)


def test_below_absolute_zero_nothing_was_read(
    tmp_path: Path, heated: type[Plant]
) -> None:
    """Of a disturbance neither: such rows are left out, and the gap that remains says why it is there."""
    run = mapped(
        tmp_path, heated, CSV.replace("2,22,24,True,19.6", "2,22,24,True,-8000")
    )
    assert [s.disturbances for s in run.samples] == [
        (19.5,),
        (19.5,),
        (19.55,),
        (19.6,),
    ]
    assert (
        "room is below absolute zero in 1 rows, -8000 in line 4 first: nothing has read that."
        in run.notes
    )
    rows = [
        f"{k},{20 + k % 3},24,{k % 2},{-8000 if 10 <= k < 20 else 19}"
        for k in range(30)
    ]
    with pytest.raises(
        RecordingError, match=r"a gap of 11 s .*room is below absolute zero in 10 rows"
    ):
        mapped(tmp_path, heated, "\n".join(["t,T1,T2,on,room", *rows]) + "\n")


def test_a_number_that_is_a_mark_elsewhere_may_be_a_reading() -> None:
    values = np.array([-1005.0, -999.0, -990.0, np.nan])
    np.testing.assert_array_equal(without_marks(values), values)


def test_without_set_points_the_loop_is_taken_as_not_known(tmp_path: Path) -> None:
    text = "time,speed,volts\n0,1,2\n0.05,1,2\n0.1,1,2\n"
    table = read_table(written(tmp_path, text))
    run = map_samples(table, with_plant_names(table, Motor, SignalMap()), Motor)
    assert Motor.loop is not None
    assert not run.has_reference
    records = {PLANT: {"plant": "tclab", "reference": "none"}}
    session = read_session(
        write_session(tmp_path / "run", run.samples, records=records)
    )
    assert (session.plant, session.has_reference) == ("tclab", False)
    assert terms_from_files(session).settings.law is None


def test_a_few_odd_readings_are_those_of_a_sensor_that_failed(
    tmp_path: Path, heated: type[Plant]
) -> None:
    rows = [f"{k},{-127 if k == 50 else 30},30,True,20" for k in range(300)]
    run = mapped(
        tmp_path,
        heated,
        "\n".join(["t,T1,T2,on,room", *rows]),
        ["time=t", "output=T1", *MAP[2:]],
    )
    assert run.samples[50].output == -127
    assert any("line 52, output is -127" in note for note in run.notes)


def test_columns_called_as_the_signals_need_no_map(
    tmp_path: Path, heated: type[Plant]
) -> None:
    table = read_table(
        written(
            tmp_path, CSV.replace("t,T1,T2,on", "Time (s),Temperature (degC),x,Heater")
        )
    )
    run = map_samples(table, with_plant_names(table, heated, SignalMap()), heated)
    assert run.sources["output"].places == ("Temperature (degC)",)
    assert run.sources["room"].places == ("room",)


@given(
    scale=st.floats(0.01, 100).map(lambda x: round(x, 3)),
    offset=st.floats(-50, 50).map(lambda x: round(x, 2)),
    values=st.lists(st.floats(0, 100), min_size=3, max_size=30),
)
def test_what_was_scaled_by_a_logger_is_scaled_back(
    tmp_path_factory: pytest.TempPathFactory,
    heated: type[Plant],
    scale: float,
    offset: float,
    values: list[float],
) -> None:
    raw = (np.array(values) - offset) / scale
    text = "k,raw,duty\n" + "".join(
        f"{k * 0.5!r},{float(x)!r},0.5\n" for k, x in enumerate(raw)
    )
    entries = [
        "time=k",
        f"output=raw; scale={scale!r}; offset={offset!r}",
        "input=duty; unit=1",
    ]
    run = mapped(tmp_path_factory.getbasetemp(), heated, text, entries)
    np.testing.assert_allclose([s.output for s in run.samples], values, atol=1e-9)
    assert {s.input for s in run.samples} == {50.0}
    assert run.period == 0.5


def test_a_map_in_a_file_says_the_same(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(
        "plant: block\nperiod: 3\ncolumns:\n  time: {column: time, unit: ns}\n  output: [t2, t3]\n"
        "  input: heater_on; unit=1\n  room: {column: t1, scale: 0.1, offset: -40}\n"
    )
    signal_map = read_map(path)
    assert (signal_map.plant, signal_map.period) == ("block", 3.0)
    assert signal_map.sources == {
        "time": SignalSource(("time",), "ns"),
        "output": SignalSource(("t2", "t3")),
        "input": SignalSource(("heater_on",), "1"),
        "room": SignalSource(("t1",), scale=0.1, offset=-40.0),
    }
    entries = [
        f"{signal}={source.text}"
        for signal, source in signal_map.sources.items()
        if signal != "output"
    ]
    assert all(
        parse_map(entries).sources[name] == signal_map.sources[name]
        for name in ("time", "input", "room")
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1", "is not valid YAML"),
        ("output: T", "output: is not a known key; there are columns, period, plant"),
        ("columns: {output: T}\nplants: x", "plants: is not a known key"),
        ("columns: {output: 3}", "output: is 3; give names with values"),
        ("columns: {output: {column: T, scale: x}}", "scale: is 'x'; give a number"),
        ("columns: {output: []}", "the column is missing"),
        ("period: -1\ncolumns: {output: T}", "period is -1"),
    ],
)
def test_files_that_are_not_maps_are_explained(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(text)
    with pytest.raises(TwinmatchError, match=message):
        read_map(path)


def test_vectors_and_matrices_of_matlab_are_columns(
    tmp_path: Path, heated: type[Plant]
) -> None:
    path = tmp_path / "run.mat"
    t = np.arange(5.0)
    scipy.io.savemat(
        path, {"t": t, "X": np.column_stack([t + 20, t * 10]), "note": "x"}
    )
    run = map_samples(
        read_table(path), parse_map(["time=t", "output=X[1]", "input=X[2]"]), heated
    )
    assert [s.output for s in run.samples] == [20, 21, 22, 23, 24]
    assert [s.input for s in run.samples] == [0, 10, 20, 30, 40]


@pytest.mark.parametrize(
    ("text", "guess"),
    [
        ("time,Q,T\n0,0,22\n1,80,23\n2,80,22.5\n", {"time": "time", "input": "Q", "output": "T"}),
        (
            "Time (sec),Heater 1 (%),Temperature 1 (degC),Set Point (degC)\n0,0,20,23\n1,9,20,2\n2,9,21,2\n",
            {"time": "Time (sec)", "input": "Heater 1 (%)", "output": "Temperature 1 (degC)",
             "reference": "Set Point (degC)"},
        ),
        (
            "when,t_room,t2,heater_on\n2021-01-22 10:00,20,25,true\n2021-01-22 10:01,20,26,false\n"
            "2021-01-22 10:02,20.1,27,true\n",
            {"time": "when", "input": "heater_on", "output": "t2", "room": "t_room"},
        ),
        ("a,b,c\n0.1,7,1.5\n0.2,7,1.7\n0.3,9,1.2\n", {"time": "a", "input": "b", "output": "c"}),
        ("uEst,yEst,Ts\n3.2,5.2,4\n3.3,5.4,\n3.1,5.3,\n", {"input": "uEst", "output": "yEst"}),
        # of a heat exchanger: the flow is named like a measurement, but moves in steps
        (
            "s,Flow,T_out,Steam\n"
            + "".join(f"{k},{5 + k // 20},{60 + k % 7 / 10},{118 + k % 3 / 10}\n" for k in range(80)),
            {"time": "s", "input": "Flow", "output": "T_out"},
        ),
    ],
)  # fmt: skip
def test_a_map_is_proposed(tmp_path: Path, text: str, guess: dict[str, str]) -> None:
    proposal = proposed(columns_of(read_table(written(tmp_path, text))))
    assert {signal: source.text for signal, source in proposal.items()} == guess


def test_a_table_without_times_needs_only_the_distance_of_its_rows(
    tmp_path: Path, heated: type[Plant]
) -> None:
    table = read_table(written(tmp_path, "heat,T,Ts\n10,20,4\n20,21,\n20,22,\n"))
    signal_map = parse_map(["output=T", "input=heat"])
    run = map_samples(table, replace(signal_map, period=4.0), heated)
    assert run.period == 4.0
    assert [s.output for s in run.samples] == [20, 21, 22]
    with pytest.raises(
        RecordingError, match=r"mapped to time; .*give --period SECONDS instead"
    ):
        map_samples(table, signal_map, heated)


def test_units_of_time_are_recognised_by_size_also_beside_infinite_times(
    tmp_path: Path,
) -> None:
    table = read_table(written(tmp_path, "a,b\n1611326938720,1\n1611326939720,2\n"))
    times = read_times(table, "a")
    assert times.seconds.tolist() == [0.0, 1.0]
    assert times.origin == pytest.approx(1611326938.72)
    table = read_table(written(tmp_path, "t,a\n0,1\n1,2\ninf,3\n3,4\n"))
    assert read_times(table, "t").seconds[[0, 1, 3]].tolist() == [0.0, 1.0, 3.0]


def test_the_command_lists_imports_and_says_of_which_plant_a_session_is(
    tmp_path: Path,
) -> None:
    plant = plant_file(tmp_path, "block_command")
    table = written(tmp_path, CSV)
    listed = run_twinmatch("import", table, "--list")
    assert listed.returncode == 0, listed.stderr
    assert "--map time=t output=T1 input=on" in listed.stdout
    refused = run_twinmatch("import", table, "--map", *MAP, "-o", tmp_path / "session")
    assert refused.returncode == 2
    assert "the plant is missing; give --plant" in refused.stderr
    assert not (tmp_path / "session").exists()
    imported = run_twinmatch(
        "import", table, "--plant", plant, "--map", *MAP, "-o", tmp_path / "session"
    )
    assert imported.returncode == 0, imported.stderr
    assert "4 samples, one every 1 s" in imported.stdout
    session = read_session(tmp_path / "session")
    assert session.plant == "block_command"
    assert session.samples[1].disturbances == (19.5,)
    # nobody recorded a set-point
    assert session.counts == {"/plant/sample": 4, "/plant/temperature": 4}
    # which does not know the plant
    replayed = run_twinmatch("replay", tmp_path / "session")
    assert replayed.returncode == 2
    assert "plant 'block_command': not known" in replayed.stderr
    assert "--plant block_command.py" in replayed.stderr
    assert len(replayed.stderr.strip().splitlines()) == 1


def test_a_session_has_a_temperature_only_if_the_plant_has_one(tmp_path: Path) -> None:
    plant = plant_file(
        tmp_path, "block_in_kelvin", ('Output(unit="°C"', 'Output(unit="K"')
    )
    entries = [*MAP, "reference=T1"]
    process = run_twinmatch(
        "import",
        written(tmp_path, CSV),
        "--plant",
        plant,
        "--map",
        *entries,
        "-o",
        tmp_path / "session",
    )
    assert process.returncode == 0, process.stderr
    assert read_session(tmp_path / "session").counts == {
        "/plant/sample": 4,
        "/plant/reference": 4,
    }


PLAIN = "t,T (°C),on\n" + "".join(f"{k},{20 + k % 7},{k % 2}\n" for k in range(9))


@pytest.mark.parametrize(
    "content",
    [
        PLAIN.encode(),
        PLAIN.encode("utf-8-sig"),
        PLAIN.encode("utf-16"),
        PLAIN.encode("cp1252"),
        PLAIN.replace(",", ";").encode(),
        ("sep=|\n" + PLAIN.replace(",", "|")).encode(),
        PLAIN.replace("T (°C),on\n", "T,on\ns,°C,-\n").encode(),
        PLAIN.replace(",on\n", ",on\ns,°C,\n").encode(),
    ],
)
def test_a_table_is_read_however_it_is_written(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "log.csv").write_bytes(content)
    table = read_table(tmp_path / "log.csv")
    temperature = table.find("T")
    assert table.unit(temperature) == "°C"
    assert table.values(temperature).tolist() == [20 + k % 7 for k in range(9)]


ODD_CELLS = (
    "",
    "nan",
    "yes",
    "No",
    "text",
    " 7 ",
    "1e400",
    "-inf",
    "1_0",
    '"8"',
    "0.1",
    "-",
    "1,5",
    "9,,",
    "３",
)


@pytest.mark.parametrize("divider", [",", ";"])
@pytest.mark.parametrize("blocks", [1, 3, 4096])
def test_a_table_holds_the_same_numbers_however_many_rows_are_read_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, divider: str, blocks: int
) -> None:
    """Each odd cell stands between plain rows, behind the lines that tell how the table is written."""
    plain = [f"{k}{divider}{k / 7!r}{divider}{divider}" for k in range(60)]
    odd = [f"{k}{divider}{cell}{divider}3{divider}" for k, cell in enumerate(ODD_CELLS)]
    mixed = [
        row
        for k, odd_row in enumerate(odd)
        for row in (odd_row, *plain[k : k + 5], "", "# a remark")
    ]
    path = written(
        tmp_path, "\n".join((divider.join(("t", "T", "u", "v")), *plain, *mixed)) + "\n"
    )
    monkeypatch.setattr(tables, "_BLOCK", blocks)
    if divider == ",":
        path.write_text(
            path.read_text("utf-8").replace("1,5,", '"1,5",').replace("9,,,3", "9,3"),
            "utf-8",
        )
    table = read_table(path)
    monkeypatch.setattr(Cells, "take_plain", lambda *_: False)  # cell by cell
    wanted = read_table(path)
    assert list(table.lines) == list(wanted.lines)
    assert table.texts == wanted.texts
    for title, column in wanted.columns.items():
        assert table.columns[title].tobytes() == column.tobytes()


@pytest.mark.parametrize(
    ("text", "message"),
    [  # the first row has a word, and not units
        (
            "day,T\n2021-01-01 10:00,m\n2021-01-01 10:01,2\n2021-01-01 10:02,3\n",
            "line 2: 'T' is 'm', which is",
        ),
        (
            't,T\n0,"1,000"\n1,"2,000"\n',
            "write numbers without separators of thousands",
        ),
    ],
)
def test_cells_that_are_not_numbers_are_refused_in_words(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        read_table(written(tmp_path, text)).values("T")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            PLAIN.encode("utf-16-le"),
            "is not text in a known encoding; save it as UTF-8",
        ),
        (bytes(range(256)) * 9, "is not text in a known encoding; save it as UTF-8"),
        (
            b"PK\x03\x04" + bytes(99),
            "is a ZIP archive, such as an Excel workbook; save the table as CSV",
        ),
        (
            b"sep=;\nt;T\n",
            "give column names and at least two rows; the file has 1 lines of a table",
        ),
    ],
)
def test_what_is_not_a_table_is_refused(
    tmp_path: Path, content: bytes, message: str
) -> None:
    (tmp_path / "log.csv").write_bytes(content)
    with pytest.raises(RecordingError, match=message):
        read_table(tmp_path / "log.csv")


def test_the_input_of_an_interval_may_stand_at_its_end(
    tmp_path: Path, heated: type[Plant]
) -> None:
    text = "time,T,power,room\n0,20,9,19\n1,20,1,19\n2,21,2,19\n3,22,3,19\n"
    entries = ["time=time", "output=T", "input=power; interval=before", "room=room"]
    signal_map = parse_map(entries)
    samples = mapped(tmp_path, heated, text, entries).samples
    assert [sample.input for sample in samples] == [1.0, 2.0, 3.0, 3.0]
    assert signal_map.sources["input"].text == "power; interval=before"
    with pytest.raises(
        SamplingError, match="input: interval=before is for the rows of a table"
    ):
        signal_map.sources["input"].channels("input")
