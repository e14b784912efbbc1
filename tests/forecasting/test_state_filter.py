"""A twin carried beside the plant."""

from __future__ import annotations

import numpy as np

from tests.support.plants import Tank
from twinmatch.forecasting import (
    StateFilter,
)
from twinmatch.signals import Sample


def test_a_twin_whose_states_are_lost_starts_over() -> None:
    """One reading far below zero empties the tank beyond what its equations can say."""
    state_filter = StateFilter(Tank.model().parameters(), 1.0, states=np.array([1.0]))
    for index, output in enumerate((-3.0, 0.1, 0.12)):
        state_filter.push(Sample(index, index * 10**9, 0.1, output, 0.1))
        if index == 0:
            assert state_filter.states[0] < 0.0
    assert np.isfinite(state_filter.states).all()
    assert np.isfinite(state_filter.joint).all()
    assert 0.0 < state_filter.states[0] < 0.5
