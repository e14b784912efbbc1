"""The rig's loop as the stability margin sees it: the plant around an operating point, and the PID.

The plant P, from PWM to the temperature the camera sees, is the twin's own physics linearised where the
set-point is held, sampled as the loop samples it: the PWM acts on the temperature one tick later. The PID
answers a temperature in its own tick. Both are exact for small movements in which nothing is limited.

The plant might also be had from the identified models, as the quotient of set-point → temperature and
set-point → control. It is not: the zeros of an estimated set-point → control become poles of that
quotient, and where noise puts one outside the unit circle a good twin counts as an unstable plant.

Margin and ν-gap depend on the units of PWM and temperature. Here the PWM counts in units of its limit and
the temperature in proportional bands, the deviation that alone drives the controller to that limit
(255/38.57 = 6.6 °C on the rig). In these units the controller's gain is 1 where it neither integrates nor
differentiates, so that neither side of the loop outweighs the other, and the margin is not far below the
largest that any choice of units gives.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from twinmatch.discrimination.errors import DiscriminationError
from twinmatch.discrimination.graph_symbol import GraphSymbol
from twinmatch.discrimination.margin import stability_margin
from twinmatch.plant import Driver, PidGains, PlantState, RigParameters, advance
from twinmatch.signals import KELVIN, FloatArray

__all__ = ["Scales", "rig_controller", "rig_margin", "rig_plant"]

KELVIN_STEP, COUNT_STEP = 0.1, 1.0
"""Steps of the central differences: the physics is nearly quadratic, so no shorter ones are needed."""

STEADY = 1e-9
"""How far the plant may move in a tick and still count as at rest, K."""

MOST_STEPS = 30


class Scales(NamedTuple):
    """What counts as 1 in margin and ν-gap of the rig's loop; only the ratio of the two matters."""

    output: float
    """Of the output, on the rig °C."""
    input: float
    """Of the input, on the rig PWM counts."""

    @classmethod
    def of(cls, gains: PidGains) -> Scales:
        """The limit of the controller, and the deviation that its proportional part answers with it.

        Raises:
            DiscriminationError: the controller has no proportional part.
        """
        if gains.proportional == 0:
            msg = "stability margin: the controller has no proportional gain to scale by; give the scales"
            raise DiscriminationError(msg)
        return cls(gains.limit / abs(gains.proportional), gains.limit)


def rig_controller(gains: PidGains | None = None, *, scales: Scales | None = None) -> GraphSymbol:
    """The PID from deviation to PWM, P + I·Ts/(z − 1) + D·(z − 1)/(Ts·z), scaled.

    Raises:
        DiscriminationError: as `Scales.of`.
    """
    gains = gains or PidGains()
    return _controller(gains, scales or Scales.of(gains))


def rig_plant(
    parameters: RigParameters,
    operating_point: float,
    gains: PidGains | None = None,
    *,
    driver: Driver | None = None,
    scales: Scales | None = None,
) -> GraphSymbol:
    """The plant from PWM to temperature around a set-point (°C) it is held at, scaled.

    A sink with mass is in balance too; one without convection never is, and is taken at ambient.

    Args:
        parameters: the candidate's physics.
        operating_point: the temperature it is held at, °C.
        gains: of the running controller: its period and limit, and the scales if none are given.
        driver: between PWM and module.
        scales: units of margin and ν-gap.

    Raises:
        DiscriminationError: no PWM within the controller's limit holds the plant there; as `Scales.of`.
        PlantError: the physics cannot be computed with this period.
    """
    gains = gains or PidGains()
    return _plant(parameters, operating_point, gains, driver or Driver(), scales or Scales.of(gains))


def rig_margin(
    parameters: RigParameters,
    operating_point: float,
    gains: PidGains | None = None,
    *,
    driver: Driver | None = None,
    scales: Scales | None = None,
) -> float:
    """b(P, C) of the running PID on a candidate's plant around a set-point (°C), 0 (not stable) to 1.

    The PID stabilises every plant whose ν-gap to this one, in the same units, is smaller. Arguments and
    errors as `rig_plant`.
    """
    gains = gains or PidGains()
    scales = scales or Scales.of(gains)
    plant = _plant(parameters, operating_point, gains, driver or Driver(), scales)
    return stability_margin(plant, _controller(gains, scales))


