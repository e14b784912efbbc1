"""The whole line on a simulated rig that is richer than the twin."""

from __future__ import annotations

import dataclasses
import math
from itertools import cycle

import numpy as np
import pytest

from tests.support.watched import copied
from twinmatch.comparing import Candidate, TrustLevel, Verdict
from twinmatch.dynamics import Controller, Parameters, advance, begin, read
from twinmatch.health import Health
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, Window
from twinmatch.twin import (
    Discriminator,
    MatchReport,
    Outcome,
    Step,
    TrustLimits,
    Twin,
    TwinError,
    TwinSettings,
    carry_out,
    window_fit,
)


def verdicts_of(outcomes: list[Outcome]) -> list[Verdict]:
    return [v for o in outcomes for v in o.verdicts]


def matches_of(outcomes: list[Outcome]) -> list[MatchReport]:
    return [o.match for o in outcomes if o.match is not None]


def test_every_set_point_gets_a_candidate_and_one_is_nominal(
    simulated_outcomes: list[Outcome],
) -> None:
    last = verdicts_of(simulated_outcomes)[-1]
    assert {c.name for c in last.candidates} >= {"50 °C", "70 °C", "30 °C"}
    assert last.nominal in {c.name for c in last.candidates}
    assert last.level is TrustLevel.TRUSTED


def test_the_nominal_twin_follows_the_whole_session(
    simulated_outcomes: list[Outcome], simulated_session: list[Sample]
) -> None:
    last = verdicts_of(simulated_outcomes)[-1]
    nominal = next(c for c in last.candidates if c.name == last.nominal)
    fit_y, fit_u = window_fit(
        nominal.parameters, Window.from_samples(simulated_session), TwinSettings().law
    )
    # The rig has a sink with mass, which the twin has not; the real rig's hours give 0.98 and 0.85.
    assert fit_y > 0.98
    assert fit_u > 0.85


def test_verdicts_are_consistent_in_themselves(
    simulated_outcomes: list[Outcome],
) -> None:
    judged = [v for v in verdicts_of(simulated_outcomes) if not v.stands]
    assert len(judged) >= 8
    for verdict in judged:
        matrix = np.array(verdict.nu_gap)
        assert np.array_equal(matrix, matrix.T)
        assert np.all(np.diag(matrix) == 0.0)
        assert np.all((matrix >= 0.0) & (matrix <= 1.0))
        family = verdict.modelled
        assert verdict.candidates[: len(family)] == family, (
            "matches first, other structures behind them"
        )
        assert matrix.shape == (len(verdict.candidates),) * 2
        sums = [c.nu_gap_sum for c in verdict.candidates]
        np.testing.assert_allclose(sums, matrix[: len(family)].sum(axis=0), rtol=1e-12)
        nominal = next(c for c in family if c.name == verdict.nominal)
        assert nominal.nu_gap_sum == min(sums[: len(family)])
        assert verdict.leader in {c.name for c in verdict.candidates}
        assert {c.name for c in verdict.candidates} <= {
            f.name for f in verdict.forecasts
        }
        for candidate in family:
            assert [o.order for o in candidate.orders] == [
                "22221",
                "33331",
                "44441",
                "55551",
            ]
            for order in candidate.orders:
                assert order.total.gain == order.y.gain + order.u.gain
                assert order.y.explanation <= 1.0


