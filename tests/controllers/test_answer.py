"""The answer: known truth is sorted rightly, and courses, figures and cycles are those of others."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest

from tests.support.exchanging import Heaters
from tests.support.plants import Lag
from twinmatch.controllers import (
    ControllerAnswer,
    ControllerDecision,
    ControllerError,
    ControllerQuestion,
    CourseFigure,
    FilteredPid,
    Holding,
    TriedTwin,
    WholeLoop,
    pid_law,
    try_controller,
)
from twinmatch.controllers.responses import run_law, step_figures, taken_by
from twinmatch.dynamics import (
    LinearLaw,
    Parameters,
    PlantError,
    TwoLevel,
    linearised,
    rest_at,
    simulate_driven,
)

LIMITS = {"low": -10.0, "high": 10.0}
HEATED = {"low": 0.0, "high": 100.0}
PI = pid_law(
    [FilteredPid(proportional=1.0, integral=0.2, back_calculation=0.5, **LIMITS)], 1.0
)
HOLDING = Holding(PI, 1.0, 60)
STEPS = np.repeat([[3.0], [5.0], [3.0]], 60, axis=0)
LAG = Lag.model().parameters()


def lag(name: str = "found", spread: float = 0.1, **values: float) -> TriedTwin:
    parameters = LAG.replace(**values)
    return TriedTwin(
        name,
        parameters,
        ("gain", "lag"),
        spread**2 * np.diag([parameters["gain"] ** 2, 0.01]),
    )


def tried(
    members: list[TriedTwin], law: LinearLaw | TwoLevel, **changes: object
) -> ControllerAnswer:
    question = {
        "law": law,
        "references": STEPS,
        "holding": HOLDING,
        "draws": 50,
        "before": np.array([3.0]),
    }
    question |= changes
    return try_controller(members, ControllerQuestion(**question))  # type: ignore[arg-type]


def limit_of(parameters: Parameters) -> float:
    """The gain from which proportional control is unstable: 1 − exp(−1/τ) per sample, u held."""
    pole = math.exp(-1.0 / parameters["lag"])
    return (1.0 + pole) / ((1.0 - pole) * parameters["gain"])


@pytest.mark.parametrize(
    ("share", "decision"),
    [
        (0.7, ControllerDecision.SAFE),
        (0.97, ControllerDecision.UNDECIDED),
        (1.5, ControllerDecision.FAILS),
    ],
)
def test_what_the_draws_leave_open_decides(
    share: float, decision: ControllerDecision
) -> None:
    """The limit is that of a first order, in closed form; of gain and lag only the gain is uncertain."""
    law = pid_law(
        [FilteredPid(proportional=share * limit_of(LAG), low=-1e6, high=1e6)], 1.0
    )
    answer = tried([lag(spread=0.08)], law, references=STEPS[:60])
    assert answer.decision is decision, answer.sentence
    stability = answer.stability[0]
    limits = np.array([limit_of(drawn_plant) for drawn_plant in stability.drawn])
    np.testing.assert_array_equal(
        stability.eigenvalues >= 1.0, share * limit_of(LAG) >= limits
    )
    assert stability.eigenvalue == pytest.approx(
        abs(math.exp(-0.2) - share * (1.0 + math.exp(-0.2))), rel=1e-6
    )
    if decision is ControllerDecision.UNDECIDED:
        assert answer.question is not None
        assert (
            answer.question.parameter,
            answer.question.drive,
            answer.question.step,
        ) == ("gain", "u", 2.0)
        assert answer.sentence.startswith("undecided: unstable in ")
        assert answer.sentence.endswith(
            "which this recording does not show: step u by 2 V"
        )


def test_one_twin_that_fails_is_named() -> None:
    law = pid_law(
        [FilteredPid(proportional=0.8 * limit_of(LAG), low=-1e6, high=1e6)], 1.0
    )
    answer = tried([lag("weak"), lag("strong", spread=0.01, gain=4.0)], law)
    assert answer.decision is ControllerDecision.FAILS
    assert answer.sentence.startswith(
        "fails on 1 of 2 twins, first on strong: its loop is unstable at "
    )


def test_it_hangs_on_the_exchange_and_on_the_heater_that_shows_it() -> None:
    """Two heaters; what is not known is how strongly the second one heats."""
    plant = Heaters.model().parameters()
    level = np.tile([45.0, 38.0], (60, 1))
    base = FilteredPid(
        proportional=4.0, integral=0.2, derivative=6.0, filter=4.0, low=0.0, high=100.0
    )
    plain = pid_law([base, base], 2.0)
    up = WholeLoop(linearised(plant, level[0], 2.0), plain).margins()[1].gain_up
    hot = FilteredPid(**{**{k: getattr(base, k) * up for k in ("proportional", "integral", "derivative")},
                         "filter": 4.0, "low": 0.0, "high": 100.0})  # fmt: skip
    member = TriedTwin("both", plant, ("loss", "second_gain"), np.diag([1e-8, 1e-6]))
    question = ControllerQuestion(
        pid_law([base, hot], 2.0), level, level[0], Holding(None, 2.0, 60), draws=40
    )
    answer = try_controller([member], question)
    assert answer.decision is ControllerDecision.UNDECIDED
    assert answer.question is not None
    assert (answer.question.parameter, answer.question.drive) == (
        "second_gain",
        "second_power",
    )


@pytest.mark.parametrize("declared", [{"safe": (-1.0, 5.2)}, {"span": (-1.0, 5.2)}])
def test_leaving_the_safe_range_or_without_one_the_span_fails(
    declared: dict[str, tuple[float, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Lag, "outputs", {"y": replace(Lag.y, **declared)})
    wild = pid_law([FilteredPid(proportional=1.0, integral=0.6, **LIMITS)], 1.0)
    answer = tried([lag(spread=0.001)], wild)
    assert answer.decision is ControllerDecision.FAILS
    assert answer.sentence == "fails on found: y leaves -1 to 5.2 m"
    note = "y has no declared safe range, so -1 to 5.2 m counts, its span" in " ".join(
        answer.notes
    )
    assert note is ("safe" not in declared)


def plain(
    pid: FilteredPid, references: np.ndarray, load: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """The lag of these tests under a PI, step by step, from rest at the first set-point; its drive takes -10
    to 10 V, whatever the law's limits. Outputs, and commands as the plant receives them, without the load."""
    decay = math.exp(-1.0 / LAG["lag"])
    gain = LAG["gain"]
    y = references[0]
    integral = references[0] / gain
    rows = []
    for r in references:
        wanted = pid.proportional * (r - y) + integral
        limited = min(max(wanted, pid.low), pid.high)
        integral += pid.integral * (r - y) + pid.back_calculation * (limited - wanted)
        rows.append((y, min(max(limited, -10.0), 10.0)))
        y = decay * y + (1.0 - decay) * gain * (rows[-1][1] + load)
    outputs, commands = np.array(rows).T
    return outputs, commands


