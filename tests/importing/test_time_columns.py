"""Columns of times: their forms, which is one, and what happens where two clocks disagree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.plant_files import plant_file
from twinmatch.cli import main
from twinmatch.importing.column_map import columns_of, proposed
from twinmatch.importing.mapped import times_of, with_titles
from twinmatch.importing.recordings import read_recording
from twinmatch.importing.table_files import open_table
from twinmatch.importing.tables import Table, read_table
from twinmatch.sampling.sources import parse_map
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray


def table_of(folder: Path, header: str, rows: list[str]) -> Table:
    path = folder / "log.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return read_table(path)


def guess(table: Table) -> dict[str, str]:
    return {
        signal: source.text
        for signal, source in proposed(columns_of(table), table).items()
    }


def seconds_of(table: Table, time: str) -> FloatArray:
    return times_of(table, parse_map([f"time={time}"]).sources["time"], None).seconds


def clock(seconds: float, form: str) -> str:
    hours, rest = divmod(seconds, 3600.0)
    minutes, last = divmod(rest, 60.0)
    half = "AM" if hours < 12 else "PM"
    numbers = {
        "h": int(hours),
        "m": int(minutes),
        "s": last,
        "w": int(last),
        "t": int(hours - 1) % 12 + 1,
    }
    return form.format(**numbers, half=half)


@pytest.mark.parametrize(
    "form",
    ["{h:02d}:{m:02d}:{w:02d}", "0d {h:02d}:{m:02d}:{s:05.2f}", "{h}:{m:02d}:{w:02d}",
     "0.{h:02d}:{m:02d}:{w:02d}", "{t:02d}:{m:02d}:{w:02d} {half}", "{m:d}:{s:04.1f}"],
)  # fmt: skip
def test_durations_and_times_of_day_are_times(tmp_path: Path, form: str) -> None:
    begin = 3.0 if form.startswith("{m") else 36_000.0
    rows = [f"{clock(begin + 2.0 * k, form)},{20 + k % 3},{k % 2}" for k in range(25)]
    table = table_of(tmp_path, "Time,T,heater", rows)
    assert guess(table) == {"time": "Time", "output": "T", "input": "heater"}
    assert np.diff(seconds_of(table, "Time")).tolist() == [2.0] * 24


@pytest.mark.parametrize(
    "form",
    [
        "2026-03-01 10:00:{:02d} UTC",
        "2026-03-01 10:00:{:02d} +01:00",
        "2026-03-01 10:00:{:02d}:000",
        "03/01/2026 10:00:{:02d}:123",
        "01-Mar-2026 10:00:{:02d}",
        "Sun Mar  1 10:00:{:02d} 2026",
        "Sunday, March 1, 2026 10:00:{:02d}",
        "1 Mar 2026 10:00:{:02d}.5",
    ],
)
def test_dates_are_read_as_programs_write_them(tmp_path: Path, form: str) -> None:
    rows = [f'"{form.format(2 * k)}",{20 + k % 3},{k % 2}' for k in range(25)]
    table = table_of(tmp_path, "when,T,heater", rows)
    assert guess(table)["time"] == "when"
    assert np.diff(seconds_of(table, "when")).tolist() == pytest.approx([2.0] * 24)


@pytest.mark.parametrize(
    "title", ["ms", "millis", "millis()", "time_ms", "uptime millis"]
)
def test_a_title_may_be_the_unit(tmp_path: Path, title: str) -> None:
    table = table_of(
        tmp_path,
        f"{title},T,heater",
        [f"{2000 * k},{20 + k % 3},{k % 2}" for k in range(25)],
    )
    assert np.diff(seconds_of(table, guess(table)["time"])).tolist() == [2.0] * 24


def test_a_time_of_day_continues_past_midnight(tmp_path: Path) -> None:
    rows = [
        f"{clock((86_380.0 + 2.0 * k) % 86_400.0, '{h:02d}:{m:02d}:{w:02d}')},{k % 3}"
        for k in range(30)
    ]
    assert (
        np.diff(seconds_of(table_of(tmp_path, "Time,T", rows), "Time")).tolist()
        == [2.0] * 29
    )


def test_two_numbers_are_asked_about(tmp_path: Path) -> None:
    table = table_of(tmp_path, "Time,T", [f"00:{k:02d},{k % 3}" for k in range(30)])
    with pytest.raises(
        RecordingError,
        match=r"hours and minutes, or minutes and seconds\? .*unit=h.*unit=min",
    ):
        seconds_of(table, "Time")
    assert np.diff(seconds_of(table, "Time; unit=min")).tolist() == [1.0] * 29
    assert np.diff(seconds_of(table, "Time; unit=h")).tolist() == [60.0] * 29


@pytest.mark.parametrize("date", ["2026-03-02", "02.03.2026", "2026/03/02"])
def test_date_and_time_may_be_in_two_columns(tmp_path: Path, date: str) -> None:
    rows = [
        f"{date},{clock(50_000.0 + 5 * k, '{h:02d}:{m:02d}:{w:02d}')},{20 + k % 3},{k % 2}"
        for k in range(25)
    ]
    table = table_of(tmp_path, "Date,Time,T,heater", rows)
    assert guess(table)["time"] == "Date, Time"
    times = times_of(
        table, with_titles(table, parse_map(["time=Date, Time"]).sources["time"]), None
    )
    assert np.diff(times.seconds).tolist() == [5.0] * 24
    assert times.origin == 1_772_409_600.0 + 50_000.0


@pytest.mark.parametrize(
    "title", ["Record", "No.", "Rec #", "sample number", "index", ""]
)
def test_a_number_of_the_row_is_not_a_time(tmp_path: Path, title: str) -> None:
    table = table_of(
        tmp_path,
        f"{title},T,heater",
        [f"{k},{20 + k % 3},{k % 2}" for k in range(1, 30)],
    )
    assert "time" not in guess(table)


def test_a_column_that_rises_like_a_time_is_not_an_output(tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.1f},{0.1 * k:.1f},{20 + (k // 7) % 3}" for k in range(60)]
    table = table_of(tmp_path, "tout,simout,level", rows)
    assert guess(table) == {"time": "tout", "output": "level"}


def two_clocks(second: str, *, per_row: float = 0.5) -> tuple[str, list[str]]:
    """A column in ms under the label s, beside a second clock; half a second between rows."""
    rows = []
    for k in range(60):
        forms = {
            "when": f"2026-03-01 10:00:{0.5 * k:06.3f}",
            "elapsed (s)": f"{0.5 * k:g}",
            "millis": f"{500 * k}",
            "epoch time": f"{1_700_000_000 + 0.5 * k}",
            "elapsed": f"{0.5 * k:g}",
        }
        rows.append(
            f"{1000 * per_row * k:g},{forms[second]},{20 + k % 5},{k // 10 % 2}"
        )
    return f"time (s),{second},T,heater", rows


@pytest.mark.parametrize("second", ["when", "elapsed (s)", "millis", "epoch time"])
def test_two_clocks_that_disagree_are_said_with_the_way_out(
    tmp_path: Path, second: str
) -> None:
    table = table_of(tmp_path, *two_clocks(second))
    message = (
        r"by 'time \(s\)' the rows are 500 s apart, by '.*' 0.5 s; if 'time \(s\)' counts ms, write "
        r"'time=time \(s\); unit=ms'; if it is right, write 'time=time \(s\); unit=s'; to use the other"
    )
    with pytest.raises(RecordingError, match=message):
        seconds_of(table, "time (s)")
    assert np.diff(seconds_of(table, "time (s); unit=ms")).tolist() == pytest.approx(
        [0.5] * 59
    )
    assert np.diff(seconds_of(table, "time (s); unit=s")).tolist() == pytest.approx(
        [500.0] * 59
    )


@pytest.mark.parametrize(
    "second", ["when", "elapsed (s)", "millis", "epoch time", "elapsed"]
)
def test_clocks_that_agree_are_not_spoken_of(tmp_path: Path, second: str) -> None:
    table = table_of(tmp_path, *two_clocks(second, per_row=0.0005))
    assert np.diff(seconds_of(table, "time (s)")).tolist() == pytest.approx([0.5] * 59)


def test_a_step_time_that_begins_again_is_not_a_second_clock(tmp_path: Path) -> None:
    rows = [f"{k},{k % 20},{k // 2},{20 + k % 3}" for k in range(80)]
    table = table_of(tmp_path, "Test time (s),Step time (s),on time (s),T", rows)
    assert np.diff(seconds_of(table, "Test time (s)")).tolist() == [1.0] * 79


@pytest.mark.parametrize("command", ["new-plant", "check-plant", "import"])
def test_each_command_says_that_two_clocks_disagree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    table = table_of(tmp_path, *two_clocks("when")).path
    plant = plant_file(tmp_path, f"block_{command.replace('-', '_')}")
    arguments = {
        "new-plant": [
            "new-plant",
            "kettle_clocks",
            "--from",
            str(table),
            "-o",
            str(tmp_path),
        ],
        "check-plant": ["check-plant", str(plant), "--data", str(table), "--map"],
        "import": [
            "import",
            str(table),
            "--plant",
            str(plant),
            "-o",
            str(tmp_path / "session"),
            "--map",
        ],
    }[command]
    signals = (
        ["time=time (s)", "output=T", "heater=heater"]
        if arguments[-1] == "--map"
        else []
    )
    assert main([*arguments, *signals]) == 2
    assert "unit=ms" in capsys.readouterr().err
    assert not (tmp_path / "kettle_clocks.py").exists()
    assert not (tmp_path / "session").exists()


def test_a_recording_of_the_rig_with_two_clocks_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    rows = [f"{1000 * k},2026-03-01 10:00:{k:02d},25,{25 + k % 2},0" for k in range(50)]
    path.write_text("\n".join(["time,when,reference,temperature,pwm", *rows]) + "\n")
    with pytest.raises(RecordingError, match="unit=ms"):
        read_recording(path)


def test_a_second_clock_without_a_unit_is_a_note(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = table_of(tmp_path, *two_clocks("elapsed"))
    assert (
        main(
            ["new-plant", "kettle_note", "--from", str(table.path), "-o", str(tmp_path)]
        )
        == 0
    )
    assert "Note: Two clocks: by 'time (s)'" in capsys.readouterr().out


def test_times_count_since_1904_where_they_would_be_far_in_the_future(
    tmp_path: Path,
) -> None:
    # 2026-11-28, by LabVIEW
    rows = [f"{3_878_755_200 + 5 * k}.25,{20 + k % 3},{k % 2}" for k in range(25)]
    table = table_of(tmp_path, "Timestamp,T,heater", rows)
    times = times_of(table, parse_map(["time=Timestamp"]).sources["time"], None)
    assert times.origin == 1_795_910_400.25
    assert np.diff(times.seconds).tolist() == [5.0] * 24


@pytest.mark.parametrize(
    ("form", "seconds"),
    [
        ("Sat Nov 28 23:50:{:02d} CET 2026", 1_795_906_200.0),
        ("2026-11-28 23:50:{:02d} EST", 1_795_927_800.0),
    ],
)
def test_names_of_time_zones_are_read(
    tmp_path: Path, form: str, seconds: float
) -> None:
    table = table_of(
        tmp_path,
        "when,T,heater",
        [f"{form.format(2 * k)},{20 + k},{k % 2}" for k in range(25)],
    )
    times = times_of(table, parse_map(["time=when"]).sources["time"], None)
    assert times.origin == seconds
    assert np.diff(times.seconds).tolist() == [2.0] * 24


def test_two_numbers_are_guessed_as_times_and_asked_about(tmp_path: Path) -> None:
    table = table_of(
        tmp_path,
        "Time,T,heater",
        [f"10:{k:02d},{20 + k % 3},{k % 2}" for k in range(25)],
    )
    assert guess(table) == {"time": "Time", "output": "T", "input": "heater"}
    with pytest.raises(
        RecordingError, match="hours and minutes, or minutes and seconds"
    ):
        seconds_of(table, "Time")


def test_a_line_of_counts_below_stacked_series_is_left_out(tmp_path: Path) -> None:
    rows = []
    for k in range(30):
        rows.append(f"T;28.11.2026 23:50:{2 * k % 60:02d};{20 + k % 3};1")
        rows.append(f"heater;28.11.2026 23:50:{2 * k % 60:02d};{k % 2};1")
    path = tmp_path / "wincc.csv"
    path.write_text(
        "\n".join(["VarName;TimeString;VarValue;Validity", *rows, "$COUNT$;60;;"]),
        "utf-8",
    )
    table = open_table(path)
    assert guess(table) == {
        "time": "TimeString",
        "output": "VarValue[T]",
        "input": "VarValue[heater]",
    }
    assert table.notes == ("Line 62 is not a row and is left out: '$COUNT$'.",)
