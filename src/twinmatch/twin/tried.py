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
    for name, known in snapshot.outlooks.items():
        n = known.states.size
        sample = known.sample
        row = np.array(sample.disturbances) if sample.disturbances else None
        after = advance(known.parameters, known.states, sample.inputs, known.period, row)
        covariance = known.covariance[n:, n:]
        inputs = np.array(sample.inputs)
        members.append(
            TriedTwin(name, known.parameters, known.unsure, covariance, after, inputs, disturbances=row)
        )
    return tuple(members)
