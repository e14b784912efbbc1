"""The parameters of the output guard, and the limits they define."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from twinmatch.nodes.parameters import Parameter
from twinmatch.safety import ClockLimits, GuardLimits, RunawayLimits

__all__ = ["gate_limits", "gate_table"]

_C = ClockLimits()


def gate_table(usual: GuardLimits, unit: str, *, stale: str = "") -> tuple[Parameter, ...]:
    """Name, default, meaning, unit and range of the limits of a plant whose drive has the unit `unit`.

    `stale` is appended to the description of the temperature's timeout and explains its default.
    """
    runaway = usual.runaway
    low, high = usual.commands
    most = max(abs(low), abs(high))
    return (
        Parameter(
            "command_timeout",
            usual.command_timeout,
            "Zero after this time without a command.",
            "s",
            0.1,
            10.0,
        ),
        Parameter(
            "temperature_timeout",
            usual.temperature_timeout,
            f"Zero when the newest temperature is older than this{stale}.",
            "s",
            0.1,
            60.0,
        ),
        Parameter(
            "clock_timeout",
            _C.patience,
            "Zero when /clock stands still for this long, by the wall clock.",
            "s",
            0.1,
            10.0,
        ),
        Parameter("highest", usual.highest, "Over-temperature limit.", "°C", -50.0, 150.0),
        Parameter("lowest", usual.lowest, "Under-temperature limit.", "°C", -50.0, 150.0),
        Parameter(
            "runaway.hysteresis",
            runaway.hysteresis,
            "Control error that is always tolerated.",
            "°C",
            0.1,
            100.0,
        ),
        Parameter(
            "runaway.patience",
            runaway.patience,
            "Integral of the error beyond it, without progress, that is a fault.",
            "°C·s",
            1.0,
            1e5,
        ),
        Parameter(
            "runaway.gain",
            runaway.gain,
            "Movement towards the set-point that counts as progress.",
            "°C",
            0.01,
            100.0,
        ),
        Parameter("runaway.gain_time", runaway.gain_time, "Time for that movement.", "s", 1.0, 3600.0),
        Parameter(
            "runaway.wrong_way",
            runaway.wrong_way,
            "Movement away at full drive that is a fault.",
            "°C",
            0.1,
            100.0,
        ),
        Parameter(
            "runaway.full_drive",
            runaway.full_drive,
            "Magnitude from which the drive counts as full.",
            unit,
            most / 255.0,
            most,
        ),
    )


def gate_limits(usual: GuardLimits, values: Mapping[str, Any]) -> GuardLimits:
    """The guard's limits from checked parameter values; the other limits are those of `usual`.

    Raises:
        SafetyError: values contradict each other.
    """
    runaway = {n.removeprefix("runaway."): v for n, v in values.items() if n.startswith("runaway.")}
    return replace(
        usual,
        command_timeout=values["command_timeout"],
        temperature_timeout=values["temperature_timeout"],
        highest=values["highest"],
        lowest=values["lowest"],
        runaway=RunawayLimits(**runaway),
    )
