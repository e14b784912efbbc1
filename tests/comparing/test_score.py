"""Models of a window and what the criteria say of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.comparing import (
    Candidate,
    CandidateScore,
    DiscriminationError,
    GraphSymbol,
    LoopConditions,
    OrderScore,
    bic,
    choose_order,
    code_length,
    common_order,
    identify,
    judge_uncertainty,
    loop_controller,
    mdl,
    naic,
    nu_gap,
    plant_gaps,
    score,
    spans_of,
    stability_margin,
    twin_response,
)
from twinmatch.comparing.certainty import Certainty
from twinmatch.comparing.criteria import Criteria
from twinmatch.comparing.margin import loop_plant
from twinmatch.comparing.models import ahead, deviations, operating_level
from twinmatch.comparing.plant_gap import PlantGaps
from twinmatch.comparing.uncertainty import (
    directions,
    disturbed_pair,
    estimates,
    failing_draws,
    family_uncertainty,
    fitting_scales,
    turn,
)
from twinmatch.dynamics import Parameters, PidGains, begin, law_of, simulate_closed_loop
from twinmatch.fitting import FittingError
from twinmatch.plants import Peltier
from twinmatch.signals import KELVIN, Window

MODEL = Peltier.model()
RIG = MODEL.parameters(seebeck=0.06, conductance=0.6, heat_capacity=28.0)
REFERENCE = np.repeat([30.0, 50.0, 70.0], [60, 120, 150])


def measured(rig: Parameters = RIG, seed: int = 1) -> Window:
    sensor = Peltier.sensor.realise(len(REFERENCE), 1.0, seed)
    run = simulate_closed_loop(rig, REFERENCE, states=begin(rig, 30.0), sensor=sensor)
    return Window(REFERENCE, run.output, run.input)


def entry(order: str, gain: int, *criteria: float) -> OrderScore:
    c = Criteria(1000, 1000 - gain, gain, gain / 1000, *criteria)
    return OrderScore(order, c, c, c)


def test_totals_are_sums_as_in_the_papers_table() -> None:
    """50 °C, order 22221 of the paper: 1069 + 129 = 1198, 0.78 + 0.80 = 1.58, 1283.65 + 1290.03 = 2573.68."""
    y = Criteria(2048, 979, 1069, 1069 / 2048, 0.78, 1283.65, 2.52)
    u = Criteria(1622, 1493, 129, 129 / 1622, 0.80, 1290.03, 2.52)
    total = y + u
    assert (total.trivial_length, total.model_length, total.gain) == (3670, 2472, 1198)
    assert total.naic == pytest.approx(1.58)
    assert total.bic == pytest.approx(2573.68)
    assert total.explanation == pytest.approx(1198 / 3670)


def test_the_order_most_criteria_prefer_is_chosen() -> None:
    scores = [
        entry("22221", 500, 1.0, 900.0, 5.0),
        entry("33331", 700, 1.5, 950.0, 6.0),
    ]
    assert choose_order(scores) == "22221"
    # two each
    assert choose_order([entry("22221", 500, 2.0, 900.0, 5.0), scores[1]]) == "22221"
    assert common_order(["33331", "22221", "33331"]) == "33331"
    assert common_order(["44441", "22221"]) == "22221"


def test_deviations_begin_at_rest() -> None:
    window = measured()
    level = operating_level(window)
    r, y, u = deviations(window, level)
    assert r[0] == 0.0
    assert abs(np.mean(y[40:60])) < 0.2  # the loop is at rest before the step
    assert abs(np.mean(u[40:60])) < 1e-9
    np.testing.assert_array_equal(ahead(np.array([1.0, 2.0, 3.0])), [2.0, 3.0, 3.0])


@pytest.mark.parametrize("lead", [5, 20, 40])
def test_the_level_is_that_of_as_many_samples_as_the_schedule_leads_by(
    lead: int,
) -> None:
    window = measured()
    assert operating_level(window, lead=lead).input == np.mean(
        window.input[60 - lead : 60]
    )
    driven = operating_level(
        Window(window.reference, window.output, window.reference),
        driven=True,
        lead=lead,
    )
    assert driven.output == np.mean(window.output[60 - lead : 60])
    model = identify(window, ["22221"], lead=lead)[0]
    assert model.lead == lead
    _, _, u = deviations(window, operating_level(window, lead=lead))
    errors = model.u.prediction_errors(ahead(window.reference - 30.0), u)
    loss = float(np.mean(errors**2))
    assert score(model, window, absolute=KELVIN).u.mdl == mdl(
        loss, model.u.n_parameters, len(window)
    )


def test_models_of_the_loop_have_its_gain_and_its_poles_inside() -> None:
    for model in identify(measured()):
        for part in (model.y, model.u):
            assert np.all(np.abs(np.roots(part.F)) < 1.0)
        # Integral action: at rest the temperature is the set-point.
        assert np.sum(model.y.B) / np.sum(model.y.F) == pytest.approx(1.0, abs=0.02)


def test_more_noise_free_information_is_explained_by_the_right_model_than_by_a_wrong_one() -> (
    None
):
    window = measured()
    right_model = identify(window)[0]
    wrong_model = identify(
        measured(MODEL.parameters(seebeck=0.03, conductance=0.6, heat_capacity=60.0))
    )[0]
    right = score(right_model, window, absolute=KELVIN)
    wrong = score(wrong_model, window, absolute=KELVIN)
    assert right.y.gain > wrong.y.gain
    assert right.y.naic < wrong.y.naic
    assert 0.0 < right.y.explanation < 1.0


def test_lengths_are_those_of_the_tables() -> None:
    window = measured()
    scored = score(identify(window)[0], window, decimals=1, absolute=KELVIN)
    assert scored.y.trivial_length == code_length(window.output + KELVIN, 1) + 15
    assert scored.u.trivial_length == code_length(window.input, 1) + 15
    assert scored.total.gain == scored.y.gain + scored.u.gain


def test_the_gap_of_a_twin_to_its_own_plant_is_small_and_to_another_large() -> None:
    window = measured()
    plant = identify(window)[0]
    gains = Peltier.loop
    sensor = Peltier.sensor
    near = identify(twin_response(RIG, window, gains, sensor, seed=7))[0]
    far_rig = MODEL.parameters(seebeck=0.15, conductance=0.2, heat_capacity=20.0)
    far = identify(twin_response(far_rig, window, gains, sensor, seed=7))[0]
    assert nu_gap(near.symbol, plant.symbol) < 0.1
    assert nu_gap(far.symbol, plant.symbol) > 2 * nu_gap(near.symbol, plant.symbol)


def test_the_control_model_has_the_kick_of_the_same_tick() -> None:
    """The symbol's [u/r] starts without delay, the one identified with nk = 1 does not."""
    model = identify(measured())[0]
    assert model.u.B[0] == 0.0
    # PWM per °C, the proportional kick clipped by the driver
    assert abs(model.u.B[1]) > 1.0


