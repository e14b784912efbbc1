"""A lost sample costs a sample: the twin runs on through it, and nothing counts what nobody saw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import Verdict
from twinmatch.fitting import match
from twinmatch.forecasting import StateFilter
from twinmatch.nodes.messages import message_of, record_of
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, SignalError, Window
from twinmatch.twin import MatchRequest, Outcome, Twin, TwinSettings
from twinmatch.twin.door import filled
from twinmatch.twin.gaps import GapFiller
from twinmatch.twin.mirror import Mirror

LONGEST = TwinSettings().schedule.gap
STEPS = (200, 400, 600, 800, 1000, 1200, 1400, 1600, 1800)
"""Samples of the session at which the set-point moves."""


def outcomes_of(samples: list[Sample]) -> list[Outcome]:
    twin = Twin()
    return [twin.push(sample) for sample in samples]


def verdicts_of(outcomes: list[Outcome]) -> list[Verdict]:
    return [verdict for outcome in outcomes for verdict in outcome.verdicts]


def windows_of(outcomes: list[Outcome]) -> list[tuple[int, int, int]]:
    return [(v.sample, v.first, v.last) for v in verdicts_of(outcomes)]


def stand_ins(before: Sample, after: Sample, longest: int = LONGEST) -> list[Sample]:
    """Those for the samples between two, where the loop is not known."""
    filler = GapFiller(None, longest)
    assert filler.take(before) == [before]
    *lost, last = filler.take(after)
    assert last == after
    return lost


@given(
    first=st.integers(0, 10**6),
    missing=st.integers(0, 12),
    y=st.floats(-50, 150),
    after=st.floats(-50, 150),
)
def test_stand_ins_fill_a_short_gap_and_say_what_they_are(
    first: int, missing: int, y: float, after: float
) -> None:
    before = Sample(first, 10**9 * first, 30.0, y, 12.0, (1.0,))
    next_sample = Sample(
        first + missing + 1, 10**9 * (first + missing + 1), 40.0, after, 13.0, (2.0,)
    )
    filled = stand_ins(before, next_sample)
    if missing > LONGEST:
        assert filled == []
        return
    assert [s.index for s in filled] == list(range(before.index + 1, next_sample.index))
    assert [s.stamp for s in filled] == [10**9 * s.index for s in filled]
    assert not any(s.seen for s in filled)
    assert all(
        (s.reference, s.input, s.disturbances) == (30.0, 12.0, (1.0,)) for s in filled
    )
    levels = [y, *(s.output for s in filled), after]
    np.testing.assert_allclose(np.diff(levels), (after - y) / (missing + 1), atol=1e-9)


def test_a_stand_in_has_all_signals_of_a_plant_with_several() -> None:
    before = Sample(3, 3, (1.0, 2.0), (3.5, 4.0), (5.0,))
    filled = stand_ins(before, Sample(5, 5, (1.0, 2.0), (7.5, 2.0), (6.0,)))
    assert filled == [Sample(4, 4, (1.0, 2.0), (5.5, 3.0), (5.0,), seen=False)]


@pytest.mark.parametrize("length", [1, 2, 3])
def test_the_law_says_when_a_set_point_moved_that_nobody_saw(
    length: int, simulated_session: list[Sample]
) -> None:
    """At a set-point step a PID's command jumps by many times what the noise of a reading makes of it."""
    for step in STEPS[:4]:
        for begin in range(step - length + 1, step + 1):
            filler = GapFiller(TwinSettings().law, LONGEST)
            for sample in simulated_session[begin - 100 : begin]:
                assert filler.take(sample) == [sample]
            *lost, _ = filler.take(simulated_session[begin + length])
            true = simulated_session[begin : begin + length]
            assert [s.index for s in lost] == [s.index for s in true]
            misplaced = sum(
                a.reference != b.reference for a, b in zip(lost, true, strict=True)
            )
            # of three, nobody saw most of what the step did
            assert misplaced <= length // 3
            true_inputs = np.array([s.input for s in true])
            filled_error = np.linalg.norm(true_inputs - [s.input for s in lost])
            held_error = np.linalg.norm(
                true_inputs - simulated_session[begin - 1].input
            )
            assert misplaced or filled_error < 0.5 * held_error
            assert not any(s.seen for s in lost)


