"""The engine on plants with several loops: on a simulated pair of heaters, and on a real kit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from benchmarks.bank.kits import typical
from tests.support.documented_trust import check_trust, documents_of_verdicts
from tests.support.exchanging import Heaters, heated_with_a_lie
from tests.support.laws import kit_session
from twinmatch.comparing import Verdict
from twinmatch.comparing.matrix_gap import matrix_nu_gap
from twinmatch.comparing.plant_gap import LoopConditions, plant_gaps, spans_of
from twinmatch.comparing.state_space import StateSpace
from twinmatch.control import Loop
from twinmatch.dynamics import (
    PidGains,
    PidLoops,
    advance,
    begin,
    linearised,
    readings,
    simulate_closed_loop,
)
from twinmatch.offline.judging import terms_from_files
from twinmatch.plants import TCLabBoth
from twinmatch.signals import Sample, Window
from twinmatch.twin import Forecaster, Outcome, Twin, TwinSettings
from twinmatch.twin.engine import Discriminator
from twinmatch.twin.law_on_estimates import LawOnEstimates
from twinmatch.twin.matcher import MatchReport, carry_out

TRUTH = Heaters.model().parameters()
LAW = PidLoops.of(
    *(PidGains(8.0, 0.06, 0.0, 0.05, low=0.0, high=100.0) for _ in range(2))
)
LEVELS = [(40.0, 40.0), (50.0, 40.0), (50.0, 55.0), (40.0, 45.0)]


def looped(hold: int = 300) -> list[Sample]:
    references = np.repeat(np.array(LEVELS), hold, axis=0)
    run = simulate_closed_loop(
        TRUTH, references, states=begin(TRUTH, [25.0, 25.0]), law=LAW
    )
    y = run.outputs + 0.1 * np.random.default_rng(7).standard_normal(references.shape)
    return Window(references, y, run.inputs).samples(0)


def verdicts_of(settings: TwinSettings, samples: Sequence[Sample]) -> list[Verdict]:
    twin = Twin(settings)
    return [verdict for sample in samples for verdict in twin.push(sample).verdicts]


@pytest.fixture(scope="module")
def in_loop() -> list[Verdict]:
    return verdicts_of(TwinSettings.of(Heaters, law=LAW), looped())


def test_a_family_of_several_loops_is_compared_by_gaps_of_matrices(
    in_loop: list[Verdict],
) -> None:
    last = [verdict for verdict in in_loop if not verdict.stands][-1]
    points = {candidate.operating_point for candidate in last.candidates}
    assert points <= {*LEVELS}
    assert len(points) >= 2
    assert last.order is None
    assert all(not candidate.orders for candidate in last.candidates)
    assert "orders and code lengths are for plants with one loop" in last.certainty
    assert np.array(last.nu_gap_points).reshape(-1, 2).min() == 40.0
    chosen = last.chosen
    assert chosen is not None
    assert chosen.margin is not None
    assert 0.05 < chosen.margin <= 1.0
    assert math.isnan(chosen.nominal_probability)
    assert chosen.name in {f"{a:g} °C, {b:g} °C" for a, b in LEVELS}
    for name, value in TRUTH.items():
        assert chosen.parameters[name] == pytest.approx(value, rel=0.1)


def test_the_gap_of_two_twins_is_that_of_their_plants(in_loop: list[Verdict]) -> None:
    other_twin = TRUTH.replace(exchange=0.03)
    loop = LoopConditions(None, spans_of(Heaters), 240, 1.0)
    gaps = plant_gaps((TRUTH, other_twin), [(40.0, 40.0)], loop)
    systems = [
        StateSpace.of(linearised(parameters, [40.0, 40.0], 1.0))
        for parameters in (TRUTH, other_twin)
    ]
    scaled = [
        system.scaled(loop.scales.output, loop.scales.input) for system in systems
    ]
    assert gaps.matrix[0, 1] == pytest.approx(matrix_nu_gap(*scaled), rel=1e-8)
    assert gaps.matrix[0, 1] > 0.01
    assert in_loop[-1].nu_gap[0][0] == 0.0


def test_trust_is_said_of_each_signal(in_loop: list[Verdict]) -> None:
    last = in_loop[-1]
    assert [trust.signal for trust in last.signals] == [
        "first",
        "second",
        "first_power",
        "second_power",
    ]
    assert last.trusted
    outputs = last.signals[:2]
    assert {*last.trusted} <= set.intersection(*({*trust.trusted} for trust in outputs))
    assert last.miss_y == max(trust.miss for trust in outputs)
    assert last.inside_y == min(trust.inside for trust in outputs)
    least = np.min([trust.coverage for trust in last.signals], axis=0)
    assert last.leading is not None
    np.testing.assert_allclose(last.leading.coverage, least, atol=0.2)


def test_trusted_horizons_of_several_outputs_pass_the_documented_test(
    in_loop: list[Verdict],
) -> None:
    check_trust(documents_of_verdicts(in_loop), outputs=("first", "second"))


def test_samples_of_a_sensor_that_lies_are_not_matched() -> None:
    settings = TwinSettings.of(Heaters, law=None, period=2.0)
    samples = heated_with_a_lie(1200, 700, 1000).samples(0)
    verdicts = verdicts_of(settings, samples)
    matched = [verdict for verdict in verdicts if verdict.match]
    (while_on,) = [v for v in matched if 700 <= v.sample < 1000]
    afterwards = matched[-1]
    assert {verdict.match for verdict in matched if verdict.sample < 700} == {
        "admitted"
    }
    assert afterwards.first <= 999 < afterwards.sample
    for verdict in (while_on, afterwards):
        assert verdict.match == "refused"
        assert (
            verdict.reason
            == "not matched: the readings of second were off from sample 700 on"
        )
    assert all(candidate.last < 700 for candidate in verdicts[-1].candidates)


def test_an_impossible_reading_is_a_fault_of_its_channel() -> None:
    samples = looped(100)
    right = looped(100)
    for k in range(200, 240):
        y = samples[k].outputs
        u = samples[k].inputs
        samples[k] = Sample(
            k, samples[k].stamp, samples[k].references, (y[0], math.nan), u
        )
    twin = Twin(TwinSettings.of(Heaters, law=None))
    outcomes = [twin.push(sample) for sample in samples]
    faulty_verdicts = [v for outcome in outcomes for v in outcome.verdicts if v.fault]
    assert {(v.fault, v.fault_signal) for v in faulty_verdicts} == {
        ("sensor-implausible", "second")
    }
    assert faulty_verdicts[0].sample <= 205
    estimates = [
        estimate for outcome in outcomes[:240] for estimate in outcome.estimates
    ]
    assert {estimate.signal for estimate in estimates} == {"second"}
    assert (
        max(
            abs(estimate.value - right[estimate.sample].outputs[1])
            for estimate in estimates
        )
        < 3.0
    )
    (alarm,) = twin.discriminator.monitor.alarms
    assert alarm.last is not None
    assert alarm.last <= 241


def test_a_real_kit_is_trusted_in_a_loop_of_another_law(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Two set-points, stepped by ± 5 °C. Its law is not the file's. The first 1600 s are put aside: they hold
    some ten forecasts 60 s ahead that do not overlap."""
    session = kit_session("closed_loop_lqg", tmp_path_factory.mktemp("kit"))
    terms = terms_from_files(session)
    assert terms.settings.plant is TCLabBoth
    assert terms.settings.law is None
    assert "not those of the loop in the plant file" in terms.source
    verdicts = verdicts_of(terms.settings, session.samples[:2200])
    assert not any(verdict.fault for verdict in verdicts)
    check_trust(documents_of_verdicts(verdicts), outputs=tuple(TCLabBoth.outputs))
    later = [verdict.level.value for verdict in verdicts if verdict.sample >= 1600]
    assert later.count("trusted") >= 0.8 * len(later)
    inside = np.array([trust.inside for trust in verdicts[-1].signals])
    assert inside.shape == (2,)


