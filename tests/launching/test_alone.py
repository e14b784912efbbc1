"""A run in one process: what is begun is ended, also if the run cannot begin."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.server.base import ModbusBaseServer
from pymodbus.simulator import SimDevice

from tests.links.test_modbus_source import PLACES, RunningDevice, ServedOven, free_port
from tests.support.oven import PERIOD, oven_file
from tests.support.processes import run_twinmatch


@pytest.fixture
def device() -> Iterator[str]:
    """URL of an oven behind Modbus."""
    port = free_port()

    def make(simulated: SimDevice, trace: object) -> ModbusBaseServer:
        return ModbusTcpServer(simulated, address=("127.0.0.1", port), trace_pdu=trace)

    running = RunningDevice(make, ServedOven().device(), f"modbus://127.0.0.1:{port}/1")
    yield running.url
    running.end()


def test_a_page_that_cannot_be_served_leaves_no_thread_of_the_source(
    device: str, tmp_path: Path
) -> None:
    before = set(threading.enumerate())
    with socket.create_server(("127.0.0.1", 0)) as listening:
        words = [
            "attach",
            "--alone",
            "--no-record",
            "--source",
            device,
            "--plant",
            oven_file(tmp_path),
        ]
        words += [
            "--period",
            f"{PERIOD}",
            "--dashboard",
            listening.getsockname()[1],
            "--map",
            *PLACES,
        ]
        completed = run_twinmatch(*words, folder=tmp_path)
    assert completed.returncode == 2
    assert "Traceback" not in completed.stderr
    assert not [
        thread.name
        for thread in set(threading.enumerate()) - before
        if thread.is_alive()
    ]
