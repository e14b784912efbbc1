"""Between which temperatures a twin was seen to hold."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.rig import GAINS, rig
from tests.support.rig import run as simulated
from twinmatch.discrimination import CandidateScore
from twinmatch.dynamics import Parameters
from twinmatch.signals import KELVIN, Sample
from twinmatch.views import trust_range

RIG = rig(seebeck=0.06, conductance=0.5, heat_capacity=27.0)
REST = RIG["ambient"] - KELVIN


def run(levels: list[float], first: int = 0, hold: int = 240) -> list[Sample]:
    """The rig itself, without noise, starting at rest in its surroundings."""
    reference = np.repeat(levels, hold)
    response = simulated(RIG, reference, start=REST)
    return [
        Sample(first + k, (first + k) * 10**9, float(r), float(y), float(u))
        for k, (r, y, u) in enumerate(zip(reference, response.output, response.input, strict=True))
    ]


def candidate(parameters: Parameters, first: int, last: int) -> CandidateScore:
    return CandidateScore("c", 40.0, parameters, first, last, (), "22221", 0.0, None, None)


def test_the_right_twin_holds_wherever_the_plate_has_been() -> None:
    samples = run([40.0, 60.0, 80.0])
    found = trust_range(samples, candidate(RIG, 0, 200), GAINS)
    assert found is not None
    temperatures = [s.output for s in samples]
    assert found.low == min(temperatures)
    assert found.high == max(temperatures)


def test_a_twin_that_fails_when_hot_is_trusted_only_where_it_holds() -> None:
    """Its conductance is far off, which shows the more the further the plate is from its surroundings."""
    wrong = RIG.replace(conductance=0.8)
    samples = run([27.0, 90.0], hold=300)
    found = trust_range(samples, candidate(wrong, 100, 299), GAINS)
    assert found is not None
    assert found.low == pytest.approx(REST, abs=0.1)
    assert found.high < 88.0, "at rest at 90 °C it needs far more power than the plant"


def test_temperatures_beyond_a_stretch_that_was_not_seen_do_not_count() -> None:
    cold, hot = run([30.0]), run([85.0], first=1000)[120:]
    found = trust_range(cold + hot, candidate(RIG, 0, 239), GAINS)
    assert found is not None
    assert found.high < 40.0
    there = trust_range(cold + hot, candidate(RIG, 1150, 1239), GAINS)
    assert there is not None
    assert there.low > 70.0


def test_a_candidate_that_was_given_begins_at_its_operating_point() -> None:
    samples = run([40.0])
    given = candidate(RIG, 0, -1)
    assert trust_range(samples, given, GAINS) is not None
    assert trust_range(samples, candidate(RIG.replace(seebeck=0.0), 0, -1), GAINS) is None


def test_degrees_are_rounded_to_the_inside() -> None:
    found = trust_range(run([40.0]), candidate(RIG, 0, 239), GAINS)
    assert found is not None
    low, high = (float(word) for word in str(found).removesuffix(" °C").split(" and "))
    assert found.low <= low < found.low + 1
    assert found.high - 1 < high <= found.high
