"""Plant and controller as the margin sees them, against physics by hand and against simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.support.box_runs import PERIOD, TRUTH, step_test, switched
from tests.support.plants import Box, Lag
from twinmatch.comparing import (
    CandidateScore,
    DiscriminationError,
    GraphSymbol,
    LoopConditions,
    identify,
    loop_controller,
    nu_gap,
    plant_gap,
    score,
    spans_of,
    stability_margin,
)
from twinmatch.comparing.certainty import with_margins
from twinmatch.comparing.graph_symbol import graph_symbol
from twinmatch.comparing.margin import Scales, loop_plant
from twinmatch.comparing.models import operating_level
from twinmatch.comparing.plant_gap import linearised_in_loop
from twinmatch.comparing.polynomials import (
    column_of,
    even_part,
    exact,
    multiply,
    to_half_plane,
)
from twinmatch.dynamics import (
    Controller,
    Parameters,
    PidGains,
    PlantError,
    Structure,
    begin,
    linearised,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.fitting import FittingError
from twinmatch.plants import Peltier
from twinmatch.signals import Window

PLATE = {"seebeck": 0.06, "conductance": 0.5, "heat_capacity": 27.0}
SINK = {"sink_heat_capacity": 300.0, "sink_convection": 4.0}
RIG = Peltier.model().parameters(**PLATE)
GAINS = Peltier.loop
KELVIN = 273.15
VOLTS_PER_COUNT = 12.0 / 255.0
UNITS = Scales(1.0, 1.0)


class Lagging(Peltier, name="lagging-peltier"):
    """A held sink seen through a lag, which no structure of the rig is."""

    followed = ""
    structures = {  # noqa: RUF012
        "sensor lag": Structure(free=("seebeck",), parts=frozenset({"sensor lag"}))
    }


def loop_margin(
    rig: Parameters, point: float, gains: PidGains = GAINS, scales: Scales | None = None
) -> float:
    return stability_margin(
        loop_plant(rig, point, gains, scales=scales),
        loop_controller(gains, scales=scales),
    )


def balance(rig: Parameters, celsius: float) -> tuple[float, float]:
    """Current and PWM that hold the plate on a held sink: α T I − ½ R I² + K (T − T_B) = 0."""
    plate = celsius + KELVIN
    peltier = rig["seebeck"] * plate
    root = math.sqrt(
        peltier**2
        + 2 * rig["resistance"] * rig["conductance"] * (plate - rig["ambient"])
    )
    current = (peltier - root) / rig["resistance"]
    loop = rig["resistance"] + rig["bridge_resistance"]
    volts = -current * loop - rig["seebeck"] * (rig["ambient"] - plate)
    return current, volts / VOLTS_PER_COUNT


@pytest.mark.parametrize("celsius", [15.0, 30.0, 60.0, 90.0])
def test_the_plant_is_the_energy_balance_linearised_by_hand(celsius: float) -> None:
    plate = celsius + KELVIN
    seebeck = RIG["seebeck"]
    capacity = RIG["heat_capacity"]
    current, _ = balance(RIG, celsius)
    loop = RIG["resistance"] + RIG["bridge_resistance"]
    by_current = seebeck * plate - RIG["resistance"] * current
    rate = (
        by_current * seebeck / loop + seebeck * current + RIG["conductance"]
    ) / capacity
    drive = by_current * VOLTS_PER_COUNT / loop / capacity
    pole = math.exp(-rate)
    by_hand = control.tf([drive / rate * (1 - pole)], [1, -pole], 1.0)
    # with counts and °C as they are the plant's gain is far below 1; the ν-gap is then nearly linear in it
    assert nu_gap(loop_plant(RIG, celsius, scales=UNITS), by_hand) < 1e-8 * drive / rate
    scaled = loop_plant(RIG, celsius, scales=Scales(6.6, 255.0))
    assert nu_gap(scaled, by_hand * 255.0 / 6.6) < 1e-8


def in_delays(polynomial: list[int]) -> np.ndarray:
    """A polynomial in w = (z − 1)/(z + 1) as one in z⁻¹, without the denominator (1 + z⁻¹)^n."""
    total = [0] * len(polynomial)
    for k, c in enumerate(polynomial):
        term = [1]
        for factor in [[1, -1]] * k + [[1, 1]] * (len(polynomial) - 1 - k):
            term = multiply(term, factor)
        total = [a + c * b for a, b in zip(total, term, strict=True)]
    return np.array([t / 2**200 for t in total])


@pytest.mark.parametrize(
    "rig",
    [
        RIG,
        Peltier.model("sink with mass").parameters(**PLATE, **SINK),
        Lagging.model().parameters(**PLATE, sensor_lag=1.5),
        Peltier.model("sink with mass, sensor lag").parameters(
            **PLATE, **SINK, sensor_lag=1.5
        ),
    ],
    ids=["held sink", "sink with mass", "lagging sensor", "both"],
)
def test_the_plant_answers_a_small_pulse_as_the_simulation_does(
    rig: Parameters,
) -> None:
    """Two simulations a pulse apart."""
    d, n = (in_delays(p) for p in loop_plant(rig, 60.0, scales=UNITS).column)
    expected = lfilter(n, d, np.eye(1, 41)[0])
    settle = np.full(4000, 60.0)
    at_rest = simulate_closed_loop(rig, settle, states=begin(rig, 60.0))
    assert at_rest.output[-1] == pytest.approx(60.0, abs=1e-6)
    ran = []
    for pulse in (0.5, -0.5):
        pwm = np.full(4000 + 41, at_rest.input[-1])
        pwm[4000] += pulse
        ran.append(simulate_driven(rig, pwm, states=begin(rig, 60.0)).output[4000:])
    np.testing.assert_allclose(
        ran[0] - ran[1], expected, atol=1e-5 * np.abs(expected).max()
    )


def test_the_controller_is_the_pid_that_runs() -> None:
    gains = GAINS
    symbol = loop_controller(gains, scales=UNITS)
    z = control.tf([1, 0], [1], 1.0)
    by_hand = (
        gains.proportional + gains.integral / (z - 1) + gains.derivative * (z - 1) / z
    )
    assert nu_gap(symbol, symbol) == 0.0
    assert nu_gap(symbol, by_hand) < 1e-12
    errors = np.random.default_rng(1).normal(0, 0.3, 60)
    pid = Controller(gains)
    ran = [pid.step(reference=float(e), output=0.0)[0] for e in errors]
    assert np.abs(ran).max() < gains.high
    np.testing.assert_allclose(
        control.forced_response(by_hand, U=errors).outputs, ran, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize(
    ("gains", "parts"),
    [
        (replace(GAINS, integral=0.0), 1),
        (replace(GAINS, derivative=0.0), 1),
        (replace(GAINS, integral=0.0, derivative=0.0), 0),
    ],
)
def test_a_controller_without_a_part_has_no_dynamics_of_it(
    gains: PidGains, parts: int
) -> None:
    assert len(loop_controller(gains).column[0]) == parts + 1
    assert 0 < loop_margin(RIG, 50.0, gains) < 1


def test_the_margin_ends_where_the_simulated_loop_does() -> None:
    """All gains times k: the margin falls to 0 at the k above which a small movement grows."""
    low = 1.0
    high = 200.0
    rig = Lagging.model().parameters(**PLATE, sensor_lag=2.0)

    def gains(k: float) -> PidGains:
        return replace(
            GAINS, proportional=38.57 * k, integral=1.46877 * k, derivative=6.66875 * k
        )

    scales = Scales.of(GAINS)
    assert loop_margin(rig, 50.0, gains(low), scales=scales) > 0
    assert loop_margin(rig, 50.0, gains(high), scales=scales) == 0.0
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        if loop_margin(rig, 50.0, gains(middle), scales=scales) > 0:
            low = middle
        else:
            high = middle

    def swing(k: float) -> float:
        """How much larger the last movements are than earlier ones, after a nudge of 1 mK."""
        reference = np.full(3000, 50.0)
        reference[2200:] += 1e-3
        run = simulate_closed_loop(
            rig, reference, states=begin(rig, 50.0), law=gains(k)
        ).input
        return float(np.ptp(run[2500:2600]) / np.ptp(run[2300:2400]))

    assert swing(0.97 * low) < 1.0 < swing(1.03 * high)


def test_the_scales_are_those_of_the_controller_and_only_their_ratio_counts() -> None:
    gains = GAINS
    assert Scales.of(gains) == (255.0 / 38.57, 255.0)
    margin = loop_margin(RIG, 50.0, gains)
    assert loop_margin(
        RIG, 50.0, gains, scales=Scales(2 * 255.0 / 38.57, 510.0)
    ) == pytest.approx(margin)
    # not far below the best of all units, and far above bad ones
    margins = [
        loop_margin(RIG, 50.0, gains, scales=Scales(t, 255.0))
        for t in np.geomspace(0.5, 80.0, 40)
    ]
    assert margin > 0.75 * max(margins)
    assert min(margins) < 0.25 * margin


def test_the_healthy_rig_is_held_with_room() -> None:
    """Plants a match may find; b ≥ 0.3 is what is usually asked of a loop (Zhou and Doyle)."""
    plant = loop_plant(RIG, 50.0)
    assert stability_margin(plant, loop_controller(GAINS)) == loop_margin(RIG, 50.0)
    assert loop_margin(RIG, 50.0) > 0.3
    hot = loop_plant(RIG, 90.0)
    assert nu_gap(plant, hot) < loop_margin(RIG, 50.0)


def test_operating_points_out_of_reach_are_refused() -> None:
    with pytest.raises(
        PlantError, match="no PWM between -255 and 255 holds it at 400 °C"
    ):
        loop_plant(RIG, 300.0 + 100.0)
    with pytest.raises(PlantError, match="at -60 °C"):
        loop_margin(RIG, -60.0)
    with pytest.raises(
        DiscriminationError,
        match=r"PWM at 90 °C, beyond the controller's limits -10 and 10",
    ):
        loop_plant(RIG, 90.0, replace(GAINS, low=-10.0, high=10.0))
    with pytest.raises(DiscriminationError, match="no proportional gain to scale by"):
        loop_margin(RIG, 50.0, replace(GAINS, proportional=0.0))


# Models and plants without a loop: from input to output, and at rest.


def lag_window(noise: float = 0.01) -> Window:
    """A lag with a gain of 1.5 and a time constant of 12 s, under three levels of its input."""
    plant = Lag.model().parameters(gain=1.5, lag=12.0)
    u = np.repeat([1.0, 4.0, -2.0, 3.0], 150)
    run = simulate_driven(plant, u, states=begin(plant, 1.5))
    y = run.output + noise * np.random.default_rng(3).standard_normal(u.size)
    return Window(np.zeros(u.size), y, u)


def test_models_go_from_the_input_to_the_output() -> None:
    """The plant's own pole and gain come out, whatever the set-points were said to be."""
    window = lag_window()
    models = identify(window, scale=1.0)
    assert [m.order for m in models] == ["22221", "33331", "44441", "55551"]
    first = models[0]
    assert first.u is None
    assert np.sum(first.y.B) / np.sum(first.y.F) == pytest.approx(1.5, rel=0.01)
    slowest = np.max(np.abs(np.roots(first.y.F)))
    assert slowest == pytest.approx(np.exp(-1.0 / 12.0), rel=0.01)
    first_score = score(first, window, absolute=0.0)
    assert first_score.u is None
    assert first_score.total == first_score.y
    assert first_score.y.explanation > 0.2
    with pytest.raises(FittingError, match="is constant"):
        identify(Window(np.zeros(200), window.output[:200], np.ones(200)), scale=1.0)


