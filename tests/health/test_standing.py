"""Changes that were named and are over: what may be left of them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.bank.kits import typical
from twinmatch.health.evidence import Competition
from twinmatch.health.faults import Fault
from twinmatch.health.standing import UNDOING, NamedChange, StandingChanges
from twinmatch.signals import NANOSECONDS, Sample


@pytest.mark.parametrize(
    ("fault", "number", "size"),
    [(Fault.SENSOR_DRIFT, "offset 1", -3.0), (Fault.DRIVE_WEAK, "share 1", -0.5)],
)
def test_two_fifths_of_a_change_may_be_left_for_ten_minutes(
    fault: Fault, number: str, size: float
) -> None:
    competition = Competition(typical(), 1.0)
    for k in range(10):
        sample = Sample(k, k * NANOSECONDS, (0.0, 0.0), (25.0, 25.0), (0.0, 0.0))
        competition.push(sample, np.array(sample.outputs), np.ones(2, dtype=bool))
    row = next(row for row in competition.rows if row.cause == (fault, 1))
    standing = StandingChanges(competition)
    named = NamedChange(fault, row, competition.believed_before(5), size)
    standing.note([named])
    assert standing.may_remain(number, 101) == 0.0
    standing.remove([named], 100)
    settled = 100 + round(UNDOING.settles)
    assert standing.may_remain(number, settled - 1) == pytest.approx(0.4 * abs(size))
    assert standing.may_remain(number, settled) == 0.0
