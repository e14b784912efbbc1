"""The parameters of what guards an output, and the limits they make."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from twinmatch.nodes.parameters import Parameter
from twinmatch.safety import ClockLimits, GuardLimits, RunawayLimits

__all__ = ["gate_limits", "gate_table"]

_C = ClockLimits()


def gate_table(usual: GuardLimits, unit: str, *, stale: str = "") -> tuple[Parameter, ...]:
    """Name, default, meaning, unit and range of the limits of a plant whose drive counts in `unit`.

    `stale` says what the default of the temperature's timeout is made for.
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
            f"Zero when the newest temperature is older{stale}.",
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
        Parameter("highest", usual.highest, "Over-temperature.", "°C", -50.0, 150.0),
        Parameter("lowest", usual.lowest, "Under-temperature.", "°C", -50.0, 150.0),
        Parameter(
            "runaway.hysteresis",
            runaway.hysteresis,
            "Error of the loop that is always tolerated.",
            "°C",
            0.1,
            100.0,
        ),
        Parameter(
            "runaway.patience",
            runaway.patience,
            "Error beyond it, summed over time without progress.",
            "°C·s",
            1.0,
            1e5,
        ),
        Parameter(
            "runaway.gain",
            runaway.gain,
            "Movement towards the set-point that is progress.",
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
            f"{unit} from which the drive counts as full.",
            unit,
            most / 255.0,
            most,
        ),
    )


def gate_limits(usual: GuardLimits, values: Mapping[str, Any]) -> GuardLimits:
    """The guard's limits from checked parameter values; what is no parameter stays as usual.

    Raises:
        SafetyError: values that do not go together.
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