def test_late_matches_and_those_nobody_waits_for_change_nothing_but_the_time_of_the_verdict(
    simulated_session: list[Sample], simulated_outcomes: list[Outcome]
) -> None:
    """The matches are made of what is asked for, and come when they like: the last ones after the session.

    Nobody waits for one that comes twice, or of a window that was never asked for.
    """
    judge = Discriminator()
    settings = TwinSettings()
    lateness = cycle((1, 37, 250))
    session = simulated_session[:1000]
    outcomes = simulated_outcomes[:1000]
    reports = matches_of(outcomes)
    due: list[tuple[int, MatchReport]] = []
    verdicts: list[Verdict] = []

    def take(step: Step, sample: int) -> None:
        verdicts.extend(step.verdicts)
        if step.request is not None:
            report = next(m for m in reports if m.answers(step.request))
            assert repr(carry_out(step.request, settings)) == repr(report)
            due.append((sample + (next(lateness) if sample < 700 else 10_000), report))

    def answer(sample: int) -> None:
        report = due.pop(0)[1]
        request = judge.request
        assert judge.push_match(next(m for m in reports if m is not report)) == Step(
            (), None
        )
        assert judge.request is request
        step = judge.push_match(report)
        if step.request is None:
            assert judge.push_match(report) == Step((), None)
        take(step, sample)

    for sample in session:
        take(judge.push_sample(sample), sample.index)
        while due and due[0][0] <= sample.index:
            answer(sample.index)
    assert judge.request is not None
    while due:
        answer(session[-1].index)
    assert judge.request is None
    assert judge.settled == session[-1].index
    assert repr(verdicts) == repr(verdicts_of(outcomes))


def test_without_an_answer_everything_waits(simulated_session: list[Sample]) -> None:
    judge = Discriminator()
    asked = None
    for sample in simulated_session:
        step = judge.push_sample(sample)
        if asked is not None:
            assert step == Step((), None)
        asked = asked or step.request
    assert asked is not None
    assert judge.request is asked
    assert judge.settled == asked.sample - 1


def test_given_candidates_are_judged_on_the_first_window_that_moves(
    simulated_session: list[Sample],
) -> None:
    """One for a regime that the session never visits: no match takes its place."""
    rig = Peltier.model().parameters(
        seebeck=0.0825, conductance=0.35, heat_capacity=31.93
    )
    twin = Twin(given=[Candidate("paper 90 °C", 90.0, rig, None)])
    verdicts = [v for s in simulated_session[:420] for v in twin.push(s).verdicts]
    first = next(v for v in verdicts if not v.stands)
    candidate = next(c for c in first.candidates if c.name == "paper 90 °C")
    assert candidate.parameters == rig
    assert len(candidate.orders) == 4


def test_a_match_takes_the_place_of_a_candidate_given_for_its_regime(
    simulated_session: list[Sample],
) -> None:
    rig = Peltier.model().parameters(
        seebeck=0.0825, conductance=0.35, heat_capacity=31.93
    )
    twin = Twin(given=[Candidate("paper 50 °C", 50.0, rig, None)])
    verdicts = [v for s in simulated_session[:420] for v in twin.push(s).verdicts]
    assert {c.name for c in verdicts[-1].modelled} == {"50 °C"}


