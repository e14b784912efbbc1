"""Between which levels forecasts came true, as a person reads it."""

from __future__ import annotations

import math
from dataclasses import replace

from tests.showing.test_line import VERDICT
from tests.support.plants import Tank
from twinmatch.offline.summary import TrustRange, trust_range
from twinmatch.plants import Peltier


def test_degrees_are_rounded_to_the_inside() -> None:
    found = trust_range(replace(VERDICT, held_low=22.3, held_high=89.7), Peltier.output)
    assert found == TrustRange(22.3, 89.7, "°C")
    assert str(found) == "23 and 89 °C"


def test_nothing_is_said_before_a_forecast_has_come_true() -> None:
    assert math.isnan(VERDICT.held_low)
    assert trust_range(VERDICT, Peltier.output) is None


def test_a_plant_of_small_numbers_keeps_its_places() -> None:
    """Readings of the tank have a noise of 0.005 l/s; in whole litres there would be no range at all."""
    found = trust_range(replace(VERDICT, held_low=0.612, held_high=0.977), Tank.output)
    assert str(found) == "0.62 and 0.97 l/s"
    assert str(TrustRange(0.302, 0.309, "l/s", 2)) == "0.30 and 0.31 l/s"  # nothing is left to round away
