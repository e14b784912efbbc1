"""The firmware's codec and ours, compiled and run on the same bytes."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support import pwm_mutations
from twinmatch.links.pwm_protocol import Damage, FrameReader, parse_request, seal

HERE = Path(__file__).parent
SKETCH = HERE.parents[1] / "firmware" / "twinmatch_leonardo"


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler on this machine")
    program = tmp_path_factory.mktemp("codec") / "probe"
    sources = [HERE / "codec_probe.cpp", SKETCH / "frame.cpp", SKETCH / "request.cpp"]
    flags = ["-std=c++11", "-O1", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined"]
    subprocess.run([compiler, *flags, f"-I{SKETCH}", *map(str, sources), "-o", str(program)], check=True)
    return program


def what_we_make_of(stream: bytes) -> list[str]:
    events = FrameReader().feed(stream)
    return [f"E - {e.value}" if isinstance(e, Damage) else str(parse_request(e)) for e in events]


def test_both_make_the_same_of_a_hundred_thousand_damaged_frames(probe: Path) -> None:
    stream = b"".join(line + b"\n" + seal("Q 9") for _, line in pwm_mutations.damaged_lines(100_000, seed=7))
    # Sealed nonsense reaches the parser behind a right check sum.
    nonsense = [
        "P 1 -0",
        "P 1 256",
        "P 1 99999",
        "P 1 100000",
        "Q 65536",
        "Q 01",
        "X 1",
        "  1",
        "P 1 5 ",
        "H",
    ]
    stream += b"".join(map(seal, nonsense))
    said = (
        subprocess.run([str(probe)], input=stream, capture_output=True, check=True)
        .stdout.decode()
        .split("\n")
    )
    ours = what_we_make_of(stream)
    assert said[: len(ours)] == ours
    assert said[len(ours)] == seal("S 65535 4294967295 -255 1023 255").decode().strip()
    assert said[len(ours) + 1] == "29B1"
