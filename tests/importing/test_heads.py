"""Names, remarks and units in text tables: no row gets lost as names, no remark makes a column text."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from twinmatch.importing.column_map import columns_of, proposed
from twinmatch.importing.stacked import taken_apart
from twinmatch.importing.table_files import open_table
from twinmatch.importing.tables import Table, read_table, split_title
from twinmatch.sessions.files import RecordingError
from twinmatch.units import quantity_in

ROWS = [f"{k},{20 + k % 5}.5,{k % 2}" for k in range(40)]
DATED = [f"2026-03-01 10:00:{k:02d},{20 + k % 5}.5,{k % 2}" for k in range(40)]


def table_of(folder: Path, *lines: str) -> Table:
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_table(path)


@pytest.mark.parametrize(
    "lines",
    [
        ["# logger 7", "#time,T,on", *ROWS],
        ["# time, T, on", "# s, degC, -", *ROWS],
        ["#time,T,on", *DATED],
        ["Logger 7", "Serial: 12;34", "", "time,T,on", *ROWS],
        ["time,T,on", *ROWS, "End of log"],
        ["time,T,on", *ROWS[:20], "logger restarted,,", "time,T,on", *ROWS[20:]],
        ["time,T,on", *ROWS, "mean,22.5,0.5", "last sample at 10:00"],
        ["time,T,on", *DATED, "End of log,,"],
        ["time T on", *(row.replace(",", "   ") for row in ROWS)],
        ["# time T on", *(row.replace(",", " ") for row in ROWS)],
    ],
    ids=["hash", "hash, units", "hash, dates", "preamble", "foot", "inside", "sums", "foot of dates",
         "spaces", "savetxt"],
)  # fmt: skip
def test_every_row_is_read_whatever_stands_around_them(
    tmp_path: Path, lines: list[str]
) -> None:
    table = table_of(tmp_path, *lines)
    assert [title.partition(" ")[0] for title in table.columns] == ["time", "T", "on"]
    assert table.values(table.find("T")).tolist() == [20.5 + k % 5 for k in range(40)]


def test_what_is_left_out_is_named_by_its_line(tmp_path: Path) -> None:
    table = table_of(tmp_path, "Logger 7", "time,T,on", *ROWS, "End of log")
    assert table.notes == (
        "Line 1 stands above the column names and is left out.",
        "Line 43 is not a row and is left out: 'End of log'.",
    )
    assert table_of(tmp_path, "# all names", "#time,T,on", *ROWS).notes == (
        "The column names are those behind the # in line 2.",
    )
    assert table_of(tmp_path, "time,T,on", *ROWS).notes == ()


@pytest.mark.parametrize(
    "rows", [ROWS, DATED, [row.replace(",0", ",OFF") for row in DATED]]
)
def test_a_row_is_not_taken_for_names(tmp_path: Path, rows: list[str]) -> None:
    with pytest.raises(
        RecordingError, match=r"line 1: has .*; the first line must name the columns"
    ):
        table_of(tmp_path, *rows)


def test_names_may_be_numbers_beside_others(tmp_path: Path) -> None:
    table = table_of(tmp_path, "time,1,2", *ROWS)
    assert list(table.columns) == ["time", "1", "2"]


def test_a_wrong_cell_inside_stays_an_error_with_its_line(tmp_path: Path) -> None:
    lines = ["time,T,on", *ROWS]
    lines[12] = "11,cold,1"
    with pytest.raises(
        RecordingError, match="line 13: 'T' is 'cold', which is not a number"
    ):
        table_of(tmp_path, *lines).values("T")


@pytest.mark.parametrize(
    ("text", "quantity"),
    [
        ("17.99 °C", (17.99, "°C")),
        ("0%", (0.0, "%")),
        ("21,5 W", (21.5, "W")),
        ("20.6 ℃", (20.6, "℃")),
        ("-3.5e2 mV", (-350.0, "mV")),
        ("1,234 W", None),  # thousands, or not
        ("2nd heater", None),
        ("12:30", None),
        ("2026-03-01", None),
        ("0d 00:00:02", None),
        ("heat", None),
        ("5", None),
    ],
)
def test_a_number_with_its_unit_is_a_quantity(
    text: str, quantity: tuple[float, str] | None
) -> None:
    assert quantity_in(text) == quantity


def test_units_and_commas_in_cells_are_read(tmp_path: Path) -> None:
    rows = [f'{k};{20 + k}.5 °C;{10 * k}%;"21,{k}"' for k in range(10)]
    table = table_of(tmp_path, "time;T;duty;room", *rows)
    assert table.values("T").tolist() == [20.5 + k for k in range(10)]
    assert (table.unit("T"), table.unit("duty"), table.unit("room")) == ("°C", "%", "")
    assert table.values("duty").tolist() == [10.0 * k for k in range(10)]
    assert table.values("room").tolist() == [float(f"21.{k}") for k in range(10)]


def test_a_line_of_units_may_have_brackets(tmp_path: Path) -> None:
    table = table_of(
        tmp_path,
        "Time,Channel A",
        "(s),(degC)",
        "",
        *(f"{k},{20 + k}" for k in range(9)),
    )
    assert list(table.columns) == ["Time (s)", "Channel A (degC)"]


def test_two_units_in_one_column_are_refused(tmp_path: Path) -> None:
    rows = [f"{k},{20 + k} °C" for k in range(10)]
    with pytest.raises(
        RecordingError, match="line 12: 'T' is '68 °F', which is not a number"
    ):
        table_of(
            tmp_path,
            "time,T",
            *rows,
            "10,68 °F",
            *(f"{k},{20 + k} °C" for k in range(11, 30)),
        ).values("T")


TABBED = [row.replace(",", "\t") for row in ROWS]
SEMICOLONS = [row.replace(",", ";") for row in ROWS]
OBJECTS = [
    json.dumps(dict(zip(("time", "T", "on"), map(float, row.split(",")), strict=True)))
    for row in ROWS
]


@pytest.mark.parametrize(
    "lines",
    [
        pytest.param(
            [
                '"TOA5","CR1000","CR1000","1234"',
                '"time","T","on"',
                '"TS","Deg C","-"',
                '"","Avg","Smp"',
                *DATED,
            ],
            id="kinds of values",
        ),
        pytest.param(
            ["Date:1.3.2026\tUnit:C\tSTART:00:30\tEND:12:00", "time\tT\ton", *TABBED],
            id="wider remarks",
        ),
        pytest.param(
            [
                "Logger\t",
                "Channels\t2\t",
                "***End***\t",
                "time\tT\ton\tComment",
                *TABBED,
            ],
            id="narrower rows",
        ),
        pytest.param(
            ["Logger: testo;;", "Begin;01.03.2026 10:00:00;", "time;T;on", *SEMICOLONS],
            id="empty cells",
        ),
        pytest.param(
            ["Model,MDO,", "Interval,5.0,", ",,", "time,T,on", *ROWS], id="settings"
        ),
        pytest.param(
            ["time,T,on", "Comment,none,none", "Rate[ms],1000,1000", *ROWS],
            id="below the names",
        ),
        pytest.param(
            ['"time', '(s)","T', '(°C)",on', *ROWS], id="names over two lines"
        ),
        pytest.param(OBJECTS, id="objects"),
    ],
)
def test_names_are_found_among_remarks(tmp_path: Path, lines: list[str]) -> None:
    table = table_of(tmp_path, *lines)
    assert [title.partition(" ")[0] for title in table.columns][:3] == [
        "time",
        "T",
        "on",
    ]
    assert table.values(table.find("T")).tolist() == [20.5 + k % 5 for k in range(40)]


def test_objects_within_objects_and_arrays_of_them_are_rows(tmp_path: Path) -> None:
    rows = [
        {"time": k, "oven": {"T": 20.5 + k, "note": None}, "tags": [1]}
        for k in range(9)
    ]
    path = tmp_path / "log.json"
    path.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    table = read_table(path)
    assert list(table.columns) == ["time", "oven.T", "oven.note"]
    assert table.values("oven.T").tolist() == [20.5 + k for k in range(9)]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (['{"a": 1}', '{"a": '], "line 2: is not JSON"),
        (['{"a": 1}', "[1]"], "row 2: is not an object"),
        (["[1, 2]"], "give column names"),
        (["[", "1, 2]"], "row 1: is not an object"),
    ],
)
def test_rows_that_cannot_be_objects_are_refused(
    tmp_path: Path, lines: list[str], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        table_of(tmp_path, *lines)


def test_commas_separate_thousands_where_points_are_decimal(tmp_path: Path) -> None:
    rows = [f'{k}.0,"{1000 + k:,}","1,234,{k:03d}.5"' for k in range(9)]
    table = table_of(tmp_path, "time,p,q", *rows)
    assert table.values("p").tolist() == [1000.0 + k for k in range(9)]
    assert table.values("q").tolist() == [1234000.5 + k for k in range(9)]


@pytest.mark.parametrize("word", ["#N/A", "---", "1.#QNAN", "#DIV/0!", "no data"])
def test_what_stands_for_no_value_is_a_gap(tmp_path: Path, word: str) -> None:
    table = table_of(
        tmp_path, "time,T", *(f"{k},{word if k % 2 else 20}" for k in range(40))
    )
    assert np.isnan(table.values("T")[1::2]).all()


@pytest.mark.parametrize(
    ("title", "name_and_unit"),
    [
        ("Temp, °C (LGR S/N: 20512345)", ("Temp", "°C")),
        ("[°C] Probe 1", ("Probe 1", "°C")),
        ("Temperature 1 (degC)", ("Temperature 1", "degC")),
        ("(first) probe", ("(first) probe", "")),
        ("hot water °C", ("hot water", "°C")),
        ("oxygen_%", ("oxygen", "%")),
        ("T degC", ("T", "degC")),
        ("pressure of C", ("pressure of C", "")),
        ("number %1", ("number %1", "")),
        ("50 %", ("50 %", "")),
        ("Flow, cold side (l/min)", ("Flow, cold side", "l/min")),
    ],
)
def test_a_title_has_a_name_and_a_unit(
    title: str, name_and_unit: tuple[str, str]
) -> None:
    assert split_title(title) == name_and_unit


@pytest.mark.parametrize(
    ("form", "titles"),
    [
        ("T:{t},duty:{u},Set:50.0", ["T", "duty", "Set"]),
        ("T:{t}\tduty:{u}", ["T", "duty"]),
        ("T={t} C  PWM={u}", ["T", "PWM"]),
        ("09:15:{k:02d}.000 -> T={t} C  PWM={u}", ["time", "T", "PWM"]),
        ("2026-03-01 09:15:{k:02d}, oven temp: {t}°C; heater: {u}%", ["time", "oven temp", "heater"]),
    ],
)  # fmt: skip
def test_values_with_their_names_before_them_are_a_table(
    tmp_path: Path, form: str, titles: list[str]
) -> None:
    """As sketches write them for a plotter, and monitors with the time; a line of text is left out by name."""
    rows = [form.format(t=20.5 + k % 5, u=k % 2, k=k) for k in range(40)]
    table = table_of(tmp_path, *rows[:20], "sensor restarted", *rows[20:])
    assert [title.partition(" (")[0] for title in table.columns] == titles
    output = next(title for title in table.columns if "T" in title or "temp" in title)
    values = table.values(output)
    assert values[np.isfinite(values)].tolist() == [20.5 + k % 5 for k in range(40)]
    if "time" in titles:
        assert len(table.texts["time"]) == 40


T0 = 1_772_355_600
ANSWERS = {
    "influx": {"results": [{"series": [{"name": "oven", "columns": ["time", "T", "on"],
               "values": [[T0 + 2 * k, 20.5 + k % 5, k % 2] for k in range(40)]}]}]},
    "columns": {"unit": "s", "data": {"time": [T0 + 2 * k for k in range(40)], "T": [20.5 + k % 5 for k in range(40)],
                "on": [k % 2 for k in range(40)]}},
    "objects": {"channel": {"id": 9}, "feeds": [{"time": T0 + 2 * k, "T": f"{20.5 + k % 5} °C", "on": k % 2}
                for k in range(40)]},
}  # fmt: skip


def test_values_that_are_logged_with_their_names_are_a_table(tmp_path: Path) -> None:
    rows = [
        f"ts=2026-03-01T09:15:{k:02d}Z level=info T={20.5 + k % 5} on={k % 2}"
        for k in range(40)
    ]
    table = table_of(tmp_path, *rows)
    assert list(table.columns) == ["ts", "level", "T", "on"]
    assert table.values("T").tolist() == [20.5 + k % 5 for k in range(40)]
    assert proposed(columns_of(table), table)["time"].text == "ts"


@pytest.mark.parametrize("has_frame", [True, False])
def test_a_table_drawn_by_a_client_of_a_database_is_read(
    tmp_path: Path, has_frame: bool
) -> None:
    rule = "+----------+-------+----+" if has_frame else "----------+-------+----"
    end = "|" if has_frame else ""
    rows = [
        f"{end} 00:00:{k:02d} | {20.5 + k % 5:5} | {k % 2:2} {end}" for k in range(40)
    ]
    lines = [f"{end} time     | T     | on {end}", rule, *rows]
    if has_frame:
        lines = [rule, *lines, rule]
    table = table_of(tmp_path, *lines, "(40 rows)")
    assert list(table.columns) == ["time", "T", "on"]
    values = table.values("T")
    assert values[np.isfinite(values)].tolist() == [20.5 + k % 5 for k in range(40)]


@pytest.mark.parametrize("kind", ANSWERS)
@pytest.mark.parametrize("indent", [None, 1])
def test_rows_within_what_a_server_answers_are_a_table(
    tmp_path: Path, kind: str, indent: int | None
) -> None:
    path = tmp_path / "answer.json"
    path.write_text(json.dumps(ANSWERS[kind], indent=indent), encoding="utf-8")
    table = read_table(path)
    assert list(table.columns) == ["time", "T", "on"]
    assert table.values("time").tolist() == [T0 + 2 * k for k in range(40)]
    assert table.values("T").tolist() == [20.5 + k % 5 for k in range(40)]


@pytest.mark.parametrize("labels", [("t", "u"), ("v", "v")])
def test_series_that_a_server_answers_are_told_apart_by_their_labels(
    tmp_path: Path, labels: tuple[str, str]
) -> None:
    """Names of Prometheus, or where they are the same, the labels by which they differ."""
    series = []
    for number, name in enumerate(labels):
        values = [[T0 + 2 * k, str(k % (number + 2))] for k in range(40)]
        metric = {"__name__": name, "place": f"p{number}"}
        series.append({"metric": metric, "values": values})
    path = tmp_path / "answer.json"
    path.write_text(json.dumps({"status": "success", "data": {"result": series}}))
    table = taken_apart(read_table(path))
    ends = [title for title in table.columns if title.startswith("value[")]
    names = ["t", "u"] if labels[0] == "t" else ["v place=p0", "v place=p1"]
    assert ends == [f"value[{name}]" for name in names]
    values = table.values(ends[1])
    assert values[np.isfinite(values)].tolist() == [k % 3 for k in range(40)]


def test_one_object_without_rows_and_a_stream_of_events_lead_on(
    tmp_path: Path,
) -> None:
    with pytest.raises(
        RecordingError, match=r"without rows in it .it has a, b.; write"
    ):
        table_of(tmp_path, '{"a": 1, "b": {"c": 2}}')
    with pytest.raises(RecordingError, match=r"stream of events.* attach --source"):
        table_of(tmp_path, "event: state", 'data: {"id": "sensor-t", "value": 20.5}')


LOGS = {
    "a console": (
        '10:00:00.120 MQT: tele/plug/SENSOR = {"DS18B20":{"Temperature":20.5}}',
        "10:00:00.130 MQT: stat/plug/POWER = ON",
    ),
    "topics": ("home/boiler/temperature 20.5", 'home/valve {"position": 40}'),
    "a Modbus client": ("-- Polling slave...", "[100]: 2050", "[101]: 40"),
    "a printer": ("ok T:20.5 /60.0 B:20.1 /0.0 @:127 B@:0",),
}


@pytest.mark.parametrize("kind", LOGS)
def test_what_a_program_printed_is_said_with_the_way_out(
    kind: str, tmp_path: Path
) -> None:
    with pytest.raises(
        RecordingError, match=r": is (the|a|what) .*; (take|read|write) .*: \S+"
    ):
        table_of(tmp_path, *(LOGS[kind] * 20))


def test_tables_with_dates_and_names_like_those_logs_are_read(tmp_path: Path) -> None:
    """Dates with slashes, a column of topics beside one of times, and a name with `T`."""
    dates = [f"2025/03/04 10:00:{k:02d} {20 + k} {k % 2}" for k in range(40)]
    table = table_of(tmp_path, "date time T/C duty", *dates)
    assert table.values("duty").tolist() == [k % 2 for k in range(40)]
    topics = [f"{k},home/boiler/T,{20 + k}" for k in range(40)]
    table = table_of(tmp_path, "time,topic,value", *topics)
    assert table.values("value").tolist() == [20 + k for k in range(40)]


def test_what_reads_the_output_is_not_an_input(tmp_path: Path) -> None:
    """A meter's largest and smallest value of each interval are beside its reading, and not an input."""
    random = np.random.default_rng(1)
    readings = 20 + np.cumsum(random.standard_normal(200))
    rows = [f"{2 * k},{y:.2f},{y + 0.1:.2f},{y:.2f}" for k, y in enumerate(readings)]
    table = table_of(tmp_path, "time,Sample,Max,Average", *rows)
    assert "input" not in proposed(columns_of(table), table)
    rows = [f"{row},{k % 7}" for k, row in enumerate(rows)]
    table = table_of(tmp_path, "time,Sample,Max,Average,other", *rows)
    assert proposed(columns_of(table), table)["input"].text == "other"


def test_the_unit_of_a_time_is_listed_as_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t_ms,volt_ms,T\n0,3,20\n10,1,21\n20,2,22\n30,1,20\n")
    columns = columns_of(open_table(path))
    assert [column.unit for column in columns] == ["ms", "", ""]


def test_a_temperature_in_c_is_measured_and_no_input(tmp_path: Path) -> None:
    """A C is a coulomb elsewhere, and the temperature was taken for a number like any other."""
    path = tmp_path / "log.csv"
    rows = [f"{k},{20 + k % 7},{k % 5}" for k in range(40)]
    path.write_text("\n".join(["time (s),core (C),chopper", *rows]) + "\n")
    table = open_table(path)
    sources = proposed(columns_of(table), table)
    assert sources["output"].text == "core (C)"
    assert sources["input"].text == "chopper"
