"""Whether the loop that a plant file declares is the one that ran the plant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.plants import Motor
from twinmatch.adding.data import loop_findings
from twinmatch.dynamics import PidGains, begin, simulate_closed_loop
from twinmatch.sessions import Session, open_any
from twinmatch.sessions.sources import session_of
from twinmatch.signals import Sample

GAINS = PidGains(0.15, 0.6, 0.0, 20.0, low=-24.0, high=24.0, period=0.05)
SHIPPED = Path(__file__).parents[2] / "bags" / "four_setpoints"


def recorded(gains: PidGains, *, has_reference: bool = True) -> Session:
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
    assert loop_findings(recorded(GAINS), Motor, GAINS) == []
    assert loop_findings(recorded(GAINS), Motor, None) == []


@pytest.mark.parametrize(
    "wrong",
    [{"proportional": 0.3}, {"integral": 0.3}, {"back_calculation": 0.0}, {"high": 12.0}],
    ids=["proportional", "integral", "windup", "limit"],
)
def test_another_loop_is_a_finding(wrong: dict[str, float]) -> None:
    (found,) = loop_findings(recorded(GAINS), Motor, replace(GAINS, **wrong))
    assert "does not give the recorded input" in found.what
    assert "back_calculation" in found.todo
    assert loop_findings(recorded(GAINS, has_reference=False), Motor, replace(GAINS, **wrong)) == []


def test_the_rig_was_run_by_the_loop_in_its_file() -> None:
    session = open_any(SHIPPED)
    from twinmatch.plants import Peltier

    assert loop_findings(session, Peltier, Peltier.loop) == []
    assert loop_findings(session, Peltier, replace(Peltier.loop, integral=3.0))