def test_the_twin_response_repeats_with_its_seed_only() -> None:
    runs = [
        twin_response(RIG, measured(), Peltier.loop, Peltier.sensor, seed).output
        for seed in (5, 5, 6)
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_a_window_that_does_not_move_identifies_nothing() -> None:
    still = Window(np.full(200, 50.0), np.full(200, 50.0), np.full(200, 90.0))
    with pytest.raises(FittingError, match="is constant"):
        identify(still)


def test_criteria_are_those_that_another_program_prints() -> None:
    """N = 300, six parameters, V = 1.6575: the figures MathWorks prints, to their last digit."""
    assert naic(1.6575, 6, 300) == pytest.approx(0.5453, abs=5e-5)
    assert bic(1.6575, 6, 300) == pytest.approx(1037.2, abs=0.05)


def test_a_perfect_prediction_beats_any_penalty() -> None:
    assert naic(0.0, 30, 100) == -math.inf
    assert bic(0.0, 30, 100) == -math.inf
    assert mdl(0.0, 30, 100) == 0.0


@given(st.floats(1e-6, 1e6), st.integers(0, 60), st.integers(8, 10_000))
def test_more_parameters_for_the_same_loss_never_help(
    v: float, n_p: int, n: int
) -> None:
    for criterion in (naic, bic, mdl):
        assert criterion(v, n_p + 1, n) > criterion(v, n_p, n)
        assert criterion(v * 1.01, n_p, n) > criterion(v, n_p, n)


@pytest.mark.parametrize("criterion", [naic, bic, mdl])
@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf])
def test_an_impossible_loss_is_refused(
    criterion: Callable[..., float], bad: float
) -> None:
    with pytest.raises(DiscriminationError, match=f"the loss is {bad}"):
        criterion(bad, 3, 100)


@pytest.mark.parametrize(("parameters", "samples"), [(3, 0), (-1, 10)])
def test_impossible_counts_are_refused(parameters: int, samples: int) -> None:
    with pytest.raises(
        DiscriminationError, match=f"{parameters} parameters and {samples} samples"
    ):
        naic(1.0, parameters, samples)


# The kernels behind the intervals, against the formulas they stand for.

Responses = np.ndarray


