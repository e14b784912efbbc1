"""The camera program as a process: what it serves, how it ends, what it says when it cannot continue."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from twinmatch_camera.__main__ import main
from twinmatch_camera.emulation import PLATE, PlateFeed

from tests.support.camera import CameraProgram
from tests.support.places import CAMERA_PATHS
from tests.support.waiting import wait_for
from twinmatch.links.thermal_client import (
    ClientSettings,
    Received,
    ThermalClient,
    region,
)

SETTINGS = ClientSettings(first_wait=0.05, longest_wait=0.2)


def next_news(client: ThermalClient) -> Received:
    before = client.news()

    def another() -> Received | None:
        news = client.news()
        return news if news is not before else None

    news_after = wait_for(another, lambda: str(client.status))
    assert news_after is not None
    return news_after


def test_a_plate_at_one_temperature_reads_that_temperature(
    camera: Callable[..., CameraProgram],
) -> None:
    server = camera("emulated", "--plate", "60", "--seed", "3")
    with ThermalClient("127.0.0.1", server.port, SETTINGS) as client:
        for _ in range(5):
            # Common noise 0.08 °C, gradient 0.02 of 37 °C at most.
            assert region(next_news(client).frame, PLATE).mean == pytest.approx(
                60.0, abs=1.2
            )
        assert client.status.missed == 0
    assert server.process.end() == 0
    assert server.process.lines[-1].endswith("stopped")


def test_a_fed_plate_is_followed_and_silence_is_not_a_frame(
    camera: Callable[..., CameraProgram], tmp_path: Path
) -> None:
    path = tmp_path / "plate.sock"
    server = camera("emulated", "--feed", str(path))
    server.process.said(
        "no plate temperature on .*plate.sock; no frames until one comes"
    )
    with (
        ThermalClient("127.0.0.1", server.port, SETTINGS) as client,
        PlateFeed(path) as feed,
    ):
        assert client.newest() is None
        for plate in (30.0, 80.0):
            assert feed.send(plate)
            for _ in range(2):
                received = next_news(client)
            assert region(received.frame, PLATE).mean == pytest.approx(plate, abs=1.5)
        server.process.said("plate temperature 30.00 °C on .*; frames again")
        wait_for(lambda: "ThermalStallError" in client.status.errors, "the stall")
    assert server.process.end() == 0
    assert not path.exists()


def test_a_killed_server_is_found_again(camera: Callable[..., CameraProgram]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    first = camera("emulated", "--plate", "60", listen=address)
    with ThermalClient("127.0.0.1", first.port, SETTINGS) as client:
        next_news(client)
        before = client.status.connections
        first.process.kill()
        second = camera("emulated", "--plate", "60", listen=address)
        assert second.port == first.port
        while client.status.restarts == 0:
            next_news(client)
        assert client.status.connections == before + 1
        assert client.status.errors["ThermalEndError"] == 1


def test_by_default_it_serves_this_computer_alone(
    camera: Callable[..., CameraProgram],
) -> None:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", 5580))
        except OSError:
            pytest.skip("port 5580 is in use here")
    server = camera("emulated", "--plate", "60", listen=None)
    assert server.process.said(r"serving .* on (.*):5580$")[1] == "127.0.0.1"
    assert server.process.end(signal.SIGINT) == 0  # a clean stop too


def test_a_port_that_is_in_use_is_one_line_and_exit_code_three(
    camera: Callable[..., CameraProgram],
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        address = f"127.0.0.1:{listening.getsockname()[1]}"
        server = camera("emulated", "--plate", "60", listen=address)
        assert server.process.wait() == 3
    (line,) = server.process.lines
    assert line.startswith(f"twinmatch-camera: cannot listen on {address}")


LISTEN = ["127.0.0.1:", ":5580", "127.0.0.1:99999", "127.0.0.1:http"]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        *(
            (
                ["emulated", "--plate", "60", "--listen", listen_option],
                2,
                "give HOST or HOST:PORT",
            )
            for listen_option in LISTEN
        ),
        (["recorded", "/no/such/file"], 4, "recording /no/such/file: No such file"),
        (
            ["emulated", "--feed", "/nowhere/plate.sock"],
            4,
            "give a path in a folder that can be written",
        ),
        (
            ["emulated", "--plate", "40", "--flat-field-period", "1"],
            2,
            "has no room for a warning",
        ),
        (["lepton", "--spi", "one"], 2, "--spi one: give BUS.DEVICE"),
        (["lepton"], 4, "Lepton"),
        (["v4l2", "/dev/no-such-video"], 4, "/dev/no-such-video"),
    ],
)
def test_one_line_says_what_is_wrong(
    arguments: list[str], code: int, message: str, caplog: pytest.LogCaptureFixture
) -> None:
    listen_option = [] if "--listen" in arguments else ["--listen", "127.0.0.1:0"]
    assert main([*arguments, *listen_option]) == code
    (line,) = caplog.messages
    assert message in line
    assert "\n" not in line


@pytest.mark.parametrize(
    "arguments", [[], ["emulated"], ["emulated", "--plate", "4", "--max-clients", "0"]]
)
def test_missing_and_impossible_arguments_are_exit_code_two(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert "error:" in capsys.readouterr().err.splitlines()[-1]


def test_a_recording_made_from_the_stream_plays_back_and_ends(
    camera: Callable[..., CameraProgram], tmp_path: Path
) -> None:
    path = tmp_path / "plate.cborseq"
    server = camera("emulated", "--plate", "60")
    with ThermalClient("127.0.0.1", server.port, SETTINGS) as client:
        next_news(client)  # after the first correction
    with socket.create_connection(("127.0.0.1", server.port)) as connection:
        data = b""
        while len(data) < 30_000:
            data += connection.recv(65_536)
    # three frames and a bit of the fourth, as if it was interrupted
    path.write_bytes(data[:30_000])
    player = camera("recorded", str(path))
    assert player.process.wait() == 0
    assert player.process.said(r"ends after (\d+) frames")[1] == "3"
    player = camera("recorded", str(path), "--loop")
    with ThermalClient("127.0.0.1", player.port, SETTINGS) as client:
        for _ in range(8):
            received = next_news(client)
    assert region(received.frame, PLATE).mean == pytest.approx(60.0, abs=1.2)
    assert client.status.errors == {}


LIGHT = """
import sys

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"numba", "scipy", "control", "mcap", "mcap_ros2", "yaml", "rich", "serial",
                                  "rclpy", "matplotlib"}:
            raise ImportError(name + " is not on the Raspberry Pi")

sys.meta_path.insert(0, Block())
import twinmatch_camera.__main__, twinmatch_camera.program, twinmatch_camera.sources.emulated
import twinmatch_camera.sources.recorded, twinmatch_camera.sources.lepton, twinmatch_camera.sources.v4l2
"""


def test_the_program_needs_nothing_of_twinmatch_but_numpy_and_cbor2() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", LIGHT],
        env={"PYTHONPATH": CAMERA_PATHS},
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
