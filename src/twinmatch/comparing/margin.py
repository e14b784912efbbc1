"""The stability margin b(P, C), and the linear loop of plant and PID for it (Vinnicombe 1993).

A controller C that stabilises P stabilises every plant whose ν-gap to P is smaller than b(P, C), and there
is a plant at exactly that distance which it does not stabilise. b is the inverse of the H∞ norm of the four
transfer functions of the loop, ‖[P; 1](1 + C P)⁻¹[1 C]‖∞, and 0 when the loop is not stable.

With one plant input this norm is a quotient of polynomials: for P = N/d and C = M/c, with G = [d; N] and
K = [c, M], it is |G||K|/|K G|, where K G = c d + M N is the closed loop's characteristic polynomial. So its
largest value is found in the same way as the largest chordal distance, and to the same accuracy, from the
closed loop's poles; and whether these are stable is decided in exact arithmetic.

The plant P, from input to measured output, consists of the twin's own equations linearised where the
set-point is held, sampled as in the loop: the input acts on the output one tick later. The PID responds to an
output in the same tick. Both are exact for small deviations that stay within the limits.

The plant could also be computed from the identified models, as the quotient of set-point → output and
set-point → input. It is not: the zeros of an estimated set-point → input become poles of that quotient, and
where noise puts one outside the unit circle a good twin counts as an unstable plant.

Margin and ν-gap depend on the units of input and output. Here the input is in units of its limit and the
output in proportional bands, the deviation at which the proportional part alone reaches that limit
(255/38.57 = 6.6 °C on the rig). In these units the controller's gain is 1 where it neither integrates nor
differentiates, so that neither side of the loop outweighs the other, and the margin is not far below the
largest that any choice of units gives.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from twinmatch.comparing import chordal
from twinmatch.comparing.graph_symbol import GraphSymbol, graph_symbol, spectral_roots
from twinmatch.comparing.matrix_gap import matrix_margin
from twinmatch.comparing.nu_gap import common_period
from twinmatch.comparing.polynomials import (
    DiscriminationError,
    is_hurwitz,
    multiply,
    scale_of,
    split,
)
from twinmatch.comparing.state_space import StateSpace, inputs_of
from twinmatch.compiled import compiled
from twinmatch.dynamics import Parameters, PidGains, linearised, pid_of
from twinmatch.signals import FloatArray, OperatingPoint


def stability_margin(plant: Any, controller: Any) -> float:
    """Stability margin b(P, C) of the loop u = −C y around y = P u, 0 (not stable) to 1.

    It depends on the units of u and y: scale them so that equal numbers are equally important.

    Args:
        plant: as for `nu_gap`.
        controller: the same, with as many inputs as the plant has outputs, and the reverse; a `GraphSymbol`
            of the transposed controller. `StateSpace.of` makes it of a law.

    Raises:
        DiscriminationError: numbers of signals that do not fit, different time bases, or a system that
            is not a valid model.
    """
    if inputs_of(plant) > 1:
        return matrix_margin(StateSpace.of(plant), StateSpace.of(controller))
    g = graph_symbol(plant)
    k = (
        controller
        if isinstance(controller, GraphSymbol)
        else graph_symbol(_transpose(controller))
    )
    if g.outputs != k.outputs:
        raise DiscriminationError(
            f"stability margin: the plant has {g.outputs} outputs, the controller {k.outputs} inputs; "
            "they must be equal"
        )
    common_period(g, k)
    products = [multiply(a, b) for a, b in zip(g.column, k.column, strict=True)]
    characteristic = [sum(terms) for terms in zip(*products, strict=True)]
    if not is_hurwitz(characteristic):
        return 0.0
    inner = split([characteristic], scale_of(g.column) * scale_of(k.column))
    return _smallest(
        g.coefficients, k.coefficients, inner, spectral_roots([characteristic])
    )


def _transpose(controller: Any) -> Any:
    """Transpose a controller with one output into a model with one input."""
    if isinstance(controller, StateSpace):
        return controller.transposed
    if getattr(controller, "noutputs", None) != 1 or controller.ninputs == 1:
        return controller
    if hasattr(controller, "A"):
        matrices = (controller.A, controller.C, controller.B, controller.D)
        return type(controller)(*(matrix.T for matrix in matrices), controller.dt)
    numerators = [[entry] for entry in controller.num_array[0]]
    denominators = [[entry] for entry in controller.den_array[0]]
    return type(controller)(numerators, denominators, controller.dt)


@compiled
def _smallest(
    plant: tuple[FloatArray, FloatArray],
    controller: tuple[FloatArray, FloatArray],
    inner: tuple[FloatArray, FloatArray],
    poles: Any,
) -> float:
    """Smallest |K G|/|K||G| over all frequencies; `inner` is K G."""
    high = chordal.with_powers_of_j(inner[0])
    low = chordal.with_powers_of_j(inner[1])
    unity = np.ones((1, 1))
    # as the search needs it: a sum of squares |G|²|K|² over |K G|², largest where the margin is smallest
    products = chordal.with_powers_of_j(_products(plant[0], controller[0]))
    grid = chordal.frequency_grid(poles, poles[:0])
    _, place = chordal.highest(
        chordal.with_derivatives(high),
        chordal.with_derivatives(unity),
        chordal.with_derivatives(products),
        grid,
    )
    signed_plant = (
        chordal.with_powers_of_j(plant[0]),
        chordal.with_powers_of_j(plant[1]),
    )
    signed_controller = (
        chordal.with_powers_of_j(controller[0]),
        chordal.with_powers_of_j(controller[1]),
    )
    return chordal.exact_distance(signed_plant, signed_controller, (high, low), place)


@compiled
def _products(rows1: FloatArray, rows2: FloatArray) -> FloatArray:
    """Every polynomial of the one times every one of the other, shape (m1 m2, n1 + n2 + 1)."""
    products = np.zeros(
        (rows1.shape[0] * rows2.shape[0], rows1.shape[1] + rows2.shape[1] - 1)
    )
    for i in range(rows1.shape[0]):
        for j in range(rows2.shape[0]):
            for a in range(rows1.shape[1]):
                for b in range(rows2.shape[1]):
                    products[i * rows2.shape[0] + j, a + b] += rows1[i, a] * rows2[j, b]
    return products


class Scales(NamedTuple):
    """Scales of output and input in margin and ν-gap; only the ratio of the two matters."""

    output: OperatingPoint
    """In the output's unit; of several outputs one each."""
    input: OperatingPoint
    """In the input's unit, likewise."""

    @property
    def ratio(self) -> float:
        """Factor that scales the response of a single loop from input to output."""
        return float(np.divide(self.input, self.output))

    @classmethod
    def of(cls, gains: PidGains) -> Scales:
        """Half the controller's range, and the deviation at which the proportional part reaches it.

        Raises:
            DiscriminationError: the controller has no proportional part.
        """
        if gains.proportional == 0:
            msg = "stability margin: the controller has no proportional gain to scale by; give scales"
            raise DiscriminationError(msg)
        limit = (gains.high - gains.low) / 2
        return cls(limit / abs(gains.proportional), limit)