def test_deviations_are_from_rest_or_from_the_means() -> None:
    window = lag_window()
    at_rest = operating_level(window, driven=True)
    assert at_rest.input == 1.0
    assert at_rest.output == pytest.approx(1.5, abs=0.01)
    restless = window.part(145, 599)
    level = operating_level(restless, driven=True)
    assert level == (
        pytest.approx(restless.output.mean()),
        pytest.approx(restless.input.mean()),
    )


def test_a_plant_is_compared_where_it_rests() -> None:
    """The gap of two lags that differ in gain alone is that of another program's frequency responses."""
    weaker = Lag.model().parameters(gain=1.0, lag=12.0)
    stronger = weaker.replace(gain=1.6)
    terms = LoopConditions(None, spans_of(Lag), 240, 1.0)
    np.testing.assert_array_equal(
        linearised_in_loop(weaker, 2.0, terms).A, linearised(weaker, 2.0, 1.0).A
    )
    scale = terms.scales.ratio
    z = np.exp(1j * np.geomspace(1e-4, np.pi, 2000))
    responses = []
    for plant in (weaker, stronger):
        linear = linearised(plant, 2.0, 1.0)
        system = control.ss(linear.A, linear.B, scale * linear.C, 0.0, 1.0)
        responses.append(np.array([complex(np.squeeze(system(point))) for point in z]))
    a, b = responses
    chordal = np.abs(a - b) / np.sqrt((1 + np.abs(a) ** 2) * (1 + np.abs(b) ** 2))
    assert plant_gap(weaker, stronger, (2.0,), terms) == pytest.approx(
        float(chordal.max()), rel=1e-4
    )


