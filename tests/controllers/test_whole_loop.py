"""The whole loop: published margins, an independent program, and what eigenvalues promise in simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

from tests.support.exchanging import Heaters
from twinmatch.comparing import (
    StateSpace,
    UndefinedError,
    best_scaling,
    matrix_nu_gap,
    nu_gap,
)
from twinmatch.controllers import FilteredPid, WholeLoop, as_linear, pid_law
from twinmatch.controllers.whole_loop import UNSTABLE
from twinmatch.dynamics import (
    Linear,
    LinearLaw,
    PidGains,
    PidLoops,
    PlantError,
    Rest,
    TwoLevel,
    commands_of,
    linearised,
    rest_at,
    simulate_closed_loop,
)
from twinmatch.plants import Peltier

WIDE = {"low": -1e9, "high": 1e9}
REST = Rest(np.zeros(0), np.zeros(0))


def sampled(system: control.StateSpace, period: float, delay: int = 0) -> Linear:
    """A continuous plant, sampled, with a whole number of samples of dead time at its input."""
    a, b, c, _, _ = cont2discrete((system.A, system.B, system.C, system.D), period)
    n = len(a)
    whole = np.zeros((n + delay, n + delay))
    entry = np.zeros((n + delay, 1))
    whole[:n, :n] = a
    if delay:
        whole[:n, n] = b[:, 0]
        whole[n:-1, n + 1 :] = np.eye(delay - 1)
        entry[-1] = 1.0
    else:
        entry[:] = b
    return Linear(whole, entry, np.hstack([c, np.zeros((1, delay))]), period, REST)


@pytest.mark.parametrize(
    ("integrating", "up", "sensitivity", "delay"),
    [(False, 3.14, 1.59, 2.14), (True, 2.96, 1.70, 1.59)],
)
def test_margins_are_those_that_skogestad_published(
    integrating: bool, up: float, sensitivity: float, delay: float
) -> None:
    """Skogestad, Simple analytic rules for model reduction and PID controller tuning, J. Process Control 13
    (2003), table 1: SIMC settings with τc = θ, for a first order with dead time and for k·e^(−θs)/s."""
    dead = 60
    period = 1.0 / 60.0  # in units of θ
    lag = 4.0
    plant = control.tf([1.0], [1.0, 0.0] if integrating else [lag, 1.0])
    gain, time = (0.5, 8.0) if integrating else (lag / 2.0, lag)
    law = pid_law(
        [FilteredPid(proportional=gain, integral=gain / time, **WIDE)], period
    )
    [margins] = WholeLoop(sampled(control.ss(plant), period, dead), law).margins()
    # a sample lasts θ/60, and holding it is half of that as additional dead time
    assert margins.gain_up == pytest.approx(up, rel=0.015)
    assert margins.sensitivity == pytest.approx(sensitivity, rel=0.01)
    assert margins.delay == pytest.approx(delay, rel=0.015)
    assert margins.gain_down == 0.0


@pytest.mark.filterwarnings("ignore:stability_margins. Falling back")
@settings(max_examples=30)
@given(st.integers(0, 10**9))
def test_margins_are_those_of_python_control(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poles = -rng.uniform(0.05, 1.0, 3)
    system = control.ss(control.zpk([], poles, -np.prod(poles)))
    plant = sampled(system, 1.0)
    pid = FilteredPid(
        proportional=rng.uniform(0.1, 1.5), integral=rng.uniform(0.001, 0.1),
        derivative=rng.uniform(0.0, 2.0), filter=rng.uniform(0.5, 3.0), **WIDE,
    )  # fmt: skip
    law = pid_law([pid], 1.0)
    loop = WholeLoop(plant, law)
    theirs = control.ss(plant.A, plant.B, plant.C, 0, 1.0) * control.ss(
        law.A, law.B, law.C, law.D, 1.0
    )
    closed = np.linalg.eigvals(control.feedback(-theirs, 1).A)
    assert loop.eigenvalue == pytest.approx(np.abs(closed).max(), rel=1e-6)
    [margins] = loop.margins()
    if not loop.stable:
        assert margins == UNSTABLE
        return
    gains, phases, sensitivities, angles, crossover, _ = control.stability_margins(
        -theirs, returnall=True
    )
    # python-control sees the integrator at z = 1 as a crossing with a gain of zero, to what a double root
    # keeps of a rounding, √ε ≈ 1e-8; the slowest pole turns the phase at 0.05 rad per sample
    gains = gains[angles > 1e-4]
    ours = [k for k in (margins.gain_down, margins.gain_up) if 0 < k < math.inf]
    for k in ours:
        assert min(abs(gains - k)) < 1e-3 * k
    for k in gains:
        assert k <= margins.gain_down * (1 + 1e-3) or k >= margins.gain_up * (1 - 1e-3)
    assert 1.0 / margins.sensitivity == pytest.approx(min(sensitivities), rel=1e-3)
    assert np.isfinite(margins.delay), "an integrator's gain begins above 1"
    # python-control overlooks some, and sees two where the gain touches 1 and turns back
    crossed = [w for w in crossover if (abs(crossover - w) < 1e-4).sum() == 1]
    if len(crossed) == np.size(crossover) > 0:
        assert margins.delay == pytest.approx(
            min(np.radians(phases % 360.0) / crossover), rel=1e-3
        )
    # a grid misses a resonance by an eighth of its width at most: 1 - 1/√(1 + 1/64)
    assert loop.sensitivity() == pytest.approx(margins.sensitivity, rel=8e-3)


POINT = [45.0, 38.0]
PLANT = Heaters.model().parameters()
TWO = pid_law(
    [FilteredPid(proportional=4.0, integral=0.2, derivative=6.0, filter=4.0, **WIDE),
     FilteredPid(proportional=6.0, integral=0.3, weight=0.5, **WIDE)], 2.0,
)  # fmt: skip


def scaled(law: LinearLaw, channel: int, factor: float) -> Linear:
    """The plant with a command that acts `factor` times as strongly."""
    plant = linearised(PLANT, POINT, law.period)
    b = plant.B.copy()
    b[:, channel] *= factor
    return plant._replace(B=b)


@pytest.mark.parametrize("channel", [0, 1])
def test_the_loop_is_unstable_just_beyond_its_margins(channel: int) -> None:
    margins = WholeLoop(linearised(PLANT, POINT, 2.0), TWO).margins()[channel]
    assert 1.0 < margins.gain_up < math.inf
    assert margins.gain_change <= margins.gain_up
    assert WholeLoop(scaled(TWO, channel, margins.gain_up * (1 - 1e-6)), TWO).stable
    assert not WholeLoop(scaled(TWO, channel, margins.gain_up * (1 + 1e-6)), TWO).stable
    longest = int(margins.delay / 2.0)
    for samples, stable in ((longest, True), (longest + 1, False)):
        assert (
            WholeLoop(
                delayed(linearised(PLANT, POINT, 2.0), channel, samples), TWO
            ).stable
            is stable
        )


def delayed(plant: Linear, channel: int, samples: int) -> Linear:
    for _ in range(samples):
        a = np.block(
            [[plant.A, plant.B[:, [channel]]], [np.zeros((1, len(plant.A) + 1))]]
        )
        b = np.vstack([plant.B, np.zeros(plant.B.shape[1])])
        b[:, channel] = 0.0
        b[-1, channel] = 1.0
        plant = plant._replace(
            A=a, B=b, C=np.hstack([plant.C, np.zeros((len(plant.C), 1))])
        )
    return plant


@pytest.mark.parametrize(("factor", "stable"), [(0.97, True), (1.03, False)])
def test_eigenvalues_say_what_the_simulation_does(factor: float, stable: bool) -> None:
    """Gains at a margin, a little less and a little more: a small deviation decays, or grows as the
    eigenvalue says, over 200 samples of the compiled simulation of the nonlinear plant."""
    up = WholeLoop(linearised(PLANT, POINT, 2.0), TWO).margins()[0].gain_up * factor
    law = pid_law(
        [FilteredPid(proportional=4.0 * up, integral=0.2 * up, derivative=6.0 * up, filter=4.0, **WIDE),
         FilteredPid(proportional=6.0, integral=0.3, weight=0.5, **WIDE)], 2.0,
    )  # fmt: skip
    loop = WholeLoop(linearised(PLANT, POINT, 2.0), law)
    assert loop.stable is stable
    at_rest = rest_at(PLANT, POINT)
    run = simulate_closed_loop(
        PLANT, np.tile(POINT, (200, 1)), states=at_rest.states + np.array([1e-4, 0.0]), law=law,
        controller=np.array([at_rest.inputs[0], 0.0, at_rest.inputs[1] + 0.5 * 6.0 * POINT[1], 0.0]),
    )  # fmt: skip
    size = np.abs(run.outputs[:, 0] - POINT[0])
    growth = (size[150:].max() / size[50:100].max()) ** (1 / 100)
    assert growth == pytest.approx(loop.eigenvalue, abs=2e-3)


@settings(max_examples=30)
@given(st.integers(0, 10**9))
def test_it_gives_the_commands_of_a_pid_of_the_plant_file(seed: int) -> None:
    rng = np.random.default_rng(seed)
    integral = 0.4 * int(rng.integers(2))
    gains = PidGains(
        3.0,
        integral,
        2.0,
        float(rng.uniform(0.0, 1.0)),
        -4.0,
        9.0,
        1.0,
        bool(rng.integers(2)),
    )
    r, y = rng.normal(0.0, 2.0, (2, 60, 1))
    previous = rng.normal()
    first = np.array([0.5 if integral else 0.0, previous])
    theirs, _ = commands_of(gains.code, first, r, y)
    law = as_linear(gains)
    ours, _ = commands_of(
        law.code, np.array([0.5, -2.0 * previous])[-law.n_states :], r, y
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert ((theirs == -4.0) | (theirs == 9.0)).any()


def test_pids_side_by_side_are_each_for_itself_at_any_period() -> None:
    gains = (
        PidGains(5.0, 0.04, 10.0, 0.06, 0.0, 100.0, on_measurement=True),
        PidGains(3.0, 0.1, 2.0, 0.3, -4.0, 9.0),
    )
    law = PidLoops.of(*gains).at_period(2.0)
    r, y = np.random.default_rng(6).normal(0.0, 8.0, (2, 60, 2))
    both, _ = commands_of(law.code, np.zeros(4), r, y)
    for k, pid_gains in enumerate(gains):
        alone, _ = commands_of(
            pid_gains.at_period(2.0).code, np.zeros(2), r[:, [k]], y[:, [k]]
        )
        np.testing.assert_allclose(both[:, [k]], alone, atol=1e-9)
    with pytest.raises(
        PlantError, match=r"2 given, every \[1.0, 2.0\] s; give PIDs of one period"
    ):
        PidLoops.of(gains[0], gains[1].at_period(2.0))


def test_the_filter_is_the_sampled_transfer_function() -> None:
    """Kp + Kd·s/(1 + Tf·s), s ← (1 − z⁻¹)/Ts, computed by SciPy; the set-point with its weights."""
    ts = 0.5
    tf = 3.0
    pid = FilteredPid(
        proportional=2.0,
        derivative=7.0,
        filter=tf,
        weight=0.3,
        derivative_weight=0.1,
        **WIDE,
    )
    r, y = np.random.default_rng(4).normal(size=(2, 80))
    u, _ = commands_of(pid_law([pid], ts).code, np.zeros(1), r[:, None], y[:, None])
    expected = 2.0 * (0.3 * r - y) + lfilter([7.0, -7.0], [tf + ts, -tf], 0.1 * r - y)
    np.testing.assert_allclose(u[:, 0], expected, atol=1e-12)


def test_an_offset_changes_where_it_rests_and_nothing_else() -> None:
    """With back-calculation too: the integral tracks what the offset leaves."""
    rng = np.random.default_rng(1)
    r, y = rng.normal(0.0, 2.0, (2, 50, 1))
    plain, moved = (
        pid_law([FilteredPid(proportional=1.0, integral=0.2, back_calculation=0.5, offset=o, low=-2.0 + o,
                             high=1.0 + o)], 1.0) for o in (0.0, 5.0)
    )  # fmt: skip
    before, after = (
        commands_of(law.code, np.zeros(2), r, y)[0] for law in (plain, moved)
    )
    np.testing.assert_allclose(after - 5.0, before, atol=1e-12)


def test_laws_that_cannot_close_the_loop_are_refused() -> None:
    with pytest.raises(PlantError, match="filter -1 s must not be negative"):
        FilteredPid(proportional=1.0, filter=-1.0, **WIDE)
    with pytest.raises(PlantError, match="proportional is nan"):
        FilteredPid(proportional=math.nan, **WIDE)
    with pytest.raises(PlantError, match="positive period"):
        pid_law([], 1.0)
    with pytest.raises(PlantError, match="not linear"):
        as_linear(TwoLevel(0.0, 1.0, 0.5, 0.5))
    with pytest.raises(
        PlantError, match=r"the law runs every 2 s, the samples come every 1 s"
    ):
        WholeLoop(linearised(PLANT, POINT, 1.0), TWO).margins()


def drawn_loops(number: int) -> list[WholeLoop]:
    """Stable loops of one and two channels, drawn: plants that fall over or oscillate among them, gains of
    either sign, with and without integrators."""
    rng = np.random.default_rng(11)
    loops = []
    while len(loops) < number:
        n = int(rng.integers(1, 4))
        m = int(rng.integers(1, 3))
        a = rng.normal(size=(n, n))
        a *= rng.uniform(0.5, 1.1) / np.abs(np.linalg.eigvals(a)).max()
        plant = Linear(a, rng.normal(size=(n, m)), rng.normal(size=(m, n)), 1.0, REST)
        gains = rng.normal(size=m) * 10.0 ** rng.uniform(-2, 0, m)
        pids = [
            FilteredPid(
                proportional=k,
                integral=k * rng.uniform(0.0, 0.3) * rng.integers(2),
                **WIDE,
            )
            for k in gains
        ]
        loop = WholeLoop(plant, pid_law(pids, 1.0))
        if loop.eigenvalue < 0.999:
            loops.append(loop)
    return loops


def sizes_at(loop: WholeLoop, channel: int, factors: np.ndarray) -> np.ndarray:
    """The largest eigenvalue with a command that acts so many times as strongly, one after the other."""
    plant = loop.plant
    law = loop.law
    direct = law.D @ plant.C
    acting = np.tile(plant.B, (factors.size, 1, 1))
    acting[:, :, channel] *= factors[:, None]
    fixed = np.broadcast_to(np.hstack([law.B @ plant.C + law.G @ direct, law.A + law.G @ law.C]),
                            (factors.size, len(law.A), len(law.A) + len(plant.A)))  # fmt: skip
    whole = np.concatenate(
        [np.concatenate([plant.A + acting @ direct, acting @ law.C], axis=2), fixed],
        axis=1,
    )
    return np.abs(np.linalg.eigvals(whole)).max(axis=1)


def test_the_gain_margins_are_those_that_a_search_finds() -> None:
    """Eigenvalues for 120 gains of each channel, up to 1000 times and down to a thousandth: all stable
    between the margins, unstable just beyond; every way to be lost is among the drawn loops."""
    factors = np.geomspace(1e-3, 1e3, 120)
    near = 1e-4
    lost = set()
    for loop in drawn_loops(40):
        for channel, margins in enumerate(loop.margins()):
            between = factors[
                (factors > margins.gain_down * (1 + near))
                & (factors < margins.gain_up * (1 - near))
            ]
            assert sizes_at(loop, channel, between).max() < 1.0
            for end, beyond in (
                (margins.gain_down, 1 - near),
                (margins.gain_up, 1 + near),
            ):
                if 1e-3 < end < 1e3:
                    assert sizes_at(loop, channel, np.array([end * beyond]))[0] > 1.0
                    acting = loop.plant.B.copy()
                    acting[:, channel] *= end
                    eigenvalues = np.linalg.eigvals(
                        replace(loop, plant=loop.plant._replace(B=acting)).matrix
                    )
                    lost.add(
                        round(
                            float(
                                np.abs(
                                    np.angle(
                                        eigenvalues[np.argmax(np.abs(eigenvalues))]
                                    )
                                )
                                * 2
                                / np.pi
                            )
                        )
                    )
    assert lost >= {0, 2}  # through an eigenvalue at +1, at −1; a pair may be anywhere


@pytest.mark.parametrize(
    ("plant", "gains", "change"),
    [
        # falls over unless 1.1·0.6·k > 0.55
        (([[0.55]], [[1.1]], [[1.0]], 0.1), [0.6], 1.2),
        (([[-1 / 115, 0], [1 / 12, -1 / 12]], [[2.2 / 115], [0]], [[0, 1.0]], 1.0), [-0.25], 1 / 0.55),
        ((-np.eye(2) / 65, [[0.3 / 65, 0.85 / 65], [0.85 / 65, 0.3 / 65]], np.eye(2), 1.0), [0.9, 0.9],
         1.27 / (0.9 * (0.85**2 * 0.9 - 0.3 * 1.27))),
    ],
    ids=["unstable plant", "wrong sign", "crossed"],
)  # fmt: skip
def test_a_loop_that_is_lost_without_swinging(
    plant: tuple[np.ndarray, np.ndarray, np.ndarray, float],
    gains: list[float],
    change: float,
) -> None:
    """A gain at which the loop has an eigenvalue at +1, where plant and law are at rest: in closed form."""
    a, b, c, period = (np.array(entry, dtype=float) for entry in plant)
    d = np.zeros((len(c), b.shape[1]))
    held_a, held_b, *_ = cont2discrete((a, b, c, d), float(period))
    law = pid_law([FilteredPid(proportional=k, **WIDE) for k in gains], float(period))
    margins = WholeLoop(Linear(held_a, held_b, c, float(period), REST), law).margins()
    assert margins[0].gain_change == pytest.approx(change, rel=1e-9)


def test_the_gaps_of_pure_double_integrators_are_those_of_their_polynomials() -> None:
    """Poles that are all at 1, rounded apart by eigenvalues: k·h²/2·(z + 1)/(z − 1)², for two values of k."""
    h = 0.05
    gains = (10.0, 10.5)
    step = np.array([[1.0, h], [0.0, 1.0]])
    plants = [
        Linear(step, k * np.array([[h * h / 2], [h]]), np.eye(2)[:1], h, REST)
        for k in gains
    ]
    exact = [control.tf([k * h * h / 2] * 2, [1.0, -2.0, 1.0], h) for k in gains]
    law = pid_law(
        [FilteredPid(proportional=3, integral=3, derivative=1.2, filter=0.1, **WIDE)], h
    )
    spaces = [StateSpace.of(plant) for plant in plants]
    controller = StateSpace.of(law)
    assert matrix_nu_gap(*spaces) == pytest.approx(nu_gap(*exact), abs=1e-6)
    for unit in (1.0, 50.0):  # the search for units tries them far apart
        scaling = best_scaling(
            spaces[0], spaces, controller, outputs=np.array([unit]), inputs=np.ones(1)
        )
        scaled = [
            transfer * float(scaling.inputs[0] / scaling.outputs[0])
            for transfer in exact
        ]
        assert scaling.gap == pytest.approx(nu_gap(*scaled), abs=1e-6)


def test_a_margin_without_a_value_is_one_error() -> None:
    """Gains of 1e-320 leave a matrix whose singular values are not found."""
    tiny = dict.fromkeys(
        ("proportional", "integral", "derivative", "back_calculation"), 1e-320
    )
    plant = linearised(Peltier.model().typical(), 40.0, 1.0)
    loop = WholeLoop(plant, as_linear(PidGains(**tiny, low=-255.0, high=255.0)))
    with pytest.raises(
        UndefinedError, match="the sensitivity of the loop has no value"
    ):
        loop.sensitivity()


def test_a_loop_computes_its_matrix_once() -> None:
    """Its margins look at it at hundreds of frequencies."""
    loop = WholeLoop(linearised(PLANT, POINT, 2.0), TWO)
    assert loop.matrix is loop.matrix