def drive_lost(lost_at: int, ticks: int, back_at: int | None = None) -> list[Sample]:
    """A run whose drive is lost, and may come back: the controller continues, the plate gets nothing."""
    rig = Peltier.model().parameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
    levels = (40.0, 70.0, 45.0, 80.0, 50.0, 75.0, 40.0, 70.0)
    noise = np.random.default_rng(5).normal(0.0, 0.1, ticks)
    pid = Controller(Peltier.loop)
    states = begin(rig, 22.85)
    samples = []
    for k in range(ticks):
        r = levels[(k // 200) % len(levels)]
        y = read(rig, states) + float(noise[k])
        u = pid.step(r, y)[0]
        samples.append(Sample(k, k * 10**9, r, y, u))
        states = advance(
            rig, states, 0.0 if lost_at <= k < (back_at or ticks) else u, 1.0
        )
    return samples


def test_a_lost_drive_is_reported_by_name_at_once_and_never_becomes_a_candidate() -> (
    None
):
    lost_at = 600
    twin = Twin()
    outcomes = [twin.push(s) for s in drive_lost(lost_at, 900)]
    verdicts = verdicts_of(outcomes)
    assert all(
        v.level in (TrustLevel.TRUSTED, TrustLevel.UNKNOWN)
        for v in verdicts
        if v.sample < lost_at
    )
    first_fault = next(v for v in verdicts if v.level is TrustLevel.FAULT)
    assert lost_at < first_fault.sample <= lost_at + 30
    assert first_fault.fault == "drive-lost"
    assert first_fault.fault_since is not None
    assert lost_at - 5 <= first_fault.fault_since <= first_fault.sample
    assert "drive" in first_fault.reason
    assert first_fault.nominal is not None
    assert all(
        v.level is TrustLevel.FAULT for v in verdicts if v.sample > first_fault.sample
    )
    assert all(c.last < first_fault.sample for c in verdicts[-1].candidates)


def test_a_drive_that_comes_back_is_reported_and_the_family_continues() -> None:
    lost_at = 610
    back_at = 660
    twin = Twin()
    verdicts = verdicts_of([twin.push(s) for s in drive_lost(lost_at, 1200, back_at)])
    levels = {v.sample: v.level for v in verdicts}
    assert TrustLevel.FAULT in {
        level for sample, level in levels.items() if lost_at < sample <= lost_at + 30
    }
    over = next(v for v in verdicts if "is over" in v.reason)
    assert back_at < over.sample <= back_at + 150
    assert over.fault == ""
    assert levels[max(levels)] is TrustLevel.TRUSTED
    alarm = twin.discriminator.monitor.alarms[0]
    for candidate in verdicts[-1].candidates:
        assert not alarm.overlaps(candidate.first, candidate.last), candidate.name


def test_who_was_matched_while_a_fault_already_showed_is_dismissed(
    simulated_session: list[Sample],
    simulated_outcomes: list[Outcome],
    judged_twin: Twin,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An alarm that begins in the past takes back what was admitted since."""
    verdicts = verdicts_of(simulated_outcomes)
    judge = judged_twin.discriminator
    monitor = judge.monitor
    newest = max(verdicts[-1].candidates, key=lambda c: c.last)
    last = simulated_session[-1]
    # A reading no plate can have, in a session whose index continues: the alarm starts at that very sample.
    broken = dataclasses.replace(last, index=last.index + 1, outputs=400.0)
    verdict = copied(judge).push_sample(broken).verdicts[-1]
    assert verdict.fault == "sensor-implausible"
    assert newest.name in {c.name for c in verdict.candidates}

    # The same alarm, reaching back into the newest candidate's window.
    def alarmed(sample: Sample, twin: Parameters | None) -> Health:
        health = type(monitor).push(monitor, sample, twin)
        if health.news is None:
            return health
        reaching_back = dataclasses.replace(
            health.news, first=newest.last - 3, spoils=True
        )
        return dataclasses.replace(health, news=reaching_back)

    monkeypatch.setattr(monitor, "push", alarmed)
    verdict = judge.push_sample(broken).verdicts[-1]
    assert newest.name not in {c.name for c in verdict.candidates}
    assert judge.nominal is not None
    assert judge.nominal.name != newest.name
    after = judge.push_sample(dataclasses.replace(broken, index=broken.index + 1))
    assert not after.verdicts
    assert after.request is None


def test_a_gap_in_the_samples_starts_the_windows_again(
    simulated_session: list[Sample],
) -> None:
    twin = Twin()
    with_gap = simulated_session[:500] + [
        dataclasses.replace(s, index=s.index + 1000) for s in simulated_session[500:900]
    ]
    outcomes = [twin.push(s) for s in with_gap]
    for report in matches_of(outcomes):
        first, last = report.match.samples
        assert last < 500 or first >= 1500
    assert matches_of(outcomes)


def test_before_anything_moves_nothing_is_known() -> None:
    still = Window(np.full(200, 50.0), np.full(200, 50.0), np.full(200, 90.0))
    twin = Twin()
    verdicts = [v for s in samples_of(still) for v in twin.push(s).verdicts]
    assert [v.level for v in verdicts] == [TrustLevel.UNKNOWN] * 3
    assert all(
        v.stands and v.nominal is None and math.isnan(v.driven_rms_y) for v in verdicts
    )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TwinSettings(most_candidates=0), "most_candidates is 0"),
        (lambda: TwinSettings(regime_width=0.0), "regime_width is 0.0; it must"),
        (lambda: TwinSettings(period=0.1), "give both the same period"),
        (lambda: TrustLimits(doubtful=0.0), "doubtful is 0.0; it must be positive"),
    ],
)
def test_settings_that_cannot_work_are_refused(make: object, message: str) -> None:
    with pytest.raises(TwinError, match=message):
        make()  # type: ignore[operator]