def test_there_is_no_margin_without_a_controller() -> None:
    bare = CandidateScore("a", 35.0, TRUTH, 0, 1, (), "", 0.0, None, None)
    assert with_margins([bare], 0, None) == (bare,)


@pytest.mark.parametrize(
    "samples", [step_test(700, 5), switched(700, 5)], ids=["step test", "switched"]
)
def test_models_of_real_windows_forecast_the_window(samples: list) -> None:
    window = Window.from_samples(samples, PERIOD)
    scale = spans_of(Box).ratio
    scores = [
        score(model, window, absolute=Box.output.absolute)
        for model in identify(window, scale=scale)
    ]
    assert max(t.y.gain for t in scores) > 0
    assert all(np.isfinite(t.total.naic) for t in scores)


wholes = st.lists(st.integers(-50, 50), min_size=1, max_size=6)


@given(wholes, wholes, st.integers(-5, 5))
def test_products_and_mapped_polynomials_take_the_right_values(
    a: list[int], b: list[int], x: int
) -> None:
    def value_at(p: list[int], point: float) -> float:
        return sum(c * point**k for k, c in enumerate(p))

    assert value_at(multiply(a, b), x) == value_at(a, x) * value_at(b, x)
    degree = len(a) - 1
    mapped = to_half_plane([a])[0]
    if x != 1:
        assert value_at(mapped, x) == pytest.approx(
            value_at(a, (1 + x) / (1 - x)) * (1 - x) ** degree, rel=1e-9, abs=1e-6
        )
    square = sum(abs(value_at(p, 1j * x)) ** 2 for p in (a, mapped))
    assert value_at(even_part([a, mapped]), x**2) == pytest.approx(square, rel=1e-12)


