"""The plant as it is now, found again from samples of rigs that are known."""

from __future__ import annotations

import pytest

from tests.support.rich_rig import RIG, apart, recorded
from tests.support.rig import GAINS
from twinmatch.fitting import Noise
from twinmatch.plants import Peltier
from twinmatch.twin import watched
from twinmatch.twin.present import Present


def present() -> Present:
    return Present(watched(Peltier), Noise.of(Peltier), GAINS)


def test_it_is_the_richest_structure_that_is_watched() -> None:
    found = present().fitted(recorded(RIG, 1))
    assert found is not None
    assert found.model.structure_name == "sink with mass, free ambient, switched drive"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_plant_is_near_the_one_that_was_recorded(seed: int) -> None:
    """Nearer by far than a rig whose plate holds a third more heat."""
    found = present().fitted(recorded(RIG, seed))
    assert found is not None
    other = RIG.replace(heat_capacity=40.0)
    assert apart(found, RIG) < 0.5 * apart(other, RIG)


def test_it_follows_a_plant_that_changes() -> None:
    """From one window to the next the plate has got heavier; each time the newest samples count."""
    now, heavy = present(), RIG.replace(heat_capacity=40.0)
    first = now.fitted(recorded(RIG, 4))
    second = now.fitted(recorded(heavy, 5))
    assert first is not None
    assert second is not None
    assert apart(first, RIG) < apart(first, heavy)
    assert apart(second, heavy) < apart(second, RIG)


def test_too_few_samples_tell_nothing() -> None:
    now = present()
    assert now.fitted(None) is None
    assert now.fitted(recorded(RIG, 1).part(0, 40)) is None


def test_after_a_fault_it_starts_over() -> None:
    now, window = present(), recorded(RIG, 6)
    first = now.fitted(window)
    again = now.fitted(window)
    now.forget()
    assert now.fitted(window) == first
    assert again is not None
