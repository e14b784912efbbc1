"""A window that the plant's first structure cannot explain is matched in another one, which then competes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.recorded_kits import kit_rows
from twinmatch.comparing import Verdict
from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
    advance,
    begin,
    read,
    simulate_driven,
)
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
    plant = (
        TCLab.model("sensor lag")
        .typical()
        .replace(ambient=random.uniform(291.0, 298.0), sensor_lag=8.0)
    )
    power = np.repeat(random.uniform(0.0, 100.0, size), random.integers(8, 30, size))[
        :size
    ]
    # at rest: the start of the heater's temperature is the first reading
    power[:10] = 0.0
    states = begin(plant, plant["ambient"] - 273.15)
    samples = []
    for k in range(size):
        reading = read(plant, states) + 0.1 * random.standard_normal()
        samples.append(
            Sample(k, round(k * PERIOD * 1e9), reading, reading, float(power[k]))
        )
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


def test_a_dead_time_is_found() -> None:
    """One of three samples is found below, in a request."""
    late = 2
    judgement = judged(kit(late, 1, 340))
    first = judgement.matches[0].match
    last = judgement.verdicts[-1]
    assert first.accepted
    assert structure_of(first) == LATE
    assert first.parameters["dead_time"] == pytest.approx(
        PERIOD * late, abs=PERIOD / 3.0
    )
    assert last.structure == structure_of_leader(last) == LATE
    assert any(score.name == LATE for score in last.forecasts), (
        "it competes as a structure, too"
    )


def test_without_one_the_first_structure_stays() -> None:
    judgement = judged(kit(0, 1, 300))
    assert {structure_of(report.match) for report in judgement.matches} == {
        "sensor lag"
    }
    assert LATE not in {
        score.name for verdict in judgement.verdicts for score in verdict.forecasts
    }


def request(window: Window) -> MatchRequest:
    return MatchRequest(window.last, 40.0, window, SETTINGS.start, None)


def test_a_structure_is_chosen_once_and_by_the_request_alone() -> None:
    """A regime that a match describes already has its structure: what it does not explain is a change."""
    window = Window.from_samples(kit(3, 1)[:200], PERIOD)
    report = carry_out(request(window), SETTINGS)
    assert structure_of(report.match) == LATE
    assert "in the structure 'sensor lag'" in report.match.reason
    assert repr(carry_out(request(window), SETTINGS)) == repr(report)
    matched = report.match.parameters
    second_request = request(window)._replace(start=matched, incumbent=matched)
    assert structure_of(carry_out(second_request, SETTINGS).match) == LATE
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
    judgement = judged(
        [
            Sample(k, round(r["Time"] * 1e9), r["T1"], r["T1"], r["Q1"], (r["Q2"],))
            for k, r in enumerate(rows)
        ]
    )
    (report,) = judgement.matches
    assert report.match.status is Status.ACCEPTED, report.match.reason
    assert structure_of(report.match) == "sensor lag, radiation, neighbour, dead time"
    last = judgement.verdicts[-1]
    leader = next(score for score in last.forecasts if score.name == last.leader)
    assert leader.arx_skill[1] > 0.1, "60 s ahead it is better than an ARX model"
    assert not any(verdict.fault for verdict in judgement.verdicts)


class PromptKit(Plant, name="prompt_kit"):
    """A heater behind a lag, in a file without a dead time."""

    time_constant = 100.0
    temperature = Output(
        unit="°C", noise=0.1, span=(0.0, 150.0), set_points=(25.0, 70.0)
    )
    power = Drive(unit="%", limits=(0.0, 100.0), noise=1.0)
    heater = State(unit="°C", span=(0.0, 200.0))
    gain = Parameter(unit="K/%", default=0.8, bounds=(0.1, 5.0), positive=True)
    lag = Parameter(unit="s", default=150.0, bounds=(10.0, 1000.0), positive=True)
    structures = {"one lag": Structure(free=("gain", "lag"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """One energy balance above a room of 20 °C."""
        rates = {
            self.heater: (self.gain * self.power - (self.heater - 20.0)) / self.lag
        }
        return Equations(
            rates=rates, output=self.heater, start={self.heater: self.temperature}
        )


PROMPT = TwinSettings.of(PromptKit, period=PERIOD, law=None)


def prompt_window(late: int) -> Window:
    """Of a heater that acts exactly `late` samples later than its file says."""
    random = np.random.default_rng(4)
    power = np.repeat(random.uniform(0.0, 100.0, 20), 12)
    power[:10] = 0.0
    acts = np.concatenate([np.zeros(late), power])[: power.size]
    heater = PromptKit.model().parameters(gain=0.7, lag=120.0)
    moved = simulate_driven(
        heater, acts, states=begin(heater, 20.0), period=PERIOD
    ).output
    return Window(
        moved, moved + random.normal(0.0, 0.1, moved.size), power, period=PERIOD
    )


def test_a_match_names_the_dead_time_that_no_structure_has() -> None:
    late = 3
    asked = request(prompt_window(late))._replace(start=PROMPT.start)
    refused_match = carry_out(asked, PROMPT).match
    assert refused_match.status is Status.NOT_EXPLAINED
    dead_time, separator, explained = refused_match.reason.split("; ")[-1].partition(
        " s would explain "
    )
    assert separator, refused_match.reason
    assert int(explained.split("%")[0]) > 90
    # A dead time of a few states rounds off an exact one of two or three samples.
    assert float(dead_time.removeprefix("a dead time of about ")) == pytest.approx(
        late * PERIOD, abs=1.0
    )


def test_no_dead_time_is_named_that_explains_nothing() -> None:
    """Something pushes the reading up and down, which no delay of the heater does."""
    window = prompt_window(0)
    wave = 10.0 * np.sin(np.arange(len(window)) / 7.0)[:, None]
    pushed = replace(window, outputs=window.outputs + wave)
    for asked, status in ((pushed, Status.NOT_EXPLAINED), (window, Status.ACCEPTED)):
        matched = carry_out(request(asked)._replace(start=PROMPT.start), PROMPT).match
        assert matched.status is status
        assert "dead time" not in matched.reason
