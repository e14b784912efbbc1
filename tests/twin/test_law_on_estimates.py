"""What a law took in place of readings, from verdicts and estimates alone."""

from __future__ import annotations

import pytest

from tests.support.verdicts import verdict
from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.health import EstimatedReading
from twinmatch.safety.stand_in import LASTING
from twinmatch.twin.law_on_estimates import LawOnEstimates

PERIOD = 0.5
ACCUSED_AT = 400
LASTED = ACCUSED_AT + round(LASTING / PERIOD)


@pytest.fixture
def law() -> LawOnEstimates:
    return LawOnEstimates(["temperature"], PERIOD)


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
    law: LawOnEstimates,
) -> None:
    """It may itself be wrong: its estimates are published, and the law keeps to the reading."""
    law.take(verdict(TrustLevel.UNKNOWN, 300))
    law.take(accusation())
    taken = [law.taken_after(k, [estimate(k)]) for k in range(ACCUSED_AT, LASTED + 5)]
    assert not any(taken)


def test_of_a_trusted_twin_the_estimate_is_taken_from_ten_seconds_on_until_it_gives_the_sensor_back(
    law: LawOnEstimates,
) -> None:
    law.take(verdict(TrustLevel.TRUSTED, 300))
    law.take(accusation())
    taken = [
        bool(law.taken_after(k, [estimate(k)])) for k in range(ACCUSED_AT, LASTED + 2)
    ]
    assert taken.index(True) == LASTED - ACCUSED_AT
    law.take(verdict(TrustLevel.TRUSTED, LASTED + 2))
    assert law.taken_after(LASTED + 2, [estimate(LASTED + 2)]) == {}


@pytest.mark.parametrize(
    ("accused", "band"), [("second_temperature", 0.5), ("temperature", 1.5)]
)
def test_no_other_sensor_and_no_wide_estimate_is_taken(
    law: LawOnEstimates, accused: str, band: float
) -> None:
    law.take(verdict(TrustLevel.TRUSTED, 300))
    law.take(accusation(accused))
    assert law.taken_after(LASTED, [estimate(LASTED, band=band)]) == {}