@lru_cache(maxsize=16)
def _controller(gains: PidGains, scales: Scales) -> GraphSymbol:
    ratio = scales.output / scales.input
    parts = [(np.array([gains.proportional]), np.array([1.0]))]
    if gains.integral != 0:
        parts.append((np.array([gains.integral * gains.period]), np.array([1.0, -1.0])))
    if gains.derivative != 0:
        parts.append((gains.derivative / gains.period * np.array([1.0, -1.0]), np.array([1.0, 0.0])))
    numerator: FloatArray = np.zeros(1)
    denominator: FloatArray = np.ones(1)
    for n, d in parts:
        total = np.polyadd(np.convolve(numerator, d), np.convolve(n, denominator))
        numerator = np.asarray(total, dtype=np.float64)
        denominator = np.convolve(denominator, d)
    return GraphSymbol.of_polynomials(denominator, [numerator * ratio], gains.period)


@lru_cache(maxsize=64)  # a candidate stays in the family for many verdicts
def _plant(
    parameters: RigParameters, operating_point: float, gains: PidGains, driver: Driver, scales: Scales
) -> GraphSymbol:
    rig = _Rig(parameters, driver, gains.period)
    state, pwm = _balance(rig, operating_point, gains.limit)
    moves = [True, parameters.sink_has_mass, parameters.sensor_lag > 0]
    slopes = np.column_stack([_slope(rig, state, pwm, k) for k in range(4)])[moves]
    seen = np.zeros((1, len(slopes)))
    seen[0, -1 if parameters.sensor_lag > 0 else 0] = scales.input / scales.output
    return GraphSymbol.of_state_space(
        slopes[:, [*moves, False]], slopes[:, 3:], seen, np.zeros((1, 1)), gains.period
    )


class _Rig(NamedTuple):
    parameters: RigParameters
    driver: Driver
    period: float

    def after(self, values: FloatArray) -> FloatArray:
        """Plate, sink and sensor one period later, K, from these three and the PWM."""
        plate, sink, sensor, pwm = (float(v) for v in values)
        state = PlantState(plate, sink, sensor)
        there = advance(self.parameters, state, pwm, self.period, self.driver)
        return np.array([there.plate, there.sink, there.sensor])


def _slope(rig: _Rig, state: FloatArray, pwm: float, which: int) -> FloatArray:
    """Derivative of the state after a tick by plate, sink, sensor (0 to 2) or PWM (3), shape (3,)."""
    step = np.zeros(4)
    step[which] = COUNT_STEP if which == 3 else KELVIN_STEP
    here = np.append(state, pwm)
    change: FloatArray = rig.after(here + step) - rig.after(here - step)
    return change / (2 * float(step[which]))


def _balance(rig: _Rig, operating_point: float, limit: float) -> tuple[FloatArray, float]:
    """State (K) and PWM at which nothing moves, by Newton's method on sink and PWM."""
    plate = operating_point + KELVIN
    state = np.array([plate, rig.parameters.ambient, plate])
    pwm = 0.0
    free = [1, 3] if rig.parameters.sink_has_mass and rig.parameters.sink_convection > 0 else [3]
    kept = slice(0, len(free))
    for _ in range(MOST_STEPS):
        moved = (rig.after(np.append(state, pwm)) - state)[kept]
        if np.abs(moved).max() <= STEADY and abs(pwm) < limit:
            return state, pwm
        slopes = np.column_stack([_slope(rig, state, pwm, k)[kept] for k in free])
        if 1 in free:
            slopes[1, 0] -= 1.0
        if np.linalg.matrix_rank(slopes) < len(free):
            break
        step = np.linalg.solve(slopes, -moved)
        pwm = float(np.clip(pwm + step[-1], -1.5 * limit, 1.5 * limit))
        if 1 in free:
            state[1] = np.clip(state[1] + step[0], 0.5 * rig.parameters.ambient, 2 * rig.parameters.ambient)
    msg = (
        f"stability margin: no PWM within ±{limit:g} holds this rig at {operating_point:g} °C; "
        "give an operating point it can be held at"
    )
    raise DiscriminationError(msg)