def test_floats_become_whole_numbers_exactly() -> None:
    column = exact([np.array([0.1, -0.75, 0.0]), np.array([3.0])])
    scale = column[1][0] // 3
    assert [c / scale for c in column[0]] == [0.1, -0.75, 0.0]
    assert column[1] == [3 * scale, 0, 0]


def test_the_spectral_factor_is_stable_and_has_the_right_size() -> None:
    g = graph_symbol(control.tf([1, 2], [1, -3, 2]))
    assert g.outputs == 1
    assert g.spectral_roots.shape == (2,)
    assert np.all(g.spectral_roots.real > 0)
    for w in (0.0, 0.7, 3.0):
        size = abs((1j * w) ** 2 - 3j * w + 2) ** 2 + abs(1j * w + 2) ** 2
        assert abs(np.prod(1j * w + g.spectral_roots)) ** 2 == pytest.approx(
            size, rel=1e-12
        )


def gap_of(
    pair1: list[tuple[list[float], list[float]]],
    pair2: list[tuple[list[float], list[float]]],
) -> float:
    return nu_gap(*(GraphSymbol.of_transfer_functions(p, 0.0) for p in (pair1, pair2)))


def poly(*roots: float) -> list[float]:
    return [float(c) for c in np.atleast_1d(np.poly(roots))]


