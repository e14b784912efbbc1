"""The balance: exact for its own twin, and it finds out what another twin gets wrong."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.support import faulty_rig as rig
from twinmatch.dynamics import begin, simulate_closed_loop, simulate_driven
from twinmatch.health import Balance, HealthError, HealthSettings
from twinmatch.plants import Peltier
from twinmatch.signals import Sample

RIG = Peltier.model().parameters(**Peltier.typical)


def tick(y: float, u: float) -> Sample:
    return Sample(0, 0, 0.0, float(y), float(u))


def test_nothing_is_left_of_the_twin_itself() -> None:
    pwm = np.random.default_rng(1).uniform(-255, 255, 200)
    run = simulate_driven(RIG, pwm, states=begin(RIG, 37.0))
    balance = Balance(RIG, 1.0)
    for u, (y, after) in zip(pwm, itertools.pairwise(run.output), strict=False):
        movement = balance.step(tick(y, u), float(after))
        assert abs(movement.unexplained) < 1e-9
        assert movement.drive * u >= 0
        assert movement.drive + movement.passive == pytest.approx(after - y, abs=1e-9)


def test_an_error_of_drive_and_losses_is_learned() -> None:
    # A quarter more heat capacity slows everything by the same share: both corrections are 1/1.25 − 1.
    slow = RIG.replace(heat_capacity=1.25 * RIG["heat_capacity"])
    reference = rig.profile(5, 3000)
    run = simulate_closed_loop(slow, reference, states=begin(slow, 23.0))
    balance = Balance(RIG, 1.0)
    early, late = [], []
    for k in range(len(reference) - 1):
        movement = balance.step(tick(run.output[k], run.input[k]), float(run.output[k + 1]))
        full = balance.block()
        if full is not None:
            balance.learn(*full, healthy=True)
        (early if k < 300 else late if k > 2000 else []).append(abs(movement.unexplained))
    values, _ = balance.knowledge
    assert values[0] == pytest.approx(-0.2, abs=0.06)
    assert values[1] == pytest.approx(-0.2, abs=0.06)
    assert np.mean(late) < 0.3 * np.mean(early)


def test_what_was_unhealthy_is_not_learned() -> None:
    balance = Balance(RIG, 1.0)
    for _ in range(40):
        balance.learn(np.array([2.0, -1.0, 1.0, 0.5]), -1.0, healthy=False)
    assert not balance.knowledge[0].any()
    assert balance.roughness == 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"jump": 0.0}, "jump is 0.0; it must be positive"),
        ({"period": float("nan")}, "period is nan; it must be positive"),
        ({"lost": 1.0}, "lost is 1.0 and weak is 0.6; give shares"),
    ],
)
def test_settings_that_tell_nothing_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(HealthError, match=message):
        HealthSettings(**settings)
