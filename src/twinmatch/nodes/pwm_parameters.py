"""The parameters of the PWM bridge, and the limits they define."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.links.pwm_link import LinkSettings
from twinmatch.nodes.gate_parameters import gate_limits, gate_table
from twinmatch.nodes.parameters import Parameter
from twinmatch.safety import GuardLimits

__all__ = ["PWM_PARAMETERS", "limits_from"]

_G, _L = GuardLimits(), LinkSettings()

PWM_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("port", "/dev/ttyACM0", "Serial port of the PWM board."),
    Parameter(
        "timeout", _L.timeout, "Longest wait for an answer of the board, by the wall clock.", "s", 0.01, 2.0
    ),
    Parameter("retries", _L.retries, "Retries of an unanswered request.", "", 0, 10),
    Parameter("repeat", 0.1, "Interval at which the command is repeated.", "s", 0.02, 0.2),
    Parameter("frame_id", "driver", "Frame of plant/pwm_applied."),
    *gate_table(_G, "PWM", stale="; a flat-field correction takes 1 s"),
)


def limits_from(values: Mapping[str, Any]) -> GuardLimits:
    """The guard's limits from checked parameter values.

    Raises:
        SafetyError: values contradict each other.
    """
    return gate_limits(_G, values)
