"""The parameters of the PWM bridge and the limits they make."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.links.pwm_port import LinkSettings
from twinmatch.nodes.parameters import Parameter
from twinmatch.safety import ClockLimits, GuardLimits, RunawayLimits

__all__ = ["PWM_PARAMETERS", "limits_from"]

_G, _R, _L, _C = GuardLimits(), RunawayLimits(), LinkSettings(), ClockLimits()

PWM_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("port", "/dev/ttyACM0", "Serial port of the PWM board."),
    Parameter("timeout", _L.timeout, "Wait for one answer of the board, by the wall clock.", "s", 0.01, 2.0),
    Parameter("retries", _L.retries, "Repetitions of a request without an answer.", "", 0, 10),
    Parameter("repeat", 0.1, "A command is sent again after this time.", "s", 0.02, 0.2),
    Parameter("frame_id", "driver", "Frame of plant/pwm_applied."),
    Parameter(
        "command_timeout", _G.command_timeout, "Zero after this time without a command.", "s", 0.1, 10.0
    ),
    Parameter(
        "temperature_timeout",
        _G.temperature_timeout,
        "Zero when the newest temperature is older; a flat-field correction takes 1 s.",
        "s",
        0.1,
        60.0,
    ),
    Parameter(
        "clock_timeout",
        _C.patience,
        "Zero when /clock stands still so long, by the wall clock.",
        "s",
        0.1,
        10.0,
    ),
    Parameter("highest", _G.highest, "Over-temperature.", "°C", -50.0, 150.0),
    Parameter("lowest", _G.lowest, "Under-temperature.", "°C", -50.0, 150.0),
    Parameter(
        "runaway.hysteresis", _R.hysteresis, "Error of the loop that is always tolerated.", "°C", 0.1, 100.0
    ),
    Parameter(
        "runaway.patience",
        _R.patience,
        "Error beyond it, summed over time without progress.",
        "°C·s",
        1.0,
        1e5,
    ),
    Parameter("runaway.gain", _R.gain, "Movement towards the set-point that is progress.", "°C", 0.01, 100.0),
    Parameter("runaway.gain_time", _R.gain_time, "Time for that movement.", "s", 1.0, 3600.0),
    Parameter(
        "runaway.wrong_way", _R.wrong_way, "Movement away at full drive that is a fault.", "°C", 0.1, 100.0
    ),
    Parameter(
        "runaway.full_drive", _R.full_drive, "PWM from which the drive counts as full.", "PWM", 1.0, 255.0
    ),
)


def limits_from(values: Mapping[str, Any]) -> GuardLimits:
    """The guard's limits from checked parameter values.

    Raises:
        SafetyError: values that do not go together.
    """
    runaway = {n.removeprefix("runaway."): v for n, v in values.items() if n.startswith("runaway.")}
    return GuardLimits(
        command_timeout=values["command_timeout"],
        temperature_timeout=values["temperature_timeout"],
        highest=values["highest"],
        lowest=values["lowest"],
        runaway=RunawayLimits(**runaway),
    )
