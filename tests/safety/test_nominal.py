"""What a controller can say of a law by itself."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.support.rig import GAINS
from twinmatch.controllers import WholeLoop, as_linear
from twinmatch.dynamics import law_of, linearised
from twinmatch.plants import Peltier, TCLabBoth
from twinmatch.safety import nominal_eigenvalue


def test_it_is_that_of_the_whole_loop_at_the_set_point() -> None:
    typical = Peltier.model().typical()
    whole = WholeLoop(linearised(typical, 40.0, 1.0), as_linear(GAINS))
    assert nominal_eigenvalue(typical, GAINS, [40.0]) == whole.eigenvalue < 1.0


@pytest.mark.parametrize("factor", [-1.0, 1000.0])
def test_the_wrong_sign_and_far_too_much_are_unstable(factor: float) -> None:
    gains = {
        name: factor * getattr(GAINS, name)
        for name in ("proportional", "integral", "derivative")
    }
    assert (
        nominal_eigenvalue(Peltier.model().typical(), replace(GAINS, **gains), [40.0])
        > 1.0
    )


def test_where_nothing_holds_the_plant_it_rests_in_the_middle_of_its_set_points() -> (
    None
):
    typical = Peltier.model().typical()
    low, high = next(iter(Peltier.outputs.values())).set_points
    middle = nominal_eigenvalue(typical, GAINS, [(low + high) / 2])
    assert (
        nominal_eigenvalue(typical, GAINS, [1e4])
        == nominal_eigenvalue(typical, GAINS, [])
        == middle
    )


def test_several_loops_have_one_nominal_eigenvalue_and_are_stable() -> None:
    law = law_of(TCLabBoth, 1.0)
    assert (
        0.9 < nominal_eigenvalue(TCLabBoth.model().typical(), law, [40.0, 40.0]) < 1.0
    )


def test_gains_beyond_all_measure_are_infinitely_unstable() -> None:
    assert (
        nominal_eigenvalue(
            Peltier.model().typical(), replace(GAINS, proportional=1e12), [40.0]
        )
        > 1e6
    )
    assert not math.isnan(
        nominal_eigenvalue(Peltier.model().typical(), GAINS, [math.nan])
    )