def test_steps_that_fall_into_gaps_on_the_rig_are_found(
    recorded_hour: Callable[[int], Window],
) -> None:
    """And a lost input is a third as wrong as a held one, all of the seven hours' steps taken together."""
    placed = []
    filled_errors = []
    held_errors = []
    for number in (1, 2, 5, 9, 14, 20, 27):
        samples = samples_of(recorded_hour(number))
        steps = [
            k
            for k in range(61, len(samples) - 3)
            if samples[k].reference != samples[k - 1].reference
        ]
        for first, length in (
            (k - early, early + late)
            for k in steps
            for early in (0, 1)
            for late in (1, 2)
        ):
            filler = GapFiller(TwinSettings().law, LONGEST)
            for sample in samples[max(first - 80, 0) : first]:
                filler.take(sample)
            *lost, _ = filler.take(samples[first + length])
            true = samples[first : first + length]
            placed.append([s.reference for s in lost] == [s.reference for s in true])
            filled_errors += [
                a.input - b.input for a, b in zip(lost, true, strict=True)
            ]
            held_errors += [samples[first - 1].input - s.input for s in true]
    assert len(placed) > 200
    assert np.mean(placed) > 0.95
    assert np.linalg.norm(filled_errors) < np.linalg.norm(held_errors) / 3


def test_nothing_fills_a_gap_behind_a_clock_that_was_set_back() -> None:
    sample = Sample(10, 0, 30.0, 30.0, 0.0)
    for index in (9, 10, 11):
        assert stand_ins(sample, replace(sample, index=index, stamp=1)) == []
    for stamp, count in ((-1, 0), (0, 0), (1, 1)):
        assert len(stand_ins(sample, replace(sample, index=12, stamp=stamp))) == count


