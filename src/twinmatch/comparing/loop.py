"""The linear loop for the stability margin: the plant around an operating point, and the PID.

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
from typing import NamedTuple

import numpy as np

from twinmatch.comparing.errors import DiscriminationError
from twinmatch.comparing.graph_symbol import GraphSymbol
from twinmatch.comparing.margin import stability_margin
from twinmatch.dynamics import Parameters, PidGains, gains_of, linearised
from twinmatch.signals import FloatArray

__all__ = ["Scales", "loop_controller", "loop_margin", "loop_plant"]


class Scales(NamedTuple):
    """Scales of output and input in margin and ν-gap; only the ratio of the two matters."""

    output: float
    """In the output's unit."""
    input: float
    """In the input's unit."""

    @property
    def ratio(self) -> float:
        """Factor that scales a response from input to output."""
        return self.input / self.output

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


def loop_controller(gains: PidGains, *, scales: Scales | None = None) -> GraphSymbol:
    """The PID from deviation to input, P + I·Ts/(z − 1) + D·(z − 1)/(Ts·z), scaled.

    Raises:
        DiscriminationError: as `Scales.of`.
    """
    return _controller(gains, scales or Scales.of(gains))


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
    gains = gains or gains_of(parameters.model.plant, 1.0)
    return _plant(parameters, operating_point, gains, scales or Scales.of(gains))


def loop_margin(
    parameters: Parameters,
    operating_point: float,
    gains: PidGains | None = None,
    *,
    scales: Scales | None = None,
) -> float:
    """Stability margin b(P, C) of the running PID with a candidate's plant at a set-point, 0 (unstable) to 1.

    The PID stabilises every plant whose ν-gap to this one, in the same units, is smaller. Arguments and
    errors as `loop_plant`.
    """
    gains = gains or gains_of(parameters.model.plant, 1.0)
    scales = scales or Scales.of(gains)
    plant = _plant(parameters, operating_point, gains, scales)
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
def _plant(parameters: Parameters, operating_point: float, gains: PidGains, scales: Scales) -> GraphSymbol:
    linear = linearised(parameters, operating_point, gains.period)
    if gains.saturates(linear.rest.input):
        plant = parameters.model.plant
        msg = (
            f"stability margin: {plant.title} needs {linear.rest.input:.4g} {plant.drive.unit} at "
            f"{operating_point:g} {plant.output.unit}, beyond the controller's limits {gains.low:g} and "
            f"{gains.high:g}; give an operating point at which it can be held"
        )
        raise DiscriminationError(msg)
    scaled = linear.C * (scales.input / scales.output)
    return GraphSymbol.of_state_space(linear.A, linear.B, scaled, np.zeros((1, 1)), gains.period)