FAR = np.repeat([3.0, 17.0, 3.0], 60)


@pytest.mark.parametrize(("back", "sound"), [(0.5, True), (-0.5, False)])
def test_a_law_that_does_not_come_back_from_its_limit_fails(
    back: float, sound: bool
) -> None:
    """Both loops have the same eigenvalues; one winds up where it should unwind."""
    pid = FilteredPid(proportional=2.0, integral=0.2, back_calculation=back, **LIMITS)
    outputs, commands = plain(pid, FAR)
    assert bool(abs(outputs[-1] - 3.0) < 0.1) is sound
    assert bool((np.abs(commands) == 10.0).mean() > 0.5) is not sound
    answer = tried([lag(spread=0.01)], pid_law([pid], 1.0), references=FAR[:, None])
    assert answer.stability[0].sound
    assert answer.decision is (
        ControllerDecision.SAFE if sound else ControllerDecision.FAILS
    )
    assert (
        "u is at a limit for the greater part of the time" in answer.sentence
    ) is not sound


@pytest.mark.parametrize(("level", "off", "on"), [(3.0, 0.0, 1.0), (-3.0, 1.0, 5.0)])
def test_two_levels_that_never_switch_fail(level: float, off: float, on: float) -> None:
    """Its hottest is 2 m/V · 1 V, below 3 m; its coldest 2 m, above -3 m."""
    law = TwoLevel(off, on, 0.4, 0.4)
    member = TriedTwin("found", LAG, ("lag",), np.array([[1e-6]]))
    answer = tried(
        [member], law, references=np.full((200, 1), level), before=np.array([level])
    )
    assert answer.decision is ControllerDecision.FAILS
    assert answer.sentence == "fails on found: it no longer switches"


