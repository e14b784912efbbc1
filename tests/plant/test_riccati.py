"""The tick on a held sink: against a general integrator and against the mathematics."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from twinmatch.plant import PlantState, RigParameters, advance
from twinmatch.plant.kernels import riccati_arrival, riccati_flow

Integrator = Callable[[RigParameters, PlantState, float, float], PlantState]

rigs = st.builds(
    RigParameters,
    seebeck=st.one_of(st.just(0.0), st.floats(1e-9, 1e-6), st.floats(0.01, 0.2)),
    resistance=st.floats(0.3, 10.0),  # below about 2.3 Ω the limiter acts at full PWM
    conductance=st.one_of(st.just(0.0), st.floats(0.0, 2.0)),
    heat_capacity=st.floats(5.0, 150.0),
    ambient=st.floats(263.0, 323.0),
)
pwms = st.one_of(st.just(0.0), st.sampled_from([-255.0, 255.0]), st.floats(-255.0, 255.0))


@given(rig=rigs, plate=st.floats(240.0, 420.0), pwm=pwms, period=st.floats(0.05, 20.0))
@example(rig=RigParameters(seebeck=0.0), plate=300.0, pwm=255.0, period=1.0)
@example(rig=RigParameters(seebeck=0.0, conductance=0.0), plate=300.0, pwm=0.0, period=1.0)
@example(rig=RigParameters(seebeck=0.0, conductance=0.0), plate=300.0, pwm=200.0, period=1.0)
@example(rig=RigParameters(conductance=0.0), plate=296.0, pwm=0.0, period=1.0)
@example(rig=RigParameters(resistance=1.0), plate=296.0, pwm=255.0, period=10.0)
@example(
    rig=RigParameters(seebeck=0.2, resistance=2.2, heat_capacity=5.0), plate=290.0, pwm=255.0, period=2.0
)
@example(rig=RigParameters(seebeck=0.01, resistance=3.3), plate=280.0, pwm=-255.0, period=60.0)
def test_a_tick_agrees_with_a_general_integrator(
    integrated: Integrator, rig: RigParameters, plate: float, pwm: float, period: float
) -> None:
    start = PlantState(plate, rig.ambient)
    exact = advance(rig, start, pwm, period)
    assert exact.sink == start.sink
    # A hundred times the integrator's own tolerance, on some 300 K.
    assert exact.plate == pytest.approx(integrated(rig, start, pwm, period).plate, rel=1e-10)


@pytest.mark.parametrize(
    ("plate", "pwm", "before", "after"),
    [
        (292.0, 255.0, -1, 0),  # heating: the growing Seebeck voltage releases the limiter
        (298.0, -255.0, 1, 0),  # cooling likewise
        (310.0, 255.0, 0, 0),
    ],
)
def test_the_limiter_switches_inside_a_tick(
    integrated: Integrator, plate: float, pwm: float, before: int, after: int
) -> None:
    rig = RigParameters(seebeck=0.05, resistance=2.29, heat_capacity=5.0)
    start = PlantState(plate, rig.ambient)

    def limited(state: PlantState) -> int:
        free = (-12.0 * pwm / 255 - rig.seebeck * (state.sink - state.plate)) / (rig.resistance + 0.1)
        return int(free > 5.0) - int(free < -5.0)

    end = advance(rig, start, pwm, 2.0)
    assert (limited(start), limited(end)) == (before, after)
    assert end.plate == pytest.approx(integrated(rig, start, pwm, 2.0).plate, rel=1e-11)


@given(rig=rigs, plate=st.floats(240.0, 420.0), pwm=pwms, part=st.floats(1e-6, 0.999))
def test_two_ticks_make_one(rig: RigParameters, plate: float, pwm: float, part: float) -> None:
    start = PlantState(plate, rig.ambient)
    halfway = advance(rig, start, pwm, part)
    once = advance(rig, start, pwm, 1.0).plate
    assert advance(rig, halfway, pwm, 1.0 - part).plate == pytest.approx(once, rel=1e-12)


@given(
    lower=st.floats(-3.0, 0.0),
    gap=st.one_of(st.sampled_from([0.0, 1e-12, 1e-7]), st.floats(0.0, 6.0)),
    scale=st.floats(-2.0, 0.0),
    time=st.floats(1e-3, 50.0),
)
def test_flow_to_the_upper_root(lower: float, gap: float, scale: float, time: float) -> None:
    """y' = scale·(y − lower)·(y − upper) with roots far apart, near or equal, from y = 0."""
    upper = lower + gap
    moved = riccati_flow(scale, -scale * (lower + upper), scale * lower * upper, time)
    run = solve_ivp(
        lambda _t, y: scale * (y - lower) * (y - upper), (0.0, time), [0.0], "DOP853", rtol=1e-12, atol=1e-13
    )
    # A root so near to the start that the product rounds away is a plate at rest.
    assert moved == pytest.approx(run.y[0, -1], rel=1e-7, abs=1e-9)


@pytest.mark.parametrize(
    ("quadratic", "slope", "speed"),
    [
        (-1.0, 0.3, 0.5),
        (-1.0, 0.2, -0.5),
        (0.0, 0.0, 2.0),
        (0.0, -1.0, 2.0),
        (0.0, 1.0, 2.0),
        (0.3, 0.1, 0.2),
    ],
)
@pytest.mark.parametrize("time", [1e-6, 0.5, 1.3])
def test_arrival_inverts_flow(quadratic: float, slope: float, speed: float, time: float) -> None:
    distance = riccati_flow(quadratic, slope, speed, time)
    assert riccati_arrival(quadratic, slope, speed, distance) == pytest.approx(time, rel=1e-12)
    assert riccati_arrival(quadratic, slope, speed, -distance) == 0.0


def test_an_equilibrium_is_never_passed() -> None:
    assert riccati_arrival(-1.0, 0.0, 1.0, 1.0 + 1e-9) == math.inf
    assert riccati_arrival(-1.0, 0.0, 1.0, math.inf) == math.inf
    assert riccati_flow(-1.0, 0.0, 1.0, 1e6) == 1.0