@lru_cache(maxsize=16)
def loop_controller(gains: PidGains, *, scales: Scales | None = None) -> GraphSymbol:
    """The PID from deviation to input, P + I·Ts/(z − 1) + D·(z − 1)/(Ts·z), scaled.

    Raises:
        DiscriminationError: as `Scales.of`.
    """
    scales = scales or Scales.of(gains)
    unity = np.array([1.0])
    z = np.array([1.0, 0.0])
    z_minus_1 = np.array([1.0, -1.0])
    parts = [(np.array([gains.proportional]), unity)]
    if gains.integral != 0:
        parts.append((np.array([gains.integral * gains.period]), z_minus_1))
    if gains.derivative != 0:
        parts.append((gains.derivative / gains.period * z_minus_1, z))
    numerator: FloatArray = np.zeros(1)
    denominator: FloatArray = np.ones(1)
    for part_numerator, part_denominator in parts:
        total = np.polyadd(
            np.convolve(numerator, part_denominator),
            np.convolve(part_numerator, denominator),
        )
        numerator = np.asarray(total, dtype=np.float64)
        denominator = np.convolve(denominator, part_denominator)
    scaled = numerator * float(np.divide(scales.output, scales.input))
    return GraphSymbol.of_polynomials(denominator, [scaled], gains.period)


@lru_cache(maxsize=64)  # a candidate stays in the family for many verdicts
def loop_plant(
    parameters: Parameters,
    operating_point: float,
    gains: PidGains | None = None,
    *,
    scales: Scales | None = None,
) -> GraphSymbol:
    """The plant from input to output around a set-point at which it is held, scaled.

    Args:
        parameters: the candidate's physics.
        operating_point: the output it is held at.
        gains: those of the running controller: they give the period, the limits, and the scales unless given.
            Default: those of the plant file, at 1 s.
        scales: units of margin and ν-gap.

    Raises:
        DiscriminationError: the controller's limits cannot hold the plant there; as `Scales.of`.
        PlantError: no input holds it there, or the plant cannot be computed with this period.
    """
    gains = gains or pid_of(parameters.model.plant)
    scales = scales or Scales.of(gains)
    linear = linearised(parameters, operating_point, gains.period)
    if gains.saturates(linear.rest.input):
        plant = parameters.model.plant
        raise DiscriminationError(
            f"stability margin: {plant.title} needs {linear.rest.input:.4g} {plant.drive.unit} at "
            f"{operating_point:g} {plant.output.unit}, beyond the controller's limits {gains.low:g} and "
            f"{gains.high:g}; give an operating point at which it can be held"
        )
    return GraphSymbol.of_state_space(
        linear.A, linear.B, linear.C * scales.ratio, np.zeros((1, 1)), gains.period
    )
