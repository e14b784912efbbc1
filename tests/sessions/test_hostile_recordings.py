"""Files that somebody made to do harm: each is refused in one line, soon, and without filling the memory."""

from __future__ import annotations

import os
import socket
import struct
import zlib
from functools import lru_cache
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import scipy.io
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk

from tests.support.limits import within
from twinmatch.cli import main
from twinmatch.importing import open_any, read_recording
from twinmatch.importing.tables import read_table
from twinmatch.sessions import SessionError
from twinmatch.sessions.files import MAX_LINE, RecordingError
from twinmatch.sessions.scan import MAGIC, Scan

CSV = "time,reference,temperature,pwm\n0,30,25.5,-1\n1,30,26,2\n"
COLUMNS = np.array([[1.0, 2.0], [25.0, 26.0], [0.0, 1.0], [30.0, 30.0]])


def fifo(path: Path) -> Path:
    os.mkfifo(path)
    return path


def in_the_way(path: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
    return path


def device(path: Path) -> Path:
    path.symlink_to("/dev/zero")
    return path


@pytest.mark.parametrize("ending", [".mat", ".csv", ".mcap", ".bin"])
@pytest.mark.parametrize("make", [fifo, in_the_way, device])
def test_what_never_ends_is_not_waited_for(tmp_path, monkeypatch, make, ending):
    monkeypatch.chdir(tmp_path)  # the name of a socket has to be short
    path = make(Path(f"run{ending}"))
    with (
        within(10, 20),
        pytest.raises(
            SessionError, match="is a pipe, a device or a socket; give a file"
        ),
    ):
        open_any(path)


@pytest.mark.parametrize(
    "command",
    ["import", "replay", "verify", "repair", "report", "forecast", "backtest"],
)
@pytest.mark.parametrize(
    "name", ["x" * 300 + ".csv", "pipe.csv", "round.csv", "run.csv/deeper.csv"]
)
def test_a_name_that_cannot_be_used_is_one_line(tmp_path, capsys, command, name):
    fifo(tmp_path / "pipe.csv")
    (tmp_path / "round.csv").symlink_to(tmp_path / "round.csv")
    (tmp_path / "run.csv").write_text(CSV)
    assert (
        main(["import", str(tmp_path / "run.csv"), "-o", str(tmp_path / ("x" * 300))])
        == 2
    )
    assert capsys.readouterr().err.count("\n") == 1
    options = {"forecast": ["--at", "5"]}.get(command, [])
    options += ["-o", str(tmp_path / "out")] if command in {"import", "report"} else []
    with within(30, 200):
        assert main([command, str(tmp_path / name), *options]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("twinmatch: ")
    assert printed.count("\n") == 1


def mat_file(path: Path, *elements: bytes) -> Path:
    header = b"MATLAB 5.0 MAT-file, made by hand".ljust(124) + b"\x00\x01IM"
    path.write_bytes(header + b"".join(elements))
    return path


def beginning(
    rows: int, columns: int, name: bytes = b"simout", order: str = "<"
) -> bytes:
    """Flags of a matrix of doubles, its dimensions and its name, as the format has them."""
    flags = struct.pack(f"{order}IIII", 6, 8, 6, 0)
    dimensions = struct.pack(f"{order}IIii", 5, 8, rows, columns)
    padded = name.ljust(-(-len(name) // 8) * 8, b"\0")
    return flags + dimensions + struct.pack(f"{order}II", 1, len(name)) + padded


def matrix(
    rows: int, columns: int, values: bytes, stated: int | None = None, order: str = "<"
) -> bytes:
    data = (
        struct.pack(f"{order}II", 9, len(values) if stated is None else stated) + values
    )
    content = beginning(rows, columns, order=order) + data
    return struct.pack(f"{order}II", 14, len(content)) + content


def compressed(element: bytes) -> bytes:
    packed = zlib.compress(element, 9)
    return struct.pack("<II", 15, len(packed)) + packed


def test_a_file_made_by_hand_is_read(tmp_path):
    """So that the files below are refused for what is wrong with them."""
    for element in (
        matrix(2, 4, COLUMNS.tobytes()),
        compressed(matrix(2, 4, COLUMNS.tobytes())),
    ):
        assert read_recording(
            mat_file(tmp_path / "run.mat", element)
        ).output.tolist() == [25.0, 26.0]


@pytest.mark.parametrize("pack", [bytes, compressed])
@pytest.mark.parametrize(
    ("rows", "columns", "message"),
    [
        (-2, 4, r"has the shape \(-2, 4\); it needs 4 columns"),
        (2, -4, r"has the shape \(2, -4\); it needs 4 columns"),
        (-2, -4, r"has the shape \(-2, -4\); it needs 4 columns"),
        (-(2**31), 4, "has the shape"),
        (
            2**31 - 1,
            4,
            "simout with 8589934588 values; split it into parts of at most 40000000",
        ),
        (1, 4, "is truncated or damaged"),
        (3, 4, "is truncated or damaged"),
    ],
)
def test_dimensions_that_are_not_true_are_refused(
    tmp_path, pack, rows, columns, message
):
    values = bytes(100_000) if rows == 1 else bytes(64)
    path = mat_file(tmp_path / "run.mat", pack(matrix(rows, columns, values)))
    with within(10, 20), pytest.raises(RecordingError, match=message):
        read_recording(path)


@lru_cache
def bomb(name: bytes, rows: int = 100) -> bytes:
    """A variable of some kilobytes that unpacks to 67 MB."""
    head = (
        struct.pack("<II", 14, 2**26)
        + beginning(rows, 4, name)
        + struct.pack("<II", 9, 2**26)
    )
    packed = zlib.compress(head + bytes(2**26), 1)
    assert len(packed) < 5e5
    return struct.pack("<II", 15, len(packed)) + packed


@pytest.mark.parametrize("read", [read_recording, read_table])
@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (100, "does not end where its dimensions say"),
        (2**25, r"values; split it into parts of at most"),
    ],
)
def test_a_small_file_that_unpacks_to_much_is_refused(tmp_path, read, rows, message):
    """By both readers: the importer of any table, and that of the rig's recordings."""
    path = mat_file(tmp_path / "run.mat", bomb(b"simout", rows))
    with within(10, 20), pytest.raises(RecordingError, match=message):
        read(path)


def test_what_stands_beside_the_wanted_matrix_is_not_unpacked(tmp_path):
    path = mat_file(
        tmp_path / "run.mat",
        bomb(b"other"),
        compressed(matrix(2, 4, COLUMNS.tobytes())),
    )
    with within(10, 20):
        assert read_recording(path).output.tolist() == [25.0, 26.0]


PACK = {"": bytes, "zstd": zstandard.compress, "lz4": lz4.frame.compress}


def scan_of_zeros(path, compression, size, stated):
    """What is read of a file with a chunk of so many zeros that states another size."""
    packed = PACK[compression](bytes(size))
    record = RecordBuilder()
    Chunk(
        compression=compression,
        data=packed,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=0,
        uncompressed_size=stated,
    ).write(record)
    path.write_bytes(MAGIC + record.end())
    scan = Scan(path)
    with within(10, 30):
        assert list(scan) == []
    return scan


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("stated", [1000, 2**20, 2**40])
def test_a_chunk_that_unpacks_to_much_is_refused(tmp_path, compression, stated):
    scan = scan_of_zeros(tmp_path / "run.mcap", compression, 2**26, stated)
    assert scan.fault.startswith(
        ("the file is damaged: the checksum", "the file is damaged: a chunk of")
    )


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("surplus", [-1, 1])
def test_a_chunk_that_is_longer_or_shorter_than_it_states_is_damaged(
    tmp_path, compression, surplus
):
    scan = scan_of_zeros(tmp_path / "run.mcap", compression, 1000, 1000 + surplus)
    assert scan.fault.startswith(
        "the file is damaged: the checksum of a chunk is wrong"
    )


def test_many_variables_end_soon(tmp_path):
    empty = struct.pack("<II", 14, 48) + beginning(0, 0, b"other")
    with (
        within(10, 50),
        pytest.raises(RecordingError, match="more than 10000 variables"),
    ):
        read_recording(mat_file(tmp_path / "run.mat", *[empty] * 20_000))


def test_a_file_of_a_machine_of_the_other_byte_order_is_read(tmp_path):
    path = mat_file(
        tmp_path / "run.mat", matrix(2, 4, COLUMNS.astype(">f8").tobytes(), order=">")
    )
    content = path.read_bytes()
    path.write_bytes(content[:124] + b"\x01\x00MI" + content[128:])
    assert scipy.io.loadmat(path)["simout"].shape == (2, 4)
    assert read_recording(path).output.tolist() == [25.0, 26.0]


def test_a_table_without_line_ends_is_not_read_whole(tmp_path):
    path = tmp_path / "run.csv"
    with path.open("wb") as file:
        file.write(CSV.encode())
        file.truncate(2**28)  # zeros that take no room on the disk
    with (
        within(10, 20),
        pytest.raises(
            RecordingError, match=f"line 4 has more than {MAX_LINE} characters"
        ),
    ):
        read_recording(path)


def test_a_long_table_says_how_far_it_has_come_and_takes_little_memory(tmp_path):
    path = tmp_path / "run.csv"
    rows = 30_000
    path.write_text(
        "time,reference,temperature,pwm\n"
        + "".join(f"{k},30,25,1\n" for k in range(rows))
    )
    heard: list[tuple[int, int]] = []
    with within(60, 8 * 9 * rows / 1e6 + 3):
        # line numbers, four columns, and four more in the window
        window = read_recording(path, lambda done, total: heard.append((done, total)))
    assert len(window) == rows
    assert len(heard) == rows // 10_000
    assert heard == sorted(heard)
    assert {total for _, total in heard} == {path.stat().st_size}
