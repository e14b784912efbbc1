"""The emulated camera that another program leads through its standard input."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from typing import BinaryIO

import pytest
from twinmatch_camera.sources.base import EndOfRecording
from twinmatch_camera.sources.followed import FollowedSource

from tests.support.places import CAMERA_PATHS
from twinmatch.emulation.lepton import PLATE
from twinmatch.links.thermal_client import ThermalClient, region

START = 100.0


@pytest.fixture
def pipe() -> Iterator[tuple[int, BinaryIO]]:
    read, write = os.pipe()
    with os.fdopen(write, "wb", buffering=0) as leader:
        yield read, leader
    os.close(read)


def test_each_line_makes_an_image_and_a_repeated_one_repeats_it(pipe: tuple[int, BinaryIO]) -> None:
    source, leader = FollowedSource(pipe[0]), pipe[1]
    source.open()
    assert source.read(0.01) is None
    exposures = []
    for tick in (*range(20), 19, 19, 20):
        leader.write(b"%.9f 41.5 %d\n" % (START + tick / 9, 7 * tick))
        exposures.append(source.read(5.0))
        assert exposures[-1] is not None
    shown = [e for e in exposures if e is not None]
    # A camera begins with its flat-field correction, 0.9 s: nine ticks of a ninth.
    assert [e.frozen for e in shown[:12]] == [True] * 9 + [False] * 3
    assert [e.frame_counter for e in shown[9:]] == [*range(1, 12), 11, 11, 12]
    assert [e.stamp for e in shown[-2:]] == [7 * 19, 7 * 20]
    assert region(shown[-1], PLATE).mean == pytest.approx(41.5, abs=0.5)


def test_of_several_lines_the_newest_counts(pipe: tuple[int, BinaryIO]) -> None:
    source, leader = FollowedSource(pipe[0]), pipe[1]
    leader.write(b"0 20 0\n1 30 0\n2 4")
    assert source.read(5.0) is not None
    leader.write(b"0 0\n")
    seen = source.read(5.0)
    assert seen is not None
    assert seen.flat_field_age == 1000  # the first line that counted had the time 1


@pytest.mark.parametrize(
    "line",
    [
        b"warm\n",
        b"1 20\n",
        b"1 2 3 4\n",
        b"1 nan 0\n",
        b"nan 20 0\n",
        b"inf 20 0\n",
        b"1 20 -1\n",
        b"1 20 1.5\n",
    ],
)
def test_an_invalid_line_is_left_out(
    pipe: tuple[int, BinaryIO], line: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    source, leader = FollowedSource(pipe[0]), pipe[1]
    leader.write(line)
    assert source.read(5.0) is None
    assert "write the time in s, the temperature in" in caplog.text
    leader.write(b"0 20 0\n")
    assert source.read(5.0) is not None


def test_time_cannot_go_back(pipe: tuple[int, BinaryIO], caplog: pytest.LogCaptureFixture) -> None:
    source, leader = FollowedSource(pipe[0]), pipe[1]
    for line in (b"5 20 0\n", b"6 20 0\n"):
        leader.write(line)
        assert source.read(5.0) is not None
    leader.write(b"5 20 0\n")
    assert source.read(5.0) is None
    assert "is before that of the last image" in caplog.text


def test_the_end_of_the_input_is_the_end_of_the_recording(pipe: tuple[int, BinaryIO]) -> None:
    pipe[1].close()
    with pytest.raises(EndOfRecording, match="the program that led the camera has ended"):
        FollowedSource(pipe[0]).read(5.0)


def test_the_end_of_the_leader_is_the_end_of_the_camera() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "twinmatch_camera", "emulated", "--feed", "-", "--listen", "127.0.0.1:0"],
        env={**os.environ, "PYTHONPATH": CAMERA_PATHS},
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
    )
    assert process.stdin is not None
    assert process.stderr is not None
    with process, process.stdin, process.stderr:
        port = int(process.stderr.readline().rsplit(b":", 1)[1])
        with ThermalClient("127.0.0.1", port) as client:
            assert b"connected" in process.stderr.readline()
            for tick in range(12):
                process.stdin.write(b"%.9f 30 %d\n" % (tick / 9, tick))
                assert client.wait(after=tick, timeout=360.0) is not None
            process.stdin.close()
            assert process.wait(60) == 0
