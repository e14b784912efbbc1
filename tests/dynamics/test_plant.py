"""What a plant file says, and what is wrong with one, in a line."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import Motor
from twinmatch.dynamics import (
    Drive,
    Equations,
    Observer,
    Output,
    Parameter,
    Plant,
    PlantError,
    Sensor,
    State,
    Structure,
    advance,
    advance_long,
    begin,
    linearised,
    read,
    rest_at,
    simulate_driven,
)
from twinmatch.dynamics.equations import derive
from twinmatch.dynamics.kernels import spectral_bound
from twinmatch.dynamics.plant import corners_of
from twinmatch.plants import Peltier, find_plant

MASSIVE = Peltier.model("sink with mass")


def test_parameters_are_a_mapping_with_units() -> None:
    p = Motor.model().parameters(k=0.06)
    assert (p["k"], p["j"]) == (0.06, 4e-4)
    assert dict(zip(p, p.units, strict=True))["k"] == "V s/rad"
    assert "dry" not in p  # the structure without friction does not depend on it
    assert p == Motor.model().parameters(k=0.06)
    assert hash(p) == hash(p.replace(k=0.07).replace(k=0.06))
    assert pickle.loads(pickle.dumps(p)) == p
    assert p.replace(r=2.0)["r"] == 2.0
    np.testing.assert_array_equal(p.vector, [p[name] for name in p.model.names])


def test_impossible_parameters_and_unknown_names_are_refused_in_words() -> None:
    motor = Motor.model()
    rig = Peltier.model()
    for message, make in (
        (
            "without friction: no parameter 'dry' in this structure; it has k, r",
            lambda: motor.parameters(dry=1),
        ),
        (
            "j is 0 kg m²; it must be finite and positive",
            lambda: motor.parameters(j=0.0),
        ),
        (
            "b is -1 N m s/rad; it must be finite and at least 0",
            lambda: motor.parameters(b=-1.0),
        ),
        ("k is nan", lambda: motor.parameters(k=float("nan"))),
        (
            r"drive_ripple is 1\.5 ; .* at least 0 and at most 1",
            lambda: rig.parameters(drive_ripple=1.5),
        ),
        (
            "ambient is 23 K; it must be finite and at least 150",
            lambda: rig.parameters(ambient=23.0),
        ),
        (
            "motor: no structure 'x'; it has without friction, with friction",
            lambda: Motor.model("x"),
        ),
        ("plant 'pump': not known; choose from peltier", lambda: find_plant("pump")),
    ):
        with pytest.raises(PlantError, match=message):
            make()


class _Parts:
    """Declarations of the plants below."""

    y = Output(unit="m", noise=0.1, span=(0, 1))
    u = Drive(unit="V", limits=(0, 1), noise=0.1)
    x = State(unit="m", span=(0, 1))
    z = State(unit="m", span=(0, 1))
    a = Parameter(unit="1/s", default=1.0, bounds=(0.1, 10.0))


def plant_of(
    rates: str = "{p.x: p.u - p.a * p.x}",
    output: str = "p.x",
    start: str = "{p.x: p.y}",
) -> Plant:
    """A plant with these equations."""

    class Small(_Parts, Plant):
        structures = {"all": Structure(free=("a",))}  # noqa: RUF012

        def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
            import sympy

            scope = {"p": self, "sympy": sympy}
            return Equations(*(eval(text, scope) for text in (rates, output, start)))

    return Small()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rates": "{}"}, "no state has a rate"),
        (
            {"rates": "{p.a: 1}"},
            "no state has a rate|`rates` has a, which is not declared as a state",
        ),
        (
            {"rates": "{p.x: p.z}"},
            "the rate of x uses z, which is the output or a state without a rate",
        ),
        (
            {"rates": "{p.x: sympy.Symbol('w')}"},
            "the rate of x uses 'w', which is not declared",
        ),
        ({"start": "{}"}, "state x has no start value"),
        ({"output": "2 * p.u"}, "the output depends on no state"),
        ({"output": "sympy.Abs(p.x, evaluate=False)"}, "the output has a kink"),
        (
            {"rates": "{p.x: sympy.Piecewise((p.u, sympy.Eq(p.x, 1)), (0, True))}"},
            "is not a single inequality",
        ),
    ],
)
def test_faulty_equations_are_refused_in_words(
    change: dict[str, str], message: str
) -> None:
    with pytest.raises(PlantError, match=message):
        derive(plant_of(**change), frozenset(), frozenset({"a"}))


def test_corners_are_all_of_few_states_and_of_many_a_few_that_hold_every_triple() -> (
    None
):
    few = corners_of([(0.0, 1.0), (2.0, 5.0)])
    many = corners_of([(0.0, 1.0)] * 40)
    assert {tuple(row) for row in few.tolist()} == {
        (0.0, 2.0),
        (0.0, 5.0),
        (1.0, 2.0),
        (1.0, 5.0),
    }
    assert len(many) < 200
    assert np.isin(many, (0.0, 1.0)).all()
    for first in range(38):
        assert len(np.unique(many[:, first : first + 3], axis=0)) == 8, (
            "equations of a chain"
        )


def test_a_free_parameter_is_in_the_equations() -> None:
    class Spare(_Parts, Plant):
        b = Parameter(unit="1/s", default=1.0, bounds=(0.1, 10.0))
        structures = {"all": Structure(free=("a", "b"))}  # noqa: RUF012

        def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
            return Equations(
                {self.x: self.u - self.a * self.x}, self.x, {self.x: self.y}
            )

    with pytest.raises(
        PlantError,
        match="structure 'all': b is free, but does not occur in the equations",
    ):
        Spare.model().parameters()


def test_faulty_declarations_are_refused_in_words() -> None:
    with pytest.raises(
        PlantError, match=r"is \(2.0, 1.0\); give two finite numbers, the smaller first"
    ):
        Parameter(default=1.0, bounds=(2.0, 1.0))
    for body, message in (
        ({}, "declares no Drive; declare at least one"),
        ({"u": _Parts.u}, "declares no Output; declare at least one"),
        ({"u": _Parts.u, "y": _Parts.y}, "has no structure; declare at least one"),
        (
            {"u": _Parts.u, "y": _Parts.y, "structures": {"s": Structure(free=("k",))}},
            "structure 's': no parameter 'k'; the plant has none",
        ),
        (
            {
                "u": _Parts.u,
                "y": _Parts.y,
                "structures": {"s": Structure((), parts=frozenset({"lid"}))},
            },
            "structure 's': no part 'lid'; the plant has none",
        ),
        (
            {"u": _Parts.u, "y": _Parts.y, "structures": {"s": Structure(free=())}},
            "structure 's': `free` is empty; name the parameters that a match may change",
        ),
    ):
        with pytest.raises(PlantError, match=message):
            type("Faulty", (Plant,), body)


@given(output=st.floats(25.0, 90.0), period=st.sampled_from([0.5, 1.0, 2.0]))
def test_the_linearised_plant_is_that_of_small_movements(
    output: float, period: float
) -> None:
    rig = MASSIVE.parameters(conductance=0.7)
    linear = linearised(rig, output, period)
    states, u = linear.rest
    assert read(rig, states) == pytest.approx(output, abs=1e-9)
    np.testing.assert_allclose(advance(rig, states, u, period), states, atol=1e-7)
    np.testing.assert_allclose(
        advance(rig, states, u + 1e-3, period),
        states + 1e-3 * linear.B[:, 0],
        atol=1e-9 + 1e-8,
    )
    bump = np.array([1e-3, -2e-3])
    np.testing.assert_allclose(
        advance(rig, states + bump, u, period), states + linear.A @ bump, atol=1e-7
    )


def test_where_a_plant_cannot_be_held_is_said() -> None:
    with pytest.raises(
        PlantError, match="no PWM between -255 and 255 holds it at 300 °C"
    ):
        rest_at(Peltier.model().parameters(), 300.0)
    with pytest.raises(PlantError, match="holds it at 60 °C"):
        rest_at(
            MASSIVE.parameters(
                sink_convection=0.0, conductance=0.0, seebeck=0.0, supply=0.001
            ),
            60.0,
        )


def test_an_observer_finds_the_state_no_sensor_shows() -> None:
    """The heat sink, 15 K off at first, within three times what the observer says of itself.

    And the surprises have the variance that was forecast.
    """
    rig = MASSIVE.parameters()
    u = 120.0 * np.sign(np.sin(np.arange(1200) / 60.0))
    truth = simulate_driven(
        rig,
        u,
        states=begin(rig, 22.85, starts={"sink": 311.0}),
        sensor=Sensor(noise=0.1).realise(1200, 1.0, 4),
    )
    observer = Observer(
        rig, truth.output[0], period=1.0, drift=[1e-3, 1e-3], start=[0.2, 10.0]
    )
    ratios = []
    for k in range(u.size):
        surprise, variance = observer.correct(truth.output[k])
        ratios.append(surprise**2 / variance)
        if k < u.size - 1:
            observer.predict(u[k])
    sink_error = abs(observer.states[1] - truth.states[-2, 1])
    assert sink_error < 3 * np.sqrt(observer.covariance[1, 1]) < 1.0
    # The mean of 1200 squares of normal numbers is 1 ± 0.04.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)


class Quick(Plant, name="quick"):
    """A lag that may be far shorter than what is asked about it."""

    y = Output(unit="m", noise=0.01, span=(-100.0, 100.0))
    u = Drive(unit="V", limits=(-10.0, 10.0), noise=0.1)
    x = State(unit="m", span=(-50.0, 50.0))
    lag = Parameter(unit="s", default=0.1, bounds=(1e-4, 10.0), positive=True)
    structures = {"lag": Structure(free=("lag",))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """One line."""
        return Equations(
            rates={self.x: (2.0 * self.u - self.x) / self.lag},
            output=self.x,
            start={self.x: self.y},
        )


class Positioner(Plant, name="positioner"):
    """A motor behind a slow amplifier; its speed is in °/s, hundreds of times the volts."""

    title = "Positioner"
    angle = Output(unit="deg", noise=0.3, span=(-200.0, 200.0))
    volts = Drive(unit="V", limits=(-12.0, 12.0), noise=0.3)
    theta = State(unit="deg", span=(-200.0, 200.0), scale=10.0)
    omega = State(unit="deg/s", span=(-3000.0, 3000.0), scale=100.0)
    held = State(unit="V", span=(-12.0, 12.0), scale=1.0)
    gain = Parameter(
        unit="deg/s/V", default=200.0, bounds=(20.0, 1000.0), positive=True
    )
    lag = Parameter(unit="s", default=0.1, bounds=(0.02, 1.0), positive=True)
    late = Parameter(unit="s", default=0.03, bounds=(0.01, 0.2), positive=True)
    back = Parameter(unit="V s/deg", default=0.01, bounds=(0.0, 0.1), least=0.0)
    structures = {"in degrees": Structure(free=("gain", "lag"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """The voltage that is left over turns the load."""
        rates = {
            self.theta: self.omega,
            self.omega: (self.gain * self.held - self.omega) / self.lag,
            self.held: (self.volts - self.back * self.omega - self.held) / self.late,
        }
        start = {self.theta: self.angle, self.omega: 0, self.held: self.volts}
        return Equations(rates=rates, output=self.theta, start=start)


@pytest.mark.parametrize(("back", "steps"), [(0.0, 3), (0.01, 5)])
def test_steps_follow_time_constants_whatever_the_units_of_the_states(
    back: float, steps: int
) -> None:
    """Without feedback the shortest is 0.03 s: 5 ms / (0.06 · 0.03 s) = 2.8 steps. With it the two modes
    have a modulus of 31.6 1/s, 2.6 steps, which a norm of the balanced matrix bounds within a factor of two.
    Norms of the matrix as it stands, with its 2000 °/s²/V, ask for 167."""
    assert Positioner.model().parameters(back=back).steps(0.005) == steps


def test_a_time_that_is_too_long_for_one_call_is_passed_in_parts() -> None:
    """A lag of 1 ms after 10 s: at rest, and a plant that one call can simulate gives the same bits as that call."""
    quick = Quick.model().parameters(lag=1e-3)
    with pytest.raises(PlantError, match="too short for a period of 10 s"):
        advance(quick, np.zeros(1), 3.0, 10.0)
    assert advance_long(quick, np.zeros(1), 3.0, 10.0)[0] == pytest.approx(6.0, 1e-9)
    slow = quick.replace(lag=4.0)
    after_call = advance(slow, np.zeros(1), 3.0, 10.0)
    assert advance_long(slow, np.zeros(1), 3.0, 10.0).tolist() == after_call.tolist()
    with pytest.raises(PlantError, match="finite and positive"):
        advance_long(slow, np.zeros(1), 3.0, math.nan)


@given(st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_the_bound_on_eigenvalues_holds_in_any_units(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((n, n)) * (rng.random((n, n)) < 0.6)
    scales = 10.0 ** rng.uniform(-4.0, 4.0, n)
    bound = spectral_bound(matrix * scales[:, None] / scales)
    # A double eigenvalue is computed to the square root of the rounding.
    assert bound >= np.abs(np.linalg.eigvals(matrix)).max() * (1.0 - 1e-6) - 1e-12
