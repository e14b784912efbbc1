"""Sessions read by `@mcap/core`, the reader behind the usual viewers."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from twinmatch.sessions import read_session, write_session
from twinmatch.sessions.metadata import METADATA
from twinmatch.signals import Sample

VERSION = "2.2.2"
CACHE = Path(__file__).resolve().parents[2] / "build" / f"mcap-core-{VERSION}"
SCRIPT = Path(__file__).with_name("read_with_mcap_core.mjs")


@pytest.fixture(scope="module")
def core() -> Path:
    """The reader's folder, installed once into the ignored build folder."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    module = CACHE / "node_modules" / "@mcap" / "core"
    if not module.is_dir():
        CACHE.mkdir(parents=True, exist_ok=True)
        options = ["--prefix", str(CACHE), "--ignore-scripts", "--no-audit", "--no-fund", "--no-save"]
        done = subprocess.run(
            ["npm", "install", *options, f"@mcap/core@{VERSION}"], capture_output=True, text=True, check=False
        )
        if done.returncode:
            pytest.skip(f"npm could not install @mcap/core: {done.stderr.strip().splitlines()[-1:]}")
    return module


def test_the_web_reader_finds_the_same(tmp_path, core):
    samples = [Sample(k, 10**18 + k * 10**9, 30.0 + k // 500, 25.0 + k / 16, k / 4) for k in range(1000)]
    folder = write_session(tmp_path / "run", samples)
    done = subprocess.run(
        ["node", str(SCRIPT), str(folder / "run_0.mcap"), str(core)],
        capture_output=True,
        text=True,
        check=True,
    )
    theirs = json.loads(done.stdout)
    ours = read_session(folder)
    assert theirs["profile"] == "ros2"
    assert theirs["topics"] == {
        topic.name: {
            "type": topic.type,
            "encoding": "ros2msg",
            "schema": topic.schema,
            "message": "cdr",
            "hash": topic.type_hash,
            "count": ours.counts[topic.name],
        }
        for topic in ours.topics
    }
    assert theirs["messages"] == [[m.topic.name, str(m.log_time), m.data.hex()] for m in ours.messages()]
    text = (folder / METADATA).read_text()
    assert all(line.strip() in text for line in theirs["metadata"]["serialized_metadata"].splitlines())