def test_limits_wider_than_the_drives_are_the_drives_without_the_laws_knowledge() -> (
    None
):
    """Back-calculation sees the law's limit of 12 V, and the plant gets 10 V; a load comes behind both."""
    pid = FilteredPid(
        proportional=2.0, integral=0.2, back_calculation=0.5, low=-1000.0, high=12.0
    )
    law = taken_by(Lag, pid_law([pid], 1.0))
    start = linearised(LAG, 3.0, 1.0)
    for load in (0.0, 0.7):
        outputs, commands = plain(pid, FAR, load)
        assert commands.max() == 10.0
        run = run_law(
            LAG, law, FAR[:, None], start, before=FAR[:1], load=np.array([load])
        )
        # Runge–Kutta, one step a sample
        np.testing.assert_allclose(run.outputs[:, 0], outputs, atol=1e-5)
        np.testing.assert_allclose(run.inputs[:, 0], commands, atol=1e-5)
    answer = tried([lag(spread=0.001)], pid_law([pid], 1.0), references=FAR[:, None])
    note = "the law's limits of u, -1000 to 12 V, are wider than the drive's, -10 to 10: the drive limits its "
    assert any(answer_note.startswith(note) for answer_note in answer.notes)
    cost = answer.courses.figures[CourseFigure("mean squared error", "y", "m²")].median
    assert cost == pytest.approx(np.mean((plain(pid, FAR)[0] - FAR) ** 2), rel=0.02)


@pytest.mark.parametrize("gains", [(1.0, 0.2), (0.5, 0.05), (2.0, 0.0)])
def test_a_load_comes_upon_a_plant_at_rest(gains: tuple[float, float]) -> None:
    """Although the law that ran is too slow to bring it there; the plant's course is computed step by step. A
    law without integral action is not at its set-point before: only what the load changes counts."""
    pid = FilteredPid(proportional=gains[0], integral=gains[1], **LIMITS)
    slow = Holding(
        pid_law([FilteredPid(proportional=0.01, integral=0.001, **LIMITS)], 1.0),
        1.0,
        60,
    )
    exact = TriedTwin("exact", LAG)
    answer = tried([exact], pid_law([pid], 1.0), holding=slow)
    level = np.full(60, 3.0)
    moved = np.abs(plain(pid, level, 2.0)[0] - plain(pid, level)[0]).max()
    excursion = answer.courses.figures[CourseFigure("excursion after a load", "y", "m")]
    assert excursion.median == pytest.approx(moved, rel=1e-6)


def test_the_course_under_a_load_is_that_of_the_plant_driven_with_it() -> None:
    """Commands as the law gives them, and a plant that receives them plus the load; limits and windup too."""
    start = linearised(LAG, 3.0, 1.0)
    reference = np.repeat([[3.0], [17.0], [2.0]], 40, axis=0)
    run = run_law(LAG, PI, reference, start, before=reference[0], load=np.array([0.7]))
    assert run.inputs.max() == 10.0
    driven = simulate_driven(LAG, run.inputs + 0.7, states=start.rest.states)
    np.testing.assert_allclose(run.outputs, driven.outputs, atol=1e-9)
    still = run_law(LAG, PI, reference[:40], start, before=reference[0])
    np.testing.assert_allclose(still.outputs, 3.0, atol=1e-9)
    stepped = run_law(LAG, PI, reference[40:80], start, before=reference[0])
    # a step at the first sample is a step: 1.5 V + 14 m · 1 V/m, limited
    assert stepped.inputs[0, 0] == 10.0


def test_overshoot_and_settling_are_those_of_python_control() -> None:
    system = control.tf([1.0], [25.0, 4.0, 1.0])
    time = np.linspace(0.0, 199.9, 2000)
    _, y = control.step_response(system, time)
    theirs = control.step_info(system, time, SettlingTimeThreshold=0.05)
    reference = np.concatenate([np.zeros(10), np.full(2000, 2.0)])
    figures = step_figures(reference, np.concatenate([np.zeros(10), 2.0 * y]), 0.0, 0.1)
    assert figures.overshoot == pytest.approx(
        2.0 * theirs["Overshoot"] / 100.0, rel=1e-3
    )
    assert figures.settling == pytest.approx(theirs["SettlingTime"], abs=0.2)


