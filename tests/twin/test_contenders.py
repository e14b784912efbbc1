"""Structures fitted again and again: found again from samples of rigs that are known."""

from __future__ import annotations

import pytest

from tests.support.rich_rig import RIG, apart, recorded
from tests.support.rig import GAINS
from twinmatch.fitting import Noise
from twinmatch.plants import Peltier
from twinmatch.twin import watched
from twinmatch.twin.contenders import Contenders


def contenders() -> Contenders:
    return Contenders(watched(Peltier)[1:], Noise.of(Peltier), GAINS)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_plant_is_near_the_one_that_was_recorded(seed: int) -> None:
    """Nearer by far than a rig whose plate holds a third more heat."""
    held, other = contenders(), RIG.replace(heat_capacity=40.0)
    held.push(recorded(RIG, seed), excited=True)
    fitted = next(c.fit for c in held.held if c.fit.model is RIG.model)
    found = apart(fitted.parameters, RIG)
    assert found < 0.5 * apart(other, RIG)


def test_all_that_are_watched_compete_and_the_fit_that_is_worth_most_goes_first() -> None:
    held = contenders()
    held.push(recorded(RIG, 2), excited=True)
    assert {c.fit.model for c in held.held} == set(watched(Peltier)[1:])
    charges = [c.fit.charge for c in held.held]
    assert charges == sorted(charges)


def test_a_fit_says_where_its_states_were() -> None:
    window = recorded(RIG, 2)
    held = contenders()
    held.push(window, excited=True)
    best = held.held[0]
    states = best.states_at(window.last)
    assert states is not None
    assert states[0] - 273.15 == pytest.approx(window.output[-1], abs=0.5)  # five times the noise
    assert best.states_at(window.last + 1) is None
    assert best.states_at(-1) is None


def test_too_few_samples_and_quiet_ones_tell_nothing() -> None:
    held, window = contenders(), recorded(RIG, 1)
    assert not held.push(window.part(0, 40), excited=True)
    assert not contenders().push(window, excited=False), "the first fit waits for a step"


def test_a_quiet_plant_is_fitted_again_when_the_fit_is_old() -> None:
    held, window = contenders(), recorded(RIG, 1)
    held.push(window.part(0, 300), excited=True)
    assert not held.push(window.part(301, 600), excited=False)
    assert held.push(window.part(601, 950), excited=False)
    assert held.held[0].last == 950


def test_a_plant_that_has_changed_is_fitted_to_later_samples() -> None:
    held, heavy = contenders(), RIG.replace(heat_capacity=45.0)
    held.push(recorded(RIG, 6), excited=True)
    held.renew(1000)
    held.push(recorded(heavy, 7, first=1000), excited=True)
    fit = next(c.fit for c in held.held if c.fit.model is RIG.model)
    of = held.held[0].candidate.window
    assert of is not None
    assert of.first == 1000
    assert apart(fit.parameters, heavy) < apart(fit.parameters, RIG)


def test_who_was_fitted_to_a_fault_has_to_go() -> None:
    held, window = contenders(), recorded(RIG, 6)
    held.push(window.part(0, 500), excited=True)
    assert not held.expel(600, 700)
    gone = held.expel(450, 520)
    assert set(gone) == {model.structure_name for model in watched(Peltier)[1:]}
    assert not held.held