def kit_on_estimates(loop: Loop, twin: Twin) -> Iterator[tuple[Sample, Outcome]]:
    """A kit whose first loop takes what the twin says T1 should read, as the kit's controller does: from the
    beginning of the lie, at sample 900, to its end at 1100. T1's set-point steps often enough that the twin is
    trusted by then, and at 1200."""
    truth = typical()
    random = np.random.default_rng(5)
    states = begin(truth, [23.0, 23.0])
    law = LawOnEstimates(("temperature",), 1.0)
    estimates = dict[str, float]()
    levels = [35.0, 45.0, 38.0, 50.0, 40.0, 48.0, 38.0]
    holds = [150, 150, 150, 150, 150, 450, 241]
    for k, level in enumerate(np.repeat(levels, holds).tolist()):
        lie = 5.0 if 900 <= k < 1100 else 0.0
        y = readings(truth, states) + 0.04 * random.standard_normal(2) + (lie, 0.0)
        given_to_law = (estimates.get("temperature", math.nan), math.nan)
        loop.measure(tuple(y.tolist()), k * 10**9, taken=given_to_law)
        sample = loop.tick(k * 10**9, lambda _, level=level: (level, 40.0))  # type: ignore[misc]
        assert sample is not None
        outcome = twin.push(sample)
        yield sample, outcome
        for verdict in outcome.verdicts:
            law.take(verdict)
        estimates = law.taken_after(sample.index, outcome.estimates)
        states = advance(truth, states, np.array(sample.inputs), 1.0)


