"""Between which levels forecasts came true, as a person reads it."""

from __future__ import annotations

import math
from dataclasses import replace

from tests.views.test_line import VERDICT
from twinmatch.views import TrustRange, trust_range


def test_degrees_are_rounded_to_the_inside() -> None:
    found = trust_range(replace(VERDICT, held_low=22.3, held_high=89.7), "°C")
    assert found == TrustRange(22.3, 89.7, "°C")
    assert str(found) == "23 and 89 °C"


def test_nothing_is_said_before_a_forecast_has_come_true() -> None:
    assert math.isnan(VERDICT.held_low)
    assert trust_range(VERDICT, "°C") is None
