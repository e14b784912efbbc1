"""The parameters of the running loop: sample time and PID. Controller and twin have to agree on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from twinmatch.dynamics import FILED, Closing, Drive, Filed, PidGains, Plant, gains_for
from twinmatch.nodes.parameters import Parameter

__all__ = ["UNKNOWN", "closing_of", "loop_parameters", "pid_gains", "unit_of"]

UNKNOWN: Final = "unknown"
"""What `loop` says of a twin that is driven by the recorded input."""

_MOST = 1e4
"""A gain beyond this is a mistake of the unit."""


def unit_of(drive: Drive) -> str:
    """Unit of the control; its name where it has none."""
    return drive.unit or drive.name


def closing_of(values: Mapping[str, Any]) -> Closing:
    """What parameter `loop` says among given values; without it the plant file decides."""
    return None if values.get("loop", Filed.LOOP.value) == UNKNOWN else FILED


def loop_parameters(plant: type[Plant], closing: Closing = FILED) -> tuple[Parameter, ...]:
    """The sample time, and the gains of the plant's controller if that is known."""
    usual = plant.loop.period if plant.loop else 1.0
    has = gains_for(plant, usual, closing)
    period = Parameter("period", usual, "Sample time of the loop.", "s", 0.01, 60.0)
    if has is None:
        return (period,)
    u, y = unit_of(plant.drive), plant.output.unit
    low, high = plant.drive.limits
    gains = (
        ("proportional", "Proportional gain of the running PID.", f"{u}/{y}"),
        ("integral", "Integral gain.", f"{u}/({y}·s)"),
        ("derivative", "Derivative gain.", f"{u}·s/{y}"),
    )
    return (
        period,
        *(
            Parameter(f"pid.{name}", getattr(has, name), text, unit, *_span(getattr(has, name)))
            for name, text, unit in gains
        ),
        Parameter("pid.back_calculation", has.back_calculation, "Anti-windup gain.", "1/s", 0.0, 1e3),
        Parameter("pid.low", has.low, "Least output.", u, low, high),
        Parameter("pid.high", has.high, "Greatest output.", u, low, high),
        Parameter("pid.on_measurement", has.on_measurement, "Whether steps of the set-point do not kick D."),
    )


def pid_gains(values: Mapping[str, Any]) -> PidGains:
    """The controller from checked parameter values, among which there are gains.

    Raises:
        PlantError: values no controller has.
    """
    gains = {n.removeprefix("pid."): v for n, v in values.items() if n.startswith("pid.")}
    return PidGains(period=values["period"], **gains)


def _span(default: float) -> tuple[float, float]:
    """A gain of the wrong sign would drive the plant away from its set-point."""
    return (0.0, _MOST) if default >= 0 else (-_MOST, 0.0)