@dataclass
class RunOnEstimates:
    """All samples of that kit, judged by a twin that knows what its law was given."""

    twin: Twin
    samples: list[Sample] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    newest_estimate: int = 0
    """Sample."""
    errors: list[list[float]] = field(default_factory=list)
    """By how much that twin, and one that is not told, are off in the integral of the first loop at each
    sample with an estimate until the end of the lie."""


@pytest.fixture(scope="module")
def on_estimates() -> RunOnEstimates:
    loop = Loop(TCLabBoth)
    settings = TwinSettings.of(TCLabBoth)
    twin = Twin(replace(settings, read_through=("temperature",)))
    uninformed = Forecaster(settings.law, settings.forecasts)
    run = RunOnEstimates(twin)
    for sample, outcome in kit_on_estimates(loop, twin):
        run.samples.append(sample)
        run.verdicts += outcome.verdicts
        uninformed.push(sample)
        if outcome.estimates:
            run.newest_estimate = sample.index
        if outcome.estimates and sample.index < 1100:
            integral = loop.pids[0].state[0]
            forecasters = (twin.discriminator.forecaster, uninformed)
            run.errors.append(
                [
                    abs(forecaster.arx.controller[0] - integral)
                    for forecaster in forecasters
                ]
            )
    return run


def test_a_law_that_ran_on_an_estimate_is_followed_with_that(
    on_estimates: RunOnEstimates,
) -> None:
    """With `read_through` the twin knows what its law was given."""
    assert len(on_estimates.errors) > 150
    # What was known of the integral at the change decays with the time of the back-calculation, 15.5 s.
    right, wrong = np.array(on_estimates.errors)[80:].max(axis=0)
    assert right < 0.1 * wrong


def test_no_estimate_waits_for_a_match(on_estimates: RunOnEstimates) -> None:
    """While a match is awaited nothing is judged, and the law's estimates would be too old after 2 s. But no
    match is requested of samples of a sensor that lies, and one that was requested before delays the accusation."""
    discriminator = Discriminator(on_estimates.twin.settings)
    answer: MatchReport | None = None
    due = 0
    requested = 0
    since: int | None = None
    delays = []
    for sample in on_estimates.samples[:1100]:
        step = discriminator.push_sample(sample)
        estimates = list(step.estimates)
        if answer is not None and sample.index >= due:
            step = discriminator.push_match(answer)
            estimates += step.estimates
            answer = None
        if step.request is not None:
            answer = carry_out(step.request, on_estimates.twin.settings)
            due = sample.index + 40
            requested += 1
        if estimates and since is None:
            since = sample.index
        if since is not None:
            newest = estimates[-1].sample if estimates else -1
            delays.append(sample.index - newest)
    assert requested >= 3
    assert since is not None
    assert len(delays) > 100
    assert set(delays) == {0}


def test_samples_of_a_law_that_ran_on_an_estimate_are_not_matched(
    on_estimates: RunOnEstimates,
) -> None:
    """The samples after them are, as another session that begins with sample 0."""
    twin = on_estimates.twin
    samples = on_estimates.samples
    verdicts = on_estimates.verdicts
    newest_estimate = on_estimates.newest_estimate
    assert verdicts[-1].match == "refused"
    assert verdicts[-1].first <= newest_estimate
    # The law was given the newest estimate at the sample after it.
    until = newest_estimate + 1
    assert verdicts[-1].reason.startswith(
        f"not matched: the law ran on an estimate until sample {until}"
    )
    session = [
        replace(sample, index=k, stamp=sample.stamp - samples[until + 1].stamp)
        for k, sample in enumerate(samples[until + 1 :])
    ]
    later = [verdict for sample in session for verdict in twin.push(sample).verdicts]
    # A match was made; whether it forecasts better than the newest one is left to its gate.
    assert later[-1].match in {"admitted", "refused"}
    assert "the law ran on an estimate" not in later[-1].reason
    assert "residuals" in later[-1].reason
