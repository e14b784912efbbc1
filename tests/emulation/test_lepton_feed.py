"""The socket between a simulated plate and an emulated camera."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from twinmatch.emulation.lepton import LeptonError, PlateFeed, PlateReceiver


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "plate.sock"


def test_the_newest_temperature_arrives_to_the_last_bit(path: Path) -> None:
    receiver = PlateReceiver(path)
    with PlateFeed(path) as feed:
        assert receiver.newest() is None
        assert feed.send(20.0)
        assert feed.send(1 / 3)
        assert receiver.newest() == 1 / 3
        assert receiver.newest() is None
    receiver.close()
    assert not path.exists()


def test_the_sender_does_not_mind_a_camera_that_comes_and_goes(path: Path) -> None:
    with PlateFeed(path) as feed:
        assert not feed.send(20.0)
        receiver = PlateReceiver(path)
        assert feed.send(21.0)
        receiver.close()
        assert not feed.send(22.0)
        receiver = PlateReceiver(path)
        assert feed.send(23.0)
        assert receiver.newest() == 23.0
        receiver.close()


def test_a_camera_that_does_not_read_is_not_waited_for(path: Path) -> None:
    receiver = PlateReceiver(path)
    with PlateFeed(path) as feed:
        assert not all(feed.send(20.0) for _ in range(10_000))
    receiver.close()


def test_the_socket_of_a_killed_camera_is_replaced(path: Path) -> None:
    left = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    left.bind(str(path))
    left.close()
    PlateReceiver(path).close()


def test_a_file_is_not_replaced(path: Path) -> None:
    path.write_text("mine")
    with pytest.raises(LeptonError, match="give a path in a folder that can be written"):
        PlateReceiver(path)
    assert path.read_text() == "mine"


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(LeptonError, match=r"plate feed at .*plate\.sock"):
        PlateReceiver(tmp_path / "nowhere" / "plate.sock")


@pytest.mark.parametrize("sent", [b"warm", b"", b"nan", b"1e9"])
def test_what_is_not_a_temperature(path: Path, sent: bytes) -> None:
    receiver = PlateReceiver(path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        sender.sendto(sent, str(path))
    with pytest.raises(LeptonError, match=r"is not a temperature|must be between"):
        receiver.newest()
    receiver.close()


def test_the_sender_refuses_nonsense(path: Path) -> None:
    with PlateFeed(path) as feed, pytest.raises(LeptonError, match=r"500\.0 °C; it must be between"):
        feed.send(500.0)
