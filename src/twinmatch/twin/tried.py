"""The candidates as twins on which controllers are tried, and courses predicted."""

from __future__ import annotations

import numpy as np

from twinmatch.controllers import TriedTwin
from twinmatch.dynamics import advance
from twinmatch.twin.forecaster import Snapshot

__all__ = ["tried_twins"]


def tried_twins(snapshot: Snapshot) -> tuple[TriedTwin, ...]:
    """All candidates of a snapshot, each with what it leaves open, in their states at the sample after it."""
    members = []
    for name, outlook in snapshot.outlooks.items():
        n = outlook.states.size
        sample = outlook.sample
        row = np.array(sample.disturbances) if sample.disturbances else None
        after = advance(
            outlook.parameters, outlook.states, sample.inputs, outlook.period, row
        )
        covariance = outlook.covariance[n:, n:]
        inputs = np.array(sample.inputs)
        members.append(
            TriedTwin(
                name,
                outlook.parameters,
                outlook.unsure,
                covariance,
                after,
                inputs,
                disturbances=row,
            )
        )
    return tuple(members)