def responses(rng: np.random.Generator, *shape: int) -> Responses:
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def chordal(p1: Responses, p2: Responses) -> np.ndarray:
    """√(1 − |1 + P2* P1|²/(1 + |P1|²)(1 + |P2|²))."""
    sizes = (1 + np.abs(p1) ** 2) * (1 + np.abs(p2) ** 2)
    return np.sqrt(1 - np.abs(1 + p1 * p2.conj()) ** 2 / sizes)


@given(st.integers(0, 10**9))
def test_at_scale_one_the_estimates_are_the_disturbed_models_distances(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    p1 = responses(rng, 6)
    p2 = responses(rng, 6)
    m1 = p1 + 0.2 * responses(rng, 4, 6)
    m2 = p2 + 0.2 * responses(rng, 4, 6)
    still = directions(np.array([p1, p2]))
    a, b, c = disturbed_pair(still[0], still[1], directions(m1), directions(m2))
    np.testing.assert_allclose(np.sqrt(a), chordal(p1, p2), rtol=1e-9)
    distances = estimates(np.array([0]), a[None], b[None], c[None], 1.0)
    np.testing.assert_allclose(distances, chordal(m1, m2).max(axis=1), rtol=1e-9)


@pytest.mark.parametrize("seed", range(40))
def test_the_winding_condition_on_a_grid_agrees_with_the_exact_gap(seed: int) -> None:
    """As the exact ν-gap decides it: equal to 1 or not."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(0, np.pi, 2000)
    z = np.exp(1j * angles)
    symbols = []
    columns = []
    for _ in range(2):
        d = np.poly(rng.uniform(-0.9, 0.95, 2))
        n = rng.normal(0, 1.5, 2)
        symbols.append(GraphSymbol.of_polynomials(d, [n], 1.0))
        columns.append(np.polyval(n, z) / np.polyval(d, z))
    still = directions(np.array(columns))
    expected = nu_gap(*symbols) == 1.0
    assert (abs(turn(still[0], still[1])) > 0.5 * np.pi) == expected
    moved = still[:, None].copy()
    a, _, c = disturbed_pair(still[0], still[1], moved[0], moved[1])
    pair = (still[0], still[1]), (moved[0], moved[1])
    assert failing_draws(a, c, *pair, np.array([expected])).tolist() == [expected]


def test_a_draw_that_takes_one_point_through_zero_fails_there() -> None:
    """Two lags of gain 2 are near each other at both points; a draw turns one of them round at the second."""
    z = np.exp(1j * np.linspace(0, np.pi, 400))
    lag = 0.2 / (z - 0.9)
    near = np.concatenate([lag, lag])
    far = np.concatenate([lag, -lag])
    first, second = directions(np.array([near, 1.1 * near]))
    moved = (
        directions(np.array([near, near])),
        directions(np.array([1.1 * near, 1.1 * far])),
    )
    a, _, c = disturbed_pair(first, second, *moved)
    assert failing_draws(
        a, c, (first, second), moved, np.zeros(2, dtype=bool)
    ).tolist() == [False, True]
    # and where it had failed without the draws, that draw makes it whole
    across = directions(np.array([1.1 * far]))[0]
    a, _, c = disturbed_pair(first, across, *moved)
    failed = np.array([False, True])
    assert failing_draws(a, c, (first, across), moved, failed).tolist() == [False, True]


def test_fitting_scales_are_the_quantiles_of_a_known_spread() -> None:
    """One frequency, |t·v + e| with v = 0.5 and real e: t·v = 0.5 − e at its own quantiles."""
    e = np.linspace(-0.2, 0.2, 1001)
    a = np.array([[0.25]])
    b = (2 * 0.5 * e).reshape(1, 1, -1)
    c = (e**2).reshape(1, 1, -1)
    least, most = fitting_scales(np.array([0]), a, b, c, 0.05)
    assert 0.5 * least == pytest.approx(0.5 - 0.18, abs=2e-3)
    assert 0.5 * most == pytest.approx(0.5 + 0.18, abs=2e-3)


def test_what_noise_alone_explains_may_be_nothing() -> None:
    rng = np.random.default_rng(3)
    e = 0.1 * (rng.normal(size=(1, 400, 20)) + 1j * rng.normal(size=(1, 400, 20)))
    # In the order of the arrays that twins give, or kernels would be compiled for another one.
    moved = np.ascontiguousarray(np.swapaxes(e, 1, 2))
    may_be_equal = []
    for _ in range(60):
        # estimated: noise again
        v = 0.1 * (rng.normal(size=(1, 20)) + 1j * rng.normal(size=(1, 20)))
        a = np.abs(v) ** 2
        b = 2 * (v.conj()[:, :, None] * moved).real
        c = np.abs(moved) ** 2
        least, most = fitting_scales(np.array([0]), a, b, c, 0.05)
        may_be_equal.append(least == 0.0)
        assert most < 3.0
    assert 0.85 <= np.mean(may_be_equal) < 1.0


# How certain a verdict is, on twins of simulated rigs.

POINTS = (30.0, 50.0, 70.0, 90.0)
RIGS = {
    "50 °C": MODEL.parameters(seebeck=0.060, conductance=0.60, heat_capacity=28.0),
    "70 °C": MODEL.parameters(seebeck=0.055, conductance=0.55, heat_capacity=28.0),
    "90 °C": MODEL.parameters(seebeck=0.065, conductance=0.50, heat_capacity=22.0),
}
TERMS = LoopConditions(law_of(Peltier, 1.0), spans_of(Peltier))
COVARIANCE = np.diag([0.002, 0.03, 0.8]) ** 2
"""Of Seebeck coefficient, conductance and heat capacity, as a good window leaves them."""


def scored(
    name: str, rig: Parameters, operating_point: float | None = None
) -> CandidateScore:
    point = (
        float(name.split(maxsplit=1)[0]) if operating_point is None else operating_point
    )
    return CandidateScore(name, point, rig, 0, 100, (), "22221", 0.1, None, 0.1)


def twins(factor: float = 1.0) -> list[Candidate]:
    free = MODEL.structure.free
    return [
        Candidate(name, 0.0, rig, None, free, factor * COVARIANCE)
        for name, rig in RIGS.items()
    ]


def gaps(family: list[Candidate]) -> PlantGaps:
    return plant_gaps([t.parameters for t in family], POINTS, TERMS)


def judged(
    nominal: str = "70 °C",
    factor: float = 1.0,
    gains: PidGains | None = None,
    family: int = 3,
) -> Certainty:
    candidates = [scored(name, rig) for name, rig in RIGS.items()][:family]
    terms = TERMS if gains is None else TERMS._replace(law=gains)
    members = twins(factor)[:family]
    return judge_uncertainty(candidates, members, gaps(members), nominal, terms)


def smallest_sum() -> str:
    return list(RIGS)[int(np.argmin(gaps(twins()).matrix.sum(axis=0)))]


def test_every_field_is_filled_with_what_its_source_says() -> None:
    judgement = judged()
    uncertainty = family_uncertainty(twins(), gaps(twins()), TERMS)
    nominal = loop_plant(RIGS["70 °C"], 70.0)
    controller = loop_controller(law_of(Peltier, 1.0))
    for k, (candidate, rig) in enumerate(
        zip(judgement.candidates, RIGS.values(), strict=True)
    ):
        plant = loop_plant(rig, candidate.operating_point)
        assert candidate.margin == stability_margin(plant, controller)
        assert candidate.plant_gap_to_nominal == nu_gap(plant, nominal)
        assert candidate.nu_gap_low == tuple(uncertainty.nu_gap_low[k])
        assert candidate.nu_gap_high == tuple(uncertainty.nu_gap_high[k])
        assert candidate.nu_gap_sum_low == uncertainty.sum_low[k]
        assert candidate.nu_gap_sum_high == uncertainty.sum_high[k]
        assert candidate.nominal_probability == uncertainty.nominal_probability[k]
        assert candidate.nu_gap_sum == 0.1  # what was there stays


def not_of_smallest_sum() -> str:
    return next(name for name in RIGS if name != smallest_sum())


@pytest.mark.parametrize(
    ("nominal", "factor", "words"),
    [
        (
            smallest_sum,
            1e-4,
            [
                "{0} is nominal with probability above 0.99; the controller stabilises it",
                "which covers all candidates (the farthest is 0.",
            ],
        ),
        (
            smallest_sum,
            100.0,
            [
                "the data do not decide which candidate is nominal: {0} with probability 0."
            ],
        ),
        (
            not_of_smallest_sum,
            1e-4,
            [
                "the data do not decide",
                "{1} with probability below 0.01, {0} with above 0.99",
            ],
        ),
    ],
    ids=["clear", "the data cannot tell", "against the probabilities"],
)
def test_how_certain_the_choice_is_in_words(
    nominal: Callable[[], str], factor: float, words: list[str]
) -> None:
    judgement = judged(nominal(), factor=factor)
    for phrase in words:
        assert (
            phrase.format(smallest_sum(), not_of_smallest_sum()) in judgement.certainty
        )
    chosen = next(c for c in judgement.candidates if c.name == nominal())
    assert (chosen.nominal_probability >= 0.9) == ("decide" not in judgement.certainty)


def test_a_single_candidate_leaves_no_choice() -> None:
    margin = stability_margin(
        loop_plant(RIGS["50 °C"], 50.0), loop_controller(law_of(Peltier, 1.0))
    )
    assert judged("50 °C", family=1).certainty == (
        "50 °C is the only candidate; the controller stabilises it and every plant "
        f"within a ν-gap of {margin:.2f}"
    )


def test_a_controller_that_is_too_hot_holds_nothing() -> None:
    hot = replace(
        Peltier.loop,
        proportional=38.57 * 400,
        integral=1.46877 * 400,
        derivative=6.66875 * 400,
    )
    judgement = judged(gains=hot)
    assert [c.margin for c in judgement.candidates] == [0.0, 0.0, 0.0]
    assert judgement.certainty.endswith("; the controller does not stabilise it")


def test_plants_beyond_the_margin_and_lost_ones_are_named() -> None:
    family = twins()
    matrix = gaps(twins())

    def with_capacity(heat_capacity: float) -> Certainty:
        rigs = {**RIGS, "90 °C": RIGS["90 °C"].replace(heat_capacity=heat_capacity)}
        candidates = [scored(name, rig) for name, rig in rigs.items()]
        return judge_uncertainty(candidates, family, matrix, "70 °C", TERMS)

    # half the heat capacity, twice the gain: held, but far away
    judgement = with_capacity(12.0)
    assert (
        judgement.candidates[2].plant_gap_to_nominal
        > judgement.candidates[1].margin
        > 0
    )
    assert judgement.candidates[2].margin > 0
    assert "which excludes 90 °C (0." in judgement.certainty
    judgement = with_capacity(0.4)
    assert judgement.candidates[2].margin == 0.0
    assert judgement.certainty.endswith(", but not 90 °C")


def test_a_candidate_out_of_reach_has_no_margin() -> None:
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    candidates[0] = scored("50 °C", RIGS["50 °C"], operating_point=300.0)
    judgement = judge_uncertainty(candidates, twins(), gaps(twins()), "70 °C", TERMS)
    assert judgement.candidates[0].margin is None
    assert judgement.candidates[0].plant_gap_to_nominal is None
    assert judgement.candidates[1].margin is not None
    judgement = judge_uncertainty(candidates, twins(), gaps(twins()), "50 °C", TERMS)
    assert (
        "the controller has no margin for it, because no input holds it at its set-point"
        in judgement.certainty
    )
    assert judgement.candidates[1].plant_gap_to_nominal is None


def test_given_candidates_are_exact() -> None:
    """They have no covariance, so nothing is left open."""
    candidates = [scored(name, rig) for name, rig in RIGS.items()]
    exact = [Candidate(name, 0.0, rig, None) for name, rig in RIGS.items()]
    judgement = judge_uncertainty(candidates, exact, gaps(exact), smallest_sum(), TERMS)
    assert judgement.certainty.startswith(
        f"{smallest_sum()} is nominal with probability above 0.99"
    )
    assert all(c.nu_gap_low == c.nu_gap_high for c in judgement.candidates)


def test_points_at_which_a_candidate_has_no_plant_are_reported() -> None:
    hopeless = {**RIGS, "90 °C": RIGS["90 °C"].replace(heat_capacity=1e-9)}
    family = [Candidate(name, 0.0, rig, None) for name, rig in hopeless.items()]
    candidates = [scored(name, rig) for name, rig in hopeless.items()]
    judgement = judge_uncertainty(candidates, family, gaps(family), "50 °C", TERMS)
    assert (
        "; not compared everywhere: Peltier rig, held sink: its shortest time constant"
        in judgement.certainty
    )


def test_without_a_nominal_there_is_nothing_to_say() -> None:
    assert judge_uncertainty([], [], gaps([]), None, TERMS) == Certainty((), "")


def test_of_two_the_plant_is_asked() -> None:
    family = twins(1e-2)[:2]
    candidates = [scored(name, RIGS[name]) for name in list(RIGS)[:2]]
    judgement = judge_uncertainty(
        candidates, family, gaps(family), "50 °C", TERMS, plant=RIGS["50 °C"]
    )
    assert judgement.certainty.startswith("50 °C is nominal with probability")
    judgement = judge_uncertainty(candidates, family, gaps(family), "50 °C", TERMS)
    assert judgement.certainty.startswith("the data do not decide")
    assert judgement.candidates[0].nominal_probability == pytest.approx(0.5)
