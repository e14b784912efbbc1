"""A DC motor, judged by everything that judges the Peltier rig, from a file of its own and nothing else."""

from __future__ import annotations

import ast
import inspect
import textwrap

import numpy as np
import pytest

from tests.support.plants import Motor
from twinmatch.comparing import TrustLevel
from twinmatch.dynamics import Sensor, begin, linearised, simulate_closed_loop
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin, TwinSettings

TRUTH = Motor.model("without friction").parameters(k=0.06, j=5e-4, b=2e-4)


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    """A minute of a motor that is asked for six speeds in turn."""
    reference = np.repeat([50.0, 150.0, 90.0, -60.0, 120.0, 30.0], 240)
    sensor = Sensor(noise=0.2).realise(reference.size, 0.05, 3)
    run = simulate_closed_loop(
        TRUTH, reference, states=begin(TRUTH, 0.0), law=Motor.loop, sensor=sensor
    )
    twin = Twin(TwinSettings.of(Motor, period=0.05))
    return [
        twin.push(Sample(k, k * 50_000_000, float(r), float(y), float(u)))
        for k, (r, y, u) in enumerate(
            zip(reference, run.output, run.input, strict=True)
        )
    ]


def test_a_plant_is_a_short_file() -> None:
    """As many statements and expressions as fit on a screen, however their lines are broken."""
    written = ast.parse(textwrap.dedent(inspect.getsource(Motor)))
    calls = [node for node in ast.walk(written) if isinstance(node, ast.Call)]
    statements = [node for node in ast.walk(written) if isinstance(node, ast.stmt)]
    assert len(statements) < 30
    assert len(calls) < 30


def test_its_parameters_are_found(outcomes: list[Outcome]) -> None:
    matches = [o.match.match for o in outcomes if o.match is not None]
    assert len(matches) >= 4
    assert all(m.accepted for m in matches)
    for accepted_match in matches:
        for i, name in enumerate(accepted_match.free):
            # Four standard errors: with three parameters in five matches one in 4000 suites would fail.
            assert (
                abs(accepted_match.parameters[name] - TRUTH[name])
                < 4 * accepted_match.standard_errors[i]
            ), name


def test_its_family_is_judged(outcomes: list[Outcome]) -> None:
    verdicts = [v for o in outcomes for v in o.verdicts]
    last = verdicts[-1]
    assert last.level is TrustLevel.TRUSTED
    assert len(last.modelled) >= 4
    assert last.nominal in {c.name for c in last.candidates}
    assert all(c.name.endswith(" rad/s") for c in last.modelled)
    assert all(v.fault == "" for v in verdicts)
    matrix = np.array(last.nu_gap)
    assert np.all((matrix >= 0) & (matrix <= 1))
    assert all(c.margin > 0 for c in last.candidates)


def test_its_linearised_plant_is_the_textbook_one() -> None:
    """ω' = (k·(u − k·ω)/r − b·ω)/j: one pole, and a gain of k/(k² + r·b)."""
    plant = linearised(TRUTH, 100.0, 0.05)
    k, r, j, b = (TRUTH[name] for name in ("k", "r", "j", "b"))
    assert plant.A[0, 0] == pytest.approx(np.exp(-(k * k / r + b) / j * 0.05), rel=1e-6)
    assert plant.B[0, 0] / (1 - plant.A[0, 0]) == pytest.approx(
        k / (k * k + r * b), rel=1e-6
    )
