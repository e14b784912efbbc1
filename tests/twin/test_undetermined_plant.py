"""A plant of which only a combination of the parameters shows: the twin says so and continues."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.plants import Tank
from twinmatch.comparing import Verdict
from twinmatch.dynamics import Sensor, begin, simulate_closed_loop
from twinmatch.fitting import Match
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin, TwinSettings


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    """Of an outflow only hole²/area shows: d(outflow)/dt = hole²·(inflow/outflow − 1)/(2·area)."""
    truth = Tank.model().parameters(area=5.0, hole=0.9)
    reference = np.repeat([0.8, 1.6, 1.1, 2.0, 0.7], 240)
    sensor = Sensor(noise=Tank.output.noise).realise(reference.size, 1.0, 4)
    run = simulate_closed_loop(
        truth, reference, states=begin(truth, 0.8), law=Tank.loop, sensor=sensor
    )
    twin = Twin(TwinSettings.of(Tank, period=1.0))
    with np.errstate(divide="raise", invalid="raise"):
        return [
            twin.push(Sample(k, k * 10**9, float(r), float(y), float(u)))
            for k, (r, y, u) in enumerate(
                zip(reference, run.output, run.input, strict=True)
            )
        ]


def test_a_match_says_that_nothing_tells_them_apart(outcomes: list[Outcome]) -> None:
    matches: list[Match] = [o.match.match for o in outcomes if o.match is not None]
    assert len(matches) == 3
    for accepted_match in matches:
        assert accepted_match.accepted
        assert accepted_match.condition == np.inf
        assert "does not show in this window at all" in accepted_match.determined
        # The combination is what the plant has: 0.9²/5 within 3 %, some four standard errors of a window.
        assert accepted_match.parameters["hole"] ** 2 / accepted_match.parameters[
            "area"
        ] == pytest.approx(0.162, rel=0.03)


def test_its_twins_forecast_all_the_same(outcomes: list[Outcome]) -> None:
    verdicts: list[Verdict] = [v for o in outcomes for v in o.verdicts]
    last = verdicts[-1]
    assert last.leader
    assert last.miss_y < 2.0  # half widths of the band: what was forecast came true
    assert all(np.isfinite(s.gain) for s in last.forecasts)