@pytest.mark.parametrize("shared", [-1.0, 0.0, 1.3, 5.0])
def test_a_pole_both_outputs_share_counts_once(shared: float) -> None:
    """y with the poles p, a and u with p, b: the product of the denominators has p twice."""
    y1 = ([1.0], poly(shared, -2.0))
    u1 = ([3.0, 1.0], poly(shared, -5.0))
    y2 = ([1.1], poly(shared, -2.0))
    u2 = ([3.0, 1.2], poly(shared, -5.0))
    common = poly(shared, -2.0, -5.0)
    y1c = ([1.0, 5.0], common)
    y2c = ([1.1, 5.5], common)
    u1c = (poly(-1 / 3, -2.0), common)
    u2c = (poly(-0.4, -2.0), common)
    u1c = ([3 * c for c in u1c[0]], common)
    u2c = ([3 * c for c in u2c[0]], common)
    assert gap_of([y1, u1], [y2, u2]) == pytest.approx(
        gap_of([y1c, u1c], [y2c, u2c]), rel=1e-11
    )
    assert gap_of([y1, u1], [y2, u2]) < 0.3


@given(st.integers(0, 10**9), st.sampled_from([1.0, 1.001, 1.02, 1.3]))
def test_an_unstable_pole_shared_by_rounded_denominators_counts_once(
    seed: int, shared: float
) -> None:
    """Each denominator is multiplied out on its own, so the pole is common only to within rounding."""
    rng = np.random.default_rng(seed)
    y = rng.uniform(0.3, 0.9, 2)
    u = rng.uniform(0.3, 0.9, 2)

    def pair(gain: float) -> tuple[GraphSymbol, GraphSymbol]:
        apart = [([gain], np.poly([shared, *y])), ([2.0], np.poly([shared, *u]))]
        whole = np.poly([shared, *y, *u])
        together = [(gain * np.poly(u), whole), (2.0 * np.poly(y), whole)]
        return tuple(
            GraphSymbol.of_transfer_functions(p, 1.0) for p in (apart, together)
        )

    apart1, together1 = pair(1.0)
    apart2, together2 = pair(1.1)
    # the coefficients of the two ways to write it differ by rounding, and slow poles amplify that
    assert nu_gap(apart1, apart2) == pytest.approx(
        nu_gap(together1, together2), rel=1e-8
    )
    assert nu_gap(apart1, apart2) < 0.2


def test_a_double_integrator_may_be_shared_by_both_outputs() -> None:
    def discrete(gains: tuple[float, float], common: bool) -> GraphSymbol:
        poles = (poly(1.0, 1.0, 0.7), poly(1.0, 1.0, 0.3))
        if not common:
            return GraphSymbol.of_transfer_functions(
                [([g], p) for g, p in zip(gains, poles, strict=True)], 1.0
            )
        numerators = [[gains[0], -0.3 * gains[0]], [gains[1], -0.7 * gains[1]]]
        return GraphSymbol.of_polynomials(poly(1.0, 1.0, 0.7, 0.3), numerators, 1.0)

    products = nu_gap(discrete((0.1, 0.2), False), discrete((0.12, 0.2), False))
    assert products == pytest.approx(
        nu_gap(discrete((0.1, 0.2), True), discrete((0.12, 0.2), True)), rel=1e-9
    )


@pytest.mark.parametrize(
    "hidden", [(1.3,), (0.0,), (2.0, 0.1), (1.0, 1.0), (0.5, -1.0)]
)
def test_hidden_unstable_modes_are_cancelled(hidden: tuple[float, ...]) -> None:
    plain = ([1.0], [1.0, 2.0])
    neighbour = ([1.1], [1.0, 2.1])
    clouded = (poly(*hidden), [float(c) for c in np.polymul(poly(*hidden), [1.0, 2.0])])
    assert gap_of([clouded], [neighbour]) == pytest.approx(
        gap_of([plain], [neighbour]), rel=1e-9
    )


