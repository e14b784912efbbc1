"""The H-bridge between the PWM command and the Peltier module."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from twinmatch.plant.parameters import PlantError

__all__ = ["Driver"]

PWM_LIMIT = 255.0


@dataclass(frozen=True, slots=True)
class Driver:
    """Bridge: its mean voltage is ±supply·|u|/255, behind a resistance, with a limit of the mean current.

    How much of its switching the module feels is `RigParameters.drive_ripple`.

    Raises:
        PlantError: a value is not finite or has an impossible sign.
    """

    supply: float = 12.0
    """Amplitude of the bridge output, V."""
    bridge_resistance: float = 0.1
    """On-resistance of the bridge, Ω."""
    current_limit: float = 5.0
    """Largest magnitude of the current, A."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = 0.0 if field.name == "bridge_resistance" else math.ulp(0.0)
            if not (math.isfinite(value) and value >= least):
                msg = f"driver: {field.name} is {value}; it must be finite and positive"
                raise PlantError(msg)

    @property
    def volts_per_count(self) -> float:
        """Mean bridge voltage of one PWM count, V; positive heats the plate."""
        return self.supply / PWM_LIMIT
