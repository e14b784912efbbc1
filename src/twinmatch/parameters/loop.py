"""The parameters of the running loop: sampling period and PID. Controller and twin must agree on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from twinmatch.dynamics import FROM_PLANT_FILE, Drive, FromPlantFile, LoopGains, PidGains, Plant, gains_for
from twinmatch.parameters.declared import Setting, group

UNKNOWN: Final = "unknown"
"""Value of `loop` for a twin that is driven by the recorded input."""

_MOST = 1e4
"""Largest gain; a larger one means a wrong unit."""


def unit_of(drive: Drive) -> str:
    """Unit of the control; its name where it has none."""
    return drive.unit or drive.name


def closing_of(values: Mapping[str, Any]) -> LoopGains:
    """The loop that parameter `loop` selects; without it, that of the plant file."""
    return None if values.get("loop", FromPlantFile.LOOP.value) == UNKNOWN else FROM_PLANT_FILE


def loop_parameters(plant: type[Plant], closing: LoopGains = FROM_PLANT_FILE) -> tuple[Setting, ...]:
    """The sampling period, and the gains of the plant's controller if it is known."""
    usual = plant.loop.period if plant.loop else 1.0
    has = gains_for(plant, usual, closing)
    period = Setting("period", usual, "Sampling period of the loop.", "s", 0.01, 60.0)
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
            Setting(f"pid.{name}", getattr(has, name), text, unit, *_span(getattr(has, name)))
            for name, text, unit in gains
        ),
        Setting("pid.back_calculation", has.back_calculation, "Anti-windup gain.", "1/s", 0.0, 1e3),
        Setting("pid.low", has.low, "Lower output limit.", u, low, high),
        Setting("pid.high", has.high, "Upper output limit.", u, low, high),
        Setting(
            "pid.on_measurement",
            has.on_measurement,
            "Derivative of the measurement instead of the error: no kick at set-point steps.",
        ),
    )


def pid_gains(values: Mapping[str, Any]) -> PidGains:
    """The controller from checked parameter values that include the gains."""
    return PidGains(period=values["period"], **group(values, "pid."))


def _span(default: float) -> tuple[float, float]:
    """The range of a gain, without the wrong sign, which would drive the plant away from its set-point."""
    return (0.0, _MOST) if default >= 0 else (-_MOST, 0.0)
