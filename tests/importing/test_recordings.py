"""Recordings of the rig, and whatever else can be opened: one clear message for each thing that is wrong."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st

from tests.support.places import SHIPPED
from twinmatch import importing
from twinmatch.importing import open_any, read_recording
from twinmatch.sessions import SessionError, write_session
from twinmatch.sessions.files import RecordingError
from twinmatch.sessions.recording import EPOCH
from twinmatch.signals import Sample


def matrix(count: int = 20, period: float = 1.0) -> np.ndarray:
    k = np.arange(count)
    return np.column_stack([k - 5.0, 25 + k / 8, k * period, np.full(count, 30.0)])


def save(path: Path, **variables: object) -> Path:
    scipy.io.savemat(path, variables)
    return path


def table(path: Path, text: str) -> Path:
    path.write_text(text, "utf-8")
    return path


CSV = "time,reference,temperature,pwm\n0,30,25.5,-1\n1,30,26,2\n2,31,26.5,3.5\n"


def check_small(window):
    assert window.reference.tolist() == [30, 30, 31]
    assert window.output.tolist() == [25.5, 26, 26.5]
    assert window.input.tolist() == [-1, 2, 3.5]
    assert (window.first, window.period) == (0, 1.0)


def test_the_rig_recordings_are_read_to_the_last_bit(recordings, recorded_hour):
    for number, path in recordings.items():
        window = read_recording(path)
        plain = recorded_hour(number)
        assert window.period == 1.0
        for name in ("reference", "output", "input"):
            assert np.array_equal(getattr(window, name), getattr(plain, name))


@pytest.mark.parametrize("compress", [False, True])
def test_a_mat_file_is_read(tmp_path, compress):
    path = tmp_path / "run.MAT"
    with path.open("wb") as file:
        scipy.io.savemat(
            file, {"simout": matrix(), "tout": np.arange(20.0)}, do_compression=compress
        )
    window = open_any(str(path)).window()
    u, y, _, r = matrix().T
    assert np.array_equal(window.input, u)
    assert np.array_equal(window.output, y)
    assert np.array_equal(window.reference, r)


@pytest.mark.parametrize(
    "text",
    [
        CSV,
        CSV.replace("time,reference,temperature,pwm", "t, Setpoint [degC] ,Y (°C),U"),
        CSV.replace(
            "time,reference,temperature,pwm",
            '"seconds","set_point","temp [C]","COMMAND"',
        ),
        CSV.replace("\n1,", "\n\n ,,,\n1,"),
        CSV.replace("\n1,30,26,2", "\n1,30,26,2,"),
        "pwm,note,temperature,time (s),reference\n-1,a,25.5,5,30\n2,,26,6,30\n3.5,b,26.5,7,31\n",
    ],
)
def test_a_csv_file_may_be_written_in_several_ways(tmp_path, text):
    check_small(read_recording(table(tmp_path / "run.csv", text)))


@given(
    st.sampled_from([0.001, 0.01, 1 / 30, 0.1, 0.25, 1.0, 2.0, 60.0]),
    st.integers(2, 500),
)
def test_the_period_is_the_one_the_loop_was_set_to(tmp_path_factory, period, count):
    path = save(
        tmp_path_factory.getbasetemp() / "period.mat",
        simout=matrix(count, period)[:, :] / [300, 300, 1, 1],
    )
    assert read_recording(path).period == pytest.approx(period, abs=5e-10)


def test_jitter_and_a_clock_a_little_off_do_not_change_the_period(tmp_path):
    rows = matrix(200)
    rows[:, 0] /= 10
    rows[:, 2] = rows[:, 2] * 1.0001 + np.random.default_rng(3).uniform(
        -0.02, 0.02, 200
    )
    assert read_recording(save(tmp_path / "run.mat", simout=rows)).period == 1.0


def changed(row: int, column: int, value: float) -> np.ndarray:
    rows = matrix()
    rows[row, column] = value
    return rows


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (changed(3, 1, np.nan), "output in row 4 is nan; give a finite number"),
        (changed(0, 0, np.inf), "input in row 1 is inf"),
        (changed(19, 3, -np.inf), "reference in row 20 is -inf"),
        (changed(7, 2, np.nan), "time in row 8 is nan"),
        (
            changed(4, 0, 255.5),
            "row 5: input is 255.5 PWM, beyond the limits of its drive, -255 to 255",
        ),
        (changed(4, 0, -1023), "row 5: input is -1023"),
        (matrix() * [60, 1, 1, 1], r"row 1: input is -300 PWM \(and in 10 more\)"),
        (
            changed(2, 1, -273.16),
            "row 3: output is -273.16 °C, beyond the span of its output, -273.15 to inf",
        ),
        (changed(2, 3, -500), "row 3: reference is -500"),
        (changed(5, 2, 5.5), "1.5 s from row 5 to row 6, elsewhere 1 s"),
        (changed(5, 2, 4.0), "time does not advance from 4 s in row 5 to 4 s in row 6"),
        (changed(5, 2, 3.0), "time does not advance from 4 s in row 5 to 3 s in row 6"),
        (
            np.delete(matrix(), [9, 10], axis=0),
            "3 s from row 9 to row 10, elsewhere 1 s",
        ),
        (matrix(1), "has 1 rows; at least two"),
        (matrix(0), "has 0 rows; at least two"),
        (matrix()[:, :3], r"simout has the shape \(20, 3\); it needs 4 columns"),
        (np.zeros((5, 4, 2)), r"simout has the shape \(5, 4, 2\)"),
        (matrix() + 0j, "is not a matrix of real numbers"),
        (scipy.sparse.csc_matrix(matrix()), "is not a matrix of real numbers"),
        ({"time": matrix()}, "is not a matrix of real numbers"),
        ("text", "is not a matrix of real numbers"),
    ],
)
def test_matrices_that_cannot_be_used_are_explained(tmp_path, rows, message):
    path = save(tmp_path / "run.mat", simout=rows)
    with pytest.raises(RecordingError, match=message):
        read_recording(path)


def test_a_mat_file_of_something_else_lists_what_it_has(tmp_path):
    with pytest.raises(RecordingError, match="has no matrix simout; it has a, tout"):
        read_recording(save(tmp_path / "run.mat", a=[1.0], tout=[2.0]))
    with pytest.raises(RecordingError, match="has no matrix simout; it has nothing"):
        read_recording(save(tmp_path / "none.mat"))


@pytest.mark.parametrize("compress", [False, True])
def test_a_truncated_mat_file_is_never_read_as_whole(tmp_path, compress):
    path = tmp_path / "run.mat"
    scipy.io.savemat(
        path, {"simout": matrix(300) / [2, 1, 1, 1]}, do_compression=compress
    )
    content = path.read_bytes()
    for cut in range(0, len(content), 97):
        path.write_bytes(content[:cut])
        with pytest.raises(
            RecordingError,
            match=r"is truncated or damaged|is not a MATLAB file|has no matrix simout",
        ):
            read_recording(path)


@given(st.binary(min_size=1, max_size=60), st.integers(0, 600))
def test_a_damaged_mat_file_gives_our_error_or_numbers(tmp_path_factory, damage, place):
    path = tmp_path_factory.getbasetemp() / "damaged.mat"
    scipy.io.savemat(path, {"simout": matrix()})
    content = bytearray(path.read_bytes())
    content[place : place + len(damage)] = damage
    path.write_bytes(content)
    try:
        window = read_recording(path)
    except RecordingError as error:
        assert path.name in str(error)  # noqa: PT017
    else:
        assert np.isfinite(window.output).all()


OLD = "is not a MATLAB file of version 5"
NEW = b"MATLAB 7.3 MAT-file, Platform: GLNXA64"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        *(
            ("run.mat", c, OLD)
            for c in (b"", b"garbage", bytes(500), b"MATLAB 5", b"\xff" * 900)
        ),
        ("run.mat", NEW + bytes(500), "save it again with the option -v7"),
        (
            "run.csv",
            bytes(range(256)),
            "is not text in a known encoding; save it as UTF-8",
        ),
        (
            "run.txt",
            CSV.encode(),
            r"has the suffix '\.txt'; a recording has \.mat or \.csv",
        ),
        ("run.mat", None, "does not exist"),
        (".", None, "is a folder"),
    ],
)
def test_other_files_are_refused(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=message):
        read_recording(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file has 0 lines of a table"),
        ("\n\n", "the file has 0 lines of a table"),
        (
            "time,pwm\n0,1\n1,1\n",
            r"no column of reference \(.*\) and none of output \(.*\); it has 'time', 'pwm'",
        ),
        (
            CSV.replace("pwm", "power"),
            r"has no column of input \(pwm, u, command\); it has 'time', 'reference', 'temp",
        ),
        (CSV.replace("pwm", "y"), "columns 'temperature' and 'y' are both output"),
        (
            CSV.replace("temperature", "temperature (K)"),
            r"column 'temperature \(K\)': give output in °C",
        ),
        (CSV.replace("time", "time [ms]"), r"column 'time \[ms\]': give time in s"),
        (CSV.replace("pwm", "pwm [%]"), "give input in steps of −255 to 255"),
        (
            CSV.replace("26,2", "x,2"),
            "line 3: 'temperature' is 'x', which is not a number",
        ),
        (
            CSV.replace("\n1,30,26,2", "\n\n1,30,,2"),
            "output in line 4 is nan; give a finite number",
        ),
        (CSV.replace("1,30,26,2", "1,30"), "output in line 3 is nan"),
        (CSV.replace("26,2", "nan,2"), "output in line 3 is nan"),
        (
            CSV.replace("\n1,30", "\n\n1,30").replace(",3.5", ",256"),
            "line 5: input is 256",
        ),
        (CSV.replace("\n2,31", "\n9,31"), "8 s from line 3 to line 4, elsewhere 1 s"),
        (
            "time,reference,temperature,pwm\n",
            "at least two rows; the file has 1 lines of a table",
        ),
        (
            CSV.splitlines()[0] + "\n" + "1" * 200_000 + ",1,1,1\n0,1,1,1\n",
            "cannot be read as a table",
        ),
        (
            CSV.replace(",", ";").replace("26;2", "26;2,5,1"),
            "line 3: 'pwm' is '2,5,1'",
        ),
    ],
)
def test_tables_that_cannot_be_used_are_explained(tmp_path, text, message):
    with pytest.raises(RecordingError, match=message):
        read_recording(table(tmp_path / "run.csv", text))


def test_a_file_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    def refuse(*_args: object, **_more: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    (tmp_path / "run.csv").write_bytes(b"x")
    with pytest.raises(
        RecordingError, match=r"run\.csv: cannot be read \(Permission denied\)"
    ):
        read_recording(tmp_path / "run.csv")


NINE = "time,reference,temperature,pwm\n" + "".join(
    f"{k},{30 + k // 4},25.5,{k}\n" for k in range(9)
)


def test_a_recording_opens_as_the_session_it_is_imported_as(tmp_path):
    (tmp_path / "run.csv").write_text(NINE)
    recording = open_any(tmp_path / "run.csv")
    session = open_any(write_session(tmp_path / "run", recording.samples))
    assert recording.samples == session.samples
    assert list(recording.messages()) == list(session.messages())
    assert recording.topics == session.topics
    for name in (
        "name",
        "topic",
        "counts",
        "start",
        "end",
        "notes",
        "period",
        "duration",
    ):
        assert getattr(recording, name) == getattr(session, name)
    assert recording.samples[8] == Sample(8, EPOCH + 8 * 10**9, 32.0, 25.5, 8.0)


def test_a_session_file_opens_whatever_its_name(tmp_path):
    samples = [Sample(k, k * 10**9, 1.0, 2.0, 3.0) for k in range(4)]
    folder = write_session(tmp_path / "run", samples)
    assert open_any(folder / "run_0.mcap").samples == samples
    (folder / "run_0.mcap").rename(tmp_path / "attachment.bin")
    assert open_any(tmp_path / "attachment.bin").samples == samples
    assert (
        open_any(tmp_path / "attachment.bin", topic="/plant/sample").topic
        == "/plant/sample"
    )
    with pytest.raises(SessionError, match="/b/plant/sample of type"):
        open_any(tmp_path / "attachment.bin", topic="/b/plant/sample")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.mcap", b"", "the file is empty"),
        ("a.mcap", b"garbage", "is not a session"),
        ("a.mat", b"garbage", "is not a MATLAB file"),
        ("a.csv", b"garbage", "give column names and at least two rows"),
        (
            "a.txt",
            b"garbage",
            r"is neither a session \(folder or \.mcap\) nor a recording \(\.mat, \.csv\)$",
        ),
        ("a", b"MATLAB 5.0 MAT-file, x", r"a MATLAB file needs the suffix \.mat"),
    ],
)
def test_what_is_neither_is_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SessionError, match=message):
        open_any(tmp_path / name)


def test_missing_paths_are_named(tmp_path):
    with pytest.raises(SessionError, match=r"nothing\.mat: does not exist"):
        open_any(tmp_path / "nothing.mat")
    (tmp_path / "file.csv").write_text(NINE)
    with pytest.raises(SessionError, match="cannot be read"):
        open_any(tmp_path / "file.csv" / "deeper")
    with pytest.raises(SessionError, match="the folder has no MCAP file"):
        open_any(tmp_path)


OPENED = """
import sys
from twinmatch.importing import open_any
session = open_any(sys.argv[1])
print(len(session.samples), "twinmatch.importing.tables" in sys.modules)
from twinmatch.importing import read_recording, resample
print(read_recording.__name__, resample.__name__, "twinmatch.importing.tables" in sys.modules)
"""


def test_opening_a_session_imports_nothing_that_reads_tables() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", OPENED, str(SHIPPED)],
        capture_output=True,
        text=True,
        check=True,
    )
    opened, asked = completed.stdout.splitlines()
    assert opened.endswith(" False")
    assert asked == "read_recording resample True"


def test_what_importing_does_not_offer_is_missing() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        importing.nothing  # noqa: B018
