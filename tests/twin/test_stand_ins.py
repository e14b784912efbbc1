"""What a law took in place of readings, from verdicts and estimates alone."""

from __future__ import annotations

import pytest

from tests.support.verdicts import verdict
from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.health import EstimatedReading
from twinmatch.safety.stand_in import LASTING
from twinmatch.twin.stand_ins import StandIns

PERIOD = 0.5
ACCUSED_AT = 400
LASTED = ACCUSED_AT + round(LASTING / PERIOD)


@pytest.fixture
def stand_ins() -> StandIns:
    return StandIns(["temperature"], PERIOD)


def estimate(sample: int, *, band: float = 0.5) -> EstimatedReading:
    return EstimatedReading(
        sample=sample,
        signal="temperature",
        value=41.0,
        band=band,
        reading=46.0,
        since=ACCUSED_AT,
        wide=1.0,
        good=600.0,
    )


def accusation(of: str = "temperature") -> Verdict:
    return verdict(
        TrustLevel.FAULT,
        ACCUSED_AT,
        fault="sensor-drift",
        fault_signal=of,
        fault_since=ACCUSED_AT,
    )


def test_nothing_is_taken_for_a_twin_that_was_never_trusted(
    stand_ins: StandIns,
) -> None:
    """It may itself be wrong: its estimates are published, and the law keeps to the reading."""
    stand_ins.take(verdict(TrustLevel.UNKNOWN, 300))
    stand_ins.take(accusation())
    taken = [
        stand_ins.taken_after(k, [estimate(k)]) for k in range(ACCUSED_AT, LASTED + 5)
    ]
    assert not any(taken)


def test_of_a_trusted_twin_the_estimate_is_taken_from_ten_seconds_on_until_it_gives_the_sensor_back(
    stand_ins: StandIns,
) -> None:
    stand_ins.take(verdict(TrustLevel.TRUSTED, 300))
    stand_ins.take(accusation())
    taken = [
        bool(stand_ins.taken_after(k, [estimate(k)]))
        for k in range(ACCUSED_AT, LASTED + 2)
    ]
    assert taken.index(True) == LASTED - ACCUSED_AT
    stand_ins.take(verdict(TrustLevel.TRUSTED, LASTED + 2))
    assert stand_ins.taken_after(LASTED + 2, [estimate(LASTED + 2)]) == {}


@pytest.mark.parametrize(
    ("accused", "band"), [("second_temperature", 0.5), ("temperature", 1.5)]
)
def test_no_other_sensor_and_no_wide_estimate_is_taken(
    stand_ins: StandIns, accused: str, band: float
) -> None:
    stand_ins.take(verdict(TrustLevel.TRUSTED, 300))
    stand_ins.take(accusation(accused))
    assert stand_ins.taken_after(LASTED, [estimate(LASTED, band=band)]) == {}