def test_a_mere_zero_has_no_poles() -> None:
    assert gap_of([([0.0], [1.0, -2.0])], [([1.0], [1.0, 1.0])]) == pytest.approx(
        np.sqrt(0.5), rel=1e-14
    )


def test_powers_of_the_delay_are_padded_at_the_end() -> None:
    delayed = GraphSymbol.of_fractions([([0.0, 0.0, 0.3], [1.0, -0.7])], 1.0)
    forward = GraphSymbol.of_polynomials([1.0, -0.7, 0.0], [[0.3]], 1.0)
    assert nu_gap(delayed, forward) == 0.0
    assert nu_gap(delayed, GraphSymbol.of_polynomials([1.0, -0.7], [[0.3]], 1.0)) > 0.1


@given(st.integers(0, 10**9), st.integers(0, 6))
def test_state_space_models_are_converted_exactly(seed: int, order: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.integers(-9, 9, (order, order)) / 4
    B = rng.integers(-9, 9, (order, 1)) / 2
    C = rng.integers(-9, 9, (2, order)) / 8
    D = rng.integers(-9, 9, (2, 1)) / 1
    column = column_of(A, B, C, D)
    s = 1.75
    resolvent = s * np.eye(order) - A

    def value(polynomial: list[int]) -> float:
        return sum(c * s**k for k, c in enumerate(polynomial))

    values = [value(polynomial) for polynomial in column]
    determinant = np.linalg.det(resolvent) if order else 1.0
    if abs(determinant) > 1e-6:
        response = C @ np.linalg.solve(resolvent, B) + D
        assert values[0] != 0
        assert [v / values[0] for v in values[1:]] == pytest.approx(
            response[:, 0].tolist(), rel=1e-7, abs=1e-7
        )


def test_state_space_and_transfer_function_are_the_same_model() -> None:
    """Order 6, discrete, two outputs, with direct feed-through."""
    d = np.poly([0.999, 0.97, 0.9, 0.5, 0.3, -0.2])
    n = [
        np.poly([0.9, 0.8, 0.1, 0.0, 0.0]) * 0.01,
        np.poly([0.98, 0.5, 0.1, 0.2, 0.7, 0.1]) * 45,
    ]
    A = np.vstack([-d[1:], np.eye(5, 6)])
    B = np.eye(6, 1)
    C = np.vstack([n[0], n[1][1:] - n[1][0] * d[1:]])
    realised = graph_symbol(control.ss(A, B, C, [[0.0], [n[1][0]]], 1.0))
    # the products n·d round once
    assert nu_gap(realised, GraphSymbol.of_polynomials(d, n, 1.0)) < 1e-9
    assert graph_symbol(realised) is realised


def test_what_is_not_a_model_is_refused() -> None:
    with pytest.raises(DiscriminationError, match="a list cannot be compared"):
        graph_symbol([1, 2])
    with pytest.raises(DiscriminationError, match="it has 2 inputs"):
        graph_symbol(control.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]))
    with pytest.raises(DiscriminationError, match="use another unit of time"):
        GraphSymbol.of_polynomials([1.0, 1e-200], [[1e-200]], 0.0)
    with pytest.raises(DiscriminationError, match="it has no output"):
        GraphSymbol.of_polynomials([1.0], [], 0.0)
    with pytest.raises(DiscriminationError, match="denominator of output 1 is zero"):
        GraphSymbol.of_transfer_functions([([1.0], [1.0]), ([1.0], [0.0, 0.0])], 0.0)
    with pytest.raises(DiscriminationError, match="not all finite"):
        GraphSymbol.of_polynomials([1.0, np.nan], [[1.0]], 0.0)
    with pytest.raises(
        DiscriminationError, match=r"its numbers \[\[inf, 1.0\], .* are not all finite"
    ):
        column_of(
            np.array([[np.inf]]), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1))
        )
    with pytest.raises(DiscriminationError, match=r"a polynomial has shape \(1, 2\)"):
        GraphSymbol.of_polynomials([[1.0, 2.0]], [[1.0]], 0.0)
