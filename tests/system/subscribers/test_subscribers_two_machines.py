"""A reader on another machine receives nothing, unless the network was opened."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.waiting import PATIENCE

pytestmark = pytest.mark.ros

HERE = Path(__file__).resolve().parent
UNSHARE = ("unshare", "--map-root-user", "--net", "--mount")


@pytest.fixture(scope="module", autouse=True)
def namespaces() -> None:
    """Needs `ip`, and a kernel that gives us network namespaces."""
    if shutil.which("ip") is None or shutil.which("unshare") is None:
        pytest.skip("no ip or no unshare here: apt-get install iproute2 util-linux")
    probe = (
        "mount -t tmpfs tmpfs /dev/shm && ip link add here type veth peer name there"
    )
    completed = subprocess.run(
        [*UNSHARE, "sh", "-c", probe], capture_output=True, text=True, check=False
    )
    if completed.returncode != 0:
        pytest.skip(f"no network namespaces here: {completed.stderr.strip()}")


@pytest.mark.parametrize(("network", "seconds"), [("loopback", 5), ("open", 60)])
def test_a_reader_on_another_machine_receives_samples_only_of_an_open_network(
    network: str, seconds: int, stranger: dict[str, str], session: Path, tmp_path: Path
) -> None:
    """An open network takes a second or two; five are what a closed one is watched for."""
    output = tmp_path / "heard.txt"
    script = ["sh", str(HERE / "two_machines.sh"), sys.executable, str(session)]
    completed = subprocess.run(
        [*UNSHARE, *script, str(HERE / "reader.py"), str(output), str(seconds)],
        env={**stranger, "TWINMATCH_NETWORK": network},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
    )
    heard = output.read_text()
    assert completed.returncode == 0, completed.stdout + completed.stderr + heard
    assert heard.startswith("ready"), heard
    assert heard.endswith("imported []\n"), heard
    assert ("NETWORK OPEN" in completed.stderr) == (network == "open")
    assert ('"output"' in heard) == (network == "open"), heard[:300]
