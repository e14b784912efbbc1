"""A window that the plant's first structure cannot explain is matched in another one, which then competes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.recorded_kits import kit_rows
from twinmatch.comparing import Verdict
from twinmatch.dynamics import advance, begin, read
from twinmatch.fitting import Match, Status
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.plants import TCLab
from twinmatch.signals import Sample, Window
from twinmatch.twin import MatchRequest, TwinSettings, carry_out

PERIOD = 5.0
SETTINGS = TwinSettings.of(TCLab, period=PERIOD, law=None)
LATE = "sensor lag, dead time"


def kit(late: int, seed: int, size: int = 480) -> list[Sample]:
    """A kit under steps of its heater, which acts exactly `late` samples later."""
    random = np.random.default_rng(seed)
    plant = TCLab.model("sensor lag").typical().replace(ambient=random.uniform(291.0, 298.0), sensor_lag=8.0)
    power = np.repeat(random.uniform(0.0, 100.0, size), random.integers(8, 30, size))[:size]
    power[:10] = 0.0  # at rest: the start of the heater's temperature is the first reading
    states, samples = begin(plant, plant["ambient"] - 273.15), []
    for k in range(size):
        reading = read(plant, states) + 0.1 * random.standard_normal()
        samples.append(Sample(k, round(k * PERIOD * 1e9), reading, reading, float(power[k])))
        states = advance(plant, states, power[max(0, k - late)], PERIOD)
    return samples


def judged(samples: list[Sample]) -> Judgement:
    return judge_samples("kit", samples, SETTINGS)


def structure_of(match: Match) -> str:
    return match.parameters.model.structure_name


def structure_of_leader(verdict: Verdict) -> str:
    """The structure of the leader."""
    leader = next(score for score in verdict.forecasts if score.name == verdict.leader)
    return leader.parameters.model.structure_name


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("late", [2, 3])
def test_a_dead_time_is_found(late: int, seed: int) -> None:
    found = judged(kit(late, seed))
    first, last = found.matches[0].match, found.verdicts[-1]
    assert first.accepted
    assert structure_of(first) == LATE
    assert first.parameters["dead_time"] == pytest.approx(PERIOD * late, abs=PERIOD / 3.0)
    assert last.structure == structure_of_leader(last) == LATE
    assert any(score.name == LATE for score in last.forecasts), "it competes as a structure, too"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_one_the_first_structure_stays(seed: int) -> None:
    found = judged(kit(0, seed))
    assert {structure_of(report.match) for report in found.matches} == {"sensor lag"}
    assert LATE not in {score.name for verdict in found.verdicts for score in verdict.forecasts}


def request(window: Window) -> MatchRequest:
    return MatchRequest(window.last, 40.0, window, SETTINGS.start, None)


def test_a_structure_is_chosen_once_and_by_the_request_alone() -> None:
    """A regime that a match describes already has its structure: what it does not explain is a change."""
    window = Window.from_samples(kit(3, 1)[:200], PERIOD)
    report = carry_out(request(window), SETTINGS)
    assert structure_of(report.match) == LATE
    assert "in the structure 'sensor lag'" in report.match.reason
    assert repr(carry_out(request(window), SETTINGS)) == repr(report)
    known = report.match.parameters
    again = request(window)._replace(start=known, incumbent=known)
    assert structure_of(carry_out(again, SETTINGS).match) == LATE
    before = request(window)._replace(incumbent=SETTINGS.start)
    assert structure_of(carry_out(before, SETTINGS).match) == "sensor lag"


def test_who_says_what_is_free_has_chosen() -> None:
    window = Window.from_samples(kit(3, 1)[:200], PERIOD)
    report = carry_out(request(window), replace(SETTINGS, free=("losses", "heating")))
    assert structure_of(report.match) == "sensor lag"
    assert report.match.free == ("losses", "heating")


@pytest.mark.parametrize("name", ["mpc_1", "mpc_44"])
def test_a_real_kit_whose_table_holds_the_input_early_is_matched(name: str) -> None:
    rows = kit_rows("tclab_other", name)
    found = judged(
        [Sample(k, round(r["Time"] * 1e9), r["T1"], r["T1"], r["Q1"], (r["Q2"],)) for k, r in enumerate(rows)]
    )
    (report,) = found.matches
    assert report.match.status is Status.ACCEPTED, report.match.reason
    assert structure_of(report.match) == "sensor lag, radiation, neighbour, dead time"
    last = found.verdicts[-1]
    leader = next(score for score in last.forecasts if score.name == last.leader)
    assert leader.arx_skill[1] > 0.1, "60 s ahead it is better than an ARX model"
    assert not any(verdict.fault for verdict in found.verdicts)
