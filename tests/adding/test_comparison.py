"""Which structure `check-plant` recommends for a recording."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.plants import Exchanger, Lag
from twinmatch.adding.data import compare_structures
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, Window
from twinmatch.twin import TwinSettings

DRIVEN = TwinSettings.of(Exchanger, "without", gains=None)


def recorded(structure: str) -> list[Sample]:
    """Ten minutes of steps, with the noise that the plant file declares."""
    p = Exchanger.model(structure).parameters()
    random = np.random.default_rng(5)
    u = np.repeat(random.uniform(5.0, 80.0, 12), 50)
    run = simulate_driven(p, u, states=begin(p, 20.0 + u[0], input=float(u[0])))
    y = run.output + random.normal(0.0, 0.1, u.size)
    window = Window(np.zeros(u.size), y, u, period=1.0, disturbances=np.full((u.size, 1), 20.0))
    return list(samples_of(window))


def driven_lag() -> list[Sample]:
    """A minute of the lag without noise."""
    u = np.repeat([1.0, -2.0, 3.0], 40)
    p = Lag.model().parameters()
    run = simulate_driven(p, u, states=begin(p, 0.0))
    return list(samples_of(Window(np.zeros(u.size), run.output, u, period=1.0)))


def test_the_structure_that_made_the_data_is_recommended() -> None:
    findings, notes, _ = compare_structures(recorded("with pipe"), Exchanger, DRIVEN)
    assert [finding.what for finding in findings] == [
        "the recording supports the structure 'with pipe' rather than 'without'"
    ]
    assert "first" in findings[0].todo
    lines = {note.split(":")[0].strip(): note for note in notes}
    # The delay of 5 s is found to about its standard error of 0.02 s.
    assert float(lines["with pipe"].split("delay = ")[1]) == pytest.approx(5.0, abs=0.06)
    # White noise of the declared size is left, within 3 standard errors of an estimate from 600 samples.
    left = float(lines["with pipe"].split("(")[1].split(" ")[0])
    assert abs(left - 1.0) < 0.09


def test_the_simpler_one_is_kept_if_it_suffices() -> None:
    findings, notes, _ = compare_structures(recorded("without"), Exchanger, DRIVEN)
    assert findings == []
    assert "choose: without" in notes[-1]
    assert notes[0] == "each structure fitted to all 600 samples:"


def test_there_is_nothing_to_compare_with_one_structure_or_few_samples() -> None:
    assert compare_structures(recorded("without")[:50], Exchanger, DRIVEN).notes == []
    one = compare_structures(driven_lag(), Lag, TwinSettings.of(Lag))
    assert one.findings == []
    assert len(one.notes) == 2
    assert one.least < 1e-6