def test_two_levels_cycle_as_a_first_order_does() -> None:
    """The period of a relay with hysteresis around a first order, in closed form; sampling adds a sample at
    each switch."""
    period = 0.1
    slow = 40.0
    law = TwoLevel(0.0, 5.0, 0.4, 0.4, period=period)
    member = TriedTwin("slow", LAG.replace(lag=slow), ("lag",), np.array([[1e-6]]))
    level = np.full((3000, 1), 3.0)
    answer = tried(
        [member], law, references=level, holding=Holding(None, period, 600), draws=25
    )
    low = 2.6
    high = 3.4
    top = 10.0
    exact = slow * (math.log((top - low) / (top - high)) + math.log(high / low))
    assert answer.decision is ControllerDecision.SAFE
    assert answer.courses.figures[
        CourseFigure("cycle", "", "s")
    ].median == pytest.approx(exact, abs=3 * period)
    rate = answer.courses.figures[CourseFigure("switchings an hour", "", "")].median
    assert rate == pytest.approx(2 * 3600.0 / exact, rel=0.03)


def test_bands_are_of_the_draws_and_beside_the_law_that_ran() -> None:
    answer = tried(
        [lag()], pid_law([FilteredPid(proportional=2.0, integral=0.4, **LIMITS)], 1.0)
    )
    error = CourseFigure("mean squared error", "y", "m²")
    values = answer.courses.values[error]
    figure = answer.courses.figures[error]
    assert np.mean((values >= figure.low) & (values <= figure.high)) == pytest.approx(
        0.9, abs=0.05
    )
    assert answer.running is not None
    # twice the gains follow faster
    assert figure.median < answer.running.figures[error].median
    assert (answer.courses.outputs[0] <= answer.courses.outputs[2]).all()
    repeated = tried(
        [lag()], pid_law([FilteredPid(proportional=2.0, integral=0.4, **LIMITS)], 1.0)
    )
    np.testing.assert_array_equal(repeated.courses.outputs, answer.courses.outputs)


def test_a_twin_that_cannot_be_held_is_left_out_with_the_reason() -> None:
    answer = tried([lag(), lag("dull", gain=0.2)], PI)
    assert answer.members == ("found",)
    assert answer.notes[0] == (
        "dull is left out: Lag, lag: it is not held at 5 m within the limits of its drives"
    )
    with pytest.raises(
        ControllerError, match=r"none of the twins can be held there; dull is left out"
    ):
        tried([lag("dull", gain=0.2)], PI)
    with pytest.raises(ControllerError, match="there is no twin"):
        tried([], PI)


def test_a_draw_that_cannot_be_held_says_nothing() -> None:
    """It is not unstable: with less than half of the gain no command reaches the level."""
    wide = TriedTwin("wide", LAG.replace(gain=0.7), ("gain",), np.array([[0.04]]))
    answer = tried([wide], PI)
    stability = answer.stability[0]
    assert 5 < len(stability.drawn) < 50
    assert (
        min(drawn_plant["gain"] for drawn_plant in stability.drawn) > 0.29
    )  # 3 m need 0.3 m/V at 10 V, which the loop only approaches
    assert stability.unstable == 0.0
    assert answer.decision is ControllerDecision.SAFE


def test_draws_have_the_covariance_and_are_possible() -> None:
    spread = np.array([[0.04, 0.06], [0.06, 0.25]])
    drawn = TriedTwin("one", LAG, ("gain", "lag"), spread).drawn(2000, seed=3)
    rows = np.array(
        [[drawn_plant["gain"], drawn_plant["lag"]] for drawn_plant in drawn]
    )
    np.testing.assert_allclose(np.cov(rows.T), spread, atol=0.02)
    wide = TriedTwin("two", LAG, ("gain",), np.array([[100.0]])).drawn(50, seed=3)
    assert len(wide) == 50
    assert min(drawn_plant["gain"] for drawn_plant in wide) > 0.0
    assert TriedTwin("exact", LAG).drawn(50, seed=3) == [LAG]


def test_two_levels_that_ran_hold_nothing_at_rest() -> None:
    assert Holding(TwoLevel(0.0, 5.0, 0.4, 0.4), 1.0, 60).linear(
        LAG, [3.0]
    ).rest.input == pytest.approx(1.5)
    with pytest.raises(PlantError):
        HOLDING.linear(LAG, [25.0])
    assert rest_at(LAG, 3.0).input == pytest.approx(
        HOLDING.linear(LAG, [3.0]).rest.input, rel=1e-4
    )