def test_samples_lost_at_random_change_little_and_restart_nothing(
    simulated_session: list[Sample], simulated_outcomes: list[Outcome]
) -> None:
    """Two in a hundred are lost, one to three in a row: same windows, same matches, nearly the same numbers.

    Set-point steps may be among them.
    """
    rng = np.random.default_rng(4)
    session = simulated_session[:1300]
    outcomes_of_all = simulated_outcomes[:1300]
    lost: set[int] = set()
    for begin in rng.choice(len(session) - 10, len(session) // 100, replace=False):
        lost |= set(range(int(begin) + 1, int(begin) + 1 + int(rng.integers(1, 4))))
    lost |= {STEPS[2], STEPS[5]}
    assert len(lost) > 20
    outcomes = outcomes_of([s for s in session if s.index not in lost])
    assert windows_of(outcomes) == windows_of(outcomes_of_all)
    for verdict, whole in zip(
        verdicts_of(outcomes), verdicts_of(outcomes_of_all), strict=True
    ):
        assert (verdict.match, verdict.level) == (whole.match, whole.level)
        assert {c.name for c in verdict.modelled} == {c.name for c in whole.modelled}
    last = verdicts_of(outcomes)[-1]
    whole = verdicts_of(outcomes_of_all)[-1]
    assert abs(last.inside_y - whole.inside_y) < 0.1
    whole_parameters = {c.name: c.parameters for c in whole.modelled}
    for candidate in last.modelled:
        for name, value in candidate.parameters.items():
            # Two in a hundred samples fewer shift an estimate by a part of its standard error, 1 to 5 % here.
            scale = candidate.parameters.model.declared[name].scale
            assert value == pytest.approx(
                whole_parameters[candidate.name][name], abs=0.05 * scale
            )


def test_a_step_that_falls_into_a_gap_ends_the_same_window(
    simulated_session: list[Sample],
) -> None:
    step = STEPS[1]
    samples = simulated_session[: step + 70]
    received = [s for s in samples if s.index not in {step, step + 1}]
    whole = windows_of(outcomes_of(samples))
    late = windows_of(outcomes_of(received))
    assert [last for _, _, last in whole if last == step - 1]
    assert late == whole


def test_behind_a_long_gap_windows_start_over(simulated_session: list[Sample]) -> None:
    def oldest_behind(missing: int) -> int:
        received = [s for s in simulated_session if not 300 <= s.index < 300 + missing]
        return min(
            v.first for v in verdicts_of(outcomes_of(received[:420])) if v.sample > 310
        )

    assert oldest_behind(LONGEST) < 300
    assert oldest_behind(LONGEST + 1) == 300 + LONGEST + 1


def test_what_stands_in_for_a_reading_is_not_fitted(
    simulated_session: list[Sample],
) -> None:
    """The values in its place may be anything: the parameters are the same to the last bit."""
    samples = simulated_session[:400]
    lost = {50, 51, 180, 181, 182, 300}
    matches = []
    for wrong in (0.0, 25.0):
        window = Window.from_samples(
            [
                replace(s, outputs=s.output + wrong, seen=False)
                if s.index in lost
                else s
                for s in samples
            ]
        )
        matches.append(match(window, start=Peltier.model().parameters()))
    assert matches[0].accepted
    assert matches[0].parameters == matches[1].parameters
    np.testing.assert_array_equal(matches[0].covariance, matches[1].covariance)
    assert matches[0].chi2 == matches[1].chi2
    whole = match(Window.from_samples(samples), start=Peltier.model().parameters())
    assert matches[0].chi2 == pytest.approx(whole.chi2, rel=0.05)


def test_a_window_with_too_few_samples_is_not_matched(
    simulated_session: list[Sample],
) -> None:
    window = Window.from_samples(
        [replace(s, seen=s.index % 8 != 3) for s in simulated_session[:400]]
    )
    assert window.share_seen == 0.875
    refused_match = match(window, start=Peltier.model().parameters())
    assert not refused_match.accepted
    assert (
        refused_match.reason
        == "only 88% of the window's samples were received; a match needs 90%"
    )


def test_a_filter_runs_through_a_lost_sample_and_knows_less(
    simulated_session: list[Sample],
) -> None:
    whole, without = (StateFilter(Peltier.model().typical(), 1.0) for _ in range(2))
    for sample in simulated_session[:100]:
        whole.push(sample)
        without.push(sample)
    sample = simulated_session[100]
    whole.push(sample)
    without.push(replace(sample, outputs=sample.output + 40.0, seen=False))
    assert np.trace(without.joint) > np.trace(whole.joint)
    # What a reading teaches in one second is a fraction of its noise of 0.1 K.
    np.testing.assert_allclose(without.states, whole.states, atol=0.2)


def test_the_mirrored_twins_run_through(simulated_session: list[Sample]) -> None:
    start = Peltier.model().typical()
    samples = simulated_session[:301]
    received = [sample for sample in samples if sample.index not in {250, 251}]
    last_states = []
    for settled in (samples, filled(received, TwinSettings()), received):
        mirror = Mirror(start)
        last_states.append([mirror.push(sample) for sample in settled][-1])
    whole, through, restarted = last_states
    # Held inputs differ from the real ones for two of 300 samples; a restart takes the twin to the reading.
    assert abs(through.closed_output[0] - whole.closed_output[0]) < 0.05
    assert abs(through.driven_output[0] - whole.driven_output[0]) < 0.05
    assert abs(restarted.driven_output[0] - whole.driven_output[0]) > abs(
        through.driven_output[0] - whole.driven_output[0]
    )


def test_a_window_says_what_it_holds_wherever_it_goes(
    simulated_session: list[Sample],
) -> None:
    samples = [replace(s, seen=s.index not in {5, 6}) for s in simulated_session[:20]]
    window = Window.from_samples(samples)
    assert window.share_seen == 0.9
    assert window.part(6, 9).seen is not None
    assert window.part(7, 9).seen is None
    start = Peltier.model().parameters()
    request = MatchRequest(19, 30.0, window, start, None)
    decoded = record_of(message_of(request, 0))
    np.testing.assert_array_equal(decoded.window.seen, window.seen)
    message = message_of(request, 0)
    message.lost = [99]
    with pytest.raises(
        SignalError, match=r"lost samples \[99\] lie outside its window of 20 samples"
    ):
        record_of(message)
    with pytest.raises(
        SignalError, match=r"seen has shape \(2,\); give one truth value for each of 20"
    ):
        replace(window, seen=np.array([True, False]))
