"""The parameters of the running loop: sample time and PID. Controller and twin have to agree on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.dynamics import Drive, PidGains, Plant
from twinmatch.nodes.parameters import Parameter

__all__ = ["loop_parameters", "pid_gains", "unit_of"]

_MOST = 1e4
"""A gain beyond this is a mistake of the unit."""


def unit_of(drive: Drive) -> str:
    """Unit of the control; its name where it has none."""
    return drive.unit or drive.name


def loop_parameters(plant: type[Plant]) -> tuple[Parameter, ...]:
    """The sample time, and the gains of the plant's controller if that is known."""
    has = plant.loop
    period = Parameter("period", has.period if has else 1.0, "Sample time of the loop.", "s", 0.01, 60.0)
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
    """The controller from checked parameter values.

    Raises:
        PlantError: values no controller has.
    """
    gains = {n.removeprefix("pid."): v for n, v in values.items() if n.startswith("pid.")}
    return PidGains(period=values["period"], **gains)


def _span(default: float) -> tuple[float, float]:
    """A gain of the wrong sign would drive the plant away from its set-point."""
    return (0.0, _MOST) if default >= 0 else (-_MOST, 0.0)
