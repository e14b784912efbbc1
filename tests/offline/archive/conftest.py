"""Short sessions to make archives of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.offline.archive.replayed import Replayed
from tests.support.processes import run_twinmatch
from tests.support.rig import rig, run
from twinmatch.sessions import samples_of, write_session
from twinmatch.signals import Window

CAMERA = 0.1  # °C, noise of the temperature


def _make(folder: Path, *, seed: int, seebeck: float) -> Path:
    """Five minutes with two steps, so that one match is made."""
    reference = np.repeat([30.0, 50.0, 65.0], [40, 130, 130])
    window = run(rig(seebeck=seebeck, conductance=0.5, heat_capacity=27.0), reference)
    noise = np.random.default_rng(seed).normal(scale=CAMERA, size=reference.size)
    return write_session(
        folder, samples_of(Window(reference, window.output + noise, window.input))
    )


@pytest.fixture(scope="session")
def make_session() -> Callable[..., Path]:
    """Write a session: `make_session(folder, seed=1, seebeck=0.06)`."""
    return _make


@pytest.fixture(scope="session")
def archive_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two good sessions (one deeper than the other), a bad one, and other files."""
    folder = tmp_path_factory.mktemp("archive")
    _make(folder / "first", seed=1, seebeck=0.06)
    _make(folder / "deeper" / "second", seed=2, seebeck=0.055)
    (folder / "bad.csv").write_text("time,reference\n0,30\n")
    (folder / "notes.txt").write_text("no session\n")
    (folder / ".hidden.csv").write_text("nobody means this\n")
    return folder


@pytest.fixture(scope="session")
def replayed(
    archive_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Replayed:
    folder = tmp_path_factory.mktemp("replayed")
    out = folder / "results"
    table = folder / "all.json"
    done = run_twinmatch(
        "replay", archive_folder, "--jobs", 2, "--out", out, "--json", table
    )
    return Replayed(done, out, table.read_text())
