"""A plant against a recording of it: faults, the loop that ran it, the structure that it supports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.plant_files import plant_file
from tests.support.plants import Exchanger, Lag, Motor
from twinmatch.adding.data import check_data, compare_structures, loop_findings
from twinmatch.dynamics import PidGains, begin, simulate_closed_loop, simulate_driven
from twinmatch.plants import find_plant
from twinmatch.sessions import Session, open_any, samples_of
from twinmatch.sessions.sources import session_of
from twinmatch.signals import Sample, Window
from twinmatch.twin import TwinSettings


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


GAINS = PidGains(0.15, 0.6, 0.0, 20.0, low=-24.0, high=24.0, period=0.05)
SHIPPED = Path(__file__).parents[2] / "bags" / "four_setpoints"


def driven_by(gains: PidGains, *, has_reference: bool = True) -> Session:
    """A motor under steps that drive its input onto its limits."""
    motor = Motor.model().parameters()
    reference = np.repeat([0.0, 150.0, -120.0, 60.0, 200.0], 150)
    run = simulate_closed_loop(motor, reference, states=begin(motor, 0.0), gains=gains)
    y = run.output + 0.2 * np.random.default_rng(3).standard_normal(reference.size)
    u = np.asarray(run.input)
    samples = [
        Sample(index=k, stamp=round(5e7 * k), reference=float(r), output=float(a), input=float(b))
        for k, (r, a, b) in enumerate(zip(reference, y, u, strict=True))
    ]
    return session_of(Path("run.csv"), tuple(samples), plant=Motor.name, has_reference=has_reference)


def test_the_loop_that_ran_the_plant_is_not_a_finding() -> None:
    """Even if the controller saw other readings than the recorded ones, by their noise."""
    assert loop_findings(driven_by(GAINS), Motor, GAINS) == []
    assert loop_findings(driven_by(GAINS), Motor, None) == []


@pytest.mark.parametrize(
    "wrong",
    [{"proportional": 0.3}, {"integral": 0.3}, {"back_calculation": 0.0}, {"high": 12.0}],
    ids=["proportional", "integral", "windup", "limit"],
)
def test_another_loop_is_a_finding(wrong: dict[str, float]) -> None:
    (found,) = loop_findings(driven_by(GAINS), Motor, replace(GAINS, **wrong))
    assert "does not give the recorded input" in found.what
    assert "back_calculation" in found.todo
    assert loop_findings(driven_by(GAINS, has_reference=False), Motor, replace(GAINS, **wrong)) == []


def test_the_rig_was_run_by_the_loop_in_its_file() -> None:
    session = open_any(SHIPPED)
    from twinmatch.plants import Peltier

    assert loop_findings(session, Peltier, Peltier.loop) == []
    assert loop_findings(session, Peltier, replace(Peltier.loop, integral=3.0))


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
