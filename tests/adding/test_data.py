"""A plant against a recording of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.plant_files import plant_file
from twinmatch.adding.data import check_data
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.plants import find_plant
from twinmatch.sessions.sources import session_of
from twinmatch.signals import Sample


@pytest.mark.parametrize(
    ("stuck", "found"), [(False, []), (True, ["no window could be matched, because the plant seemed"])]
)
def test_a_fault_that_keeps_every_window_out_is_named(tmp_path: Path, stuck: bool, found: list[str]) -> None:
    """The input moves enough, so it is not the reason."""
    plant = find_plant(str(plant_file(tmp_path, f"block_stuck_{stuck}".lower())))
    truth = plant.model().parameters(gain=0.6)
    u = np.repeat([0.0, 50.0, 10.0, 80.0, 20.0, 60.0], 70)
    y = simulate_driven(truth, u, states=begin(truth, 20.0)).output
    y = y + plant.output.noise * np.random.default_rng(1).standard_normal(u.size)
    if stuck:
        y[65:120] = y[65]
    samples = [
        Sample(k, k * 1_000_000_000, 0.0, float(a), float(b), (20.0,))
        for k, (a, b) in enumerate(zip(y, u, strict=True))
    ]
    session = session_of(Path("block.csv"), samples, plant=plant.name, has_reference=False)
    checked = check_data(session, plant)
    assert [f.what[: len(w)] for f, w in zip(checked.findings, found, strict=True)] == found
