"""The parameters of the controller, and the profile they define."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.control import ControlError, Profile
from twinmatch.dynamics import Plant, PlantError
from twinmatch.nodes.node import READERS
from twinmatch.parameters.declared import Parameter
from twinmatch.parameters.loop import loop_parameters
from twinmatch.plants import Peltier, find_plant, written_name

__all__ = ["changed_profile", "controller_table", "profile_from"]

_LEVELS = (1 / 7, 3 / 7, 5 / 7, 3 / 7)
"""Levels of the default profile, as fractions of the range of sensible set-points."""


def controller_table(plant: type[Plant] = Peltier) -> tuple[Parameter, ...]:
    """Name, default, meaning, unit and range of the parameters of a plant's controller.

    Raises:
        PlantError: the plant file defines no controller.
    """
    if plant.loop is None:
        raise PlantError(
            f"plant {plant.name}: its file has no `loop`; only a plant with one can be controlled"
        )
    y, (low, high) = plant.output, plant.output.span
    first, last = y.set_points or y.span
    levels = [first + (last - first) * share for share in _LEVELS]
    return (
        Parameter("plant", written_name(plant), "The plant: its name, or the file that defines it."),
        *loop_parameters(plant),
        Parameter(
            "reference_source",
            "profile",
            "Where the set-point comes from: the profile below, or the topic plant/reference.",
            choices=("profile", "topic"),
        ),
        Parameter(
            "profile.levels", levels, "Set-points, one after the other.", y.unit, low, high, changeable=True
        ),
        Parameter(
            "profile.holds", [300.0] * 4, "How long each of them is held.", "s", 0.1, 1e6, changeable=True
        ),
        Parameter(
            "profile.repeat", True, "Repeat the profile; otherwise the last level is held.", changeable=True
        ),
        Parameter(
            "profile.ramp",
            0.0,
            "Rate at which the set-point changes; 0: in steps.",
            f"{y.unit}/s",
            0.0,
            high - low,
            changeable=True,
        ),
        Parameter(
            "profile.lowest",
            max(low, y.safe[0]),
            "Lowest accepted set-point, also from the topic; it can only be raised while the node runs.",
            y.unit,
            low,
            high,
            changeable=True,
        ),
        Parameter(
            "profile.highest",
            min(high, y.safe[1]),
            "Highest accepted set-point; it can only be lowered while the node runs.",
            y.unit,
            low,
            high,
            changeable=True,
        ),
        Parameter("exit_at_end", False, "Exit at the end of a profile that is not repeated."),
        Parameter("max_age", 2.0, "A reading older than this switches the output off.", "s", 0.05, 10.0),
        Parameter(
            "command_period",
            0.25,
            "Interval at which the command is repeated; the bridge treats silence as a fault.",
            "s",
            0.01,
            1.0,
        ),
        Parameter("wait_for", 0, "Readers of plant/sample to wait for before the first tick.", "", 0, 100),
        READERS,
        Parameter("wait_timeout", 10.0, "Longest wait for them, by the wall clock.", "s", 0.1, 3600.0),
    )


def profile_from(values: Mapping[str, Any]) -> Profile | None:
    """The profile from checked parameter values; None if the set-point comes from the topic.

    Raises:
        ControlError: the profile cannot be run, a range is empty, or `exit_at_end` would never take effect.
    """
    low, high = values["profile.lowest"], values["profile.highest"]
    unit = find_plant(values["plant"]).output.unit
    if not low < high:
        msg = f"controller: profile.lowest {low:g} must be below profile.highest {high:g} {unit}"
        raise ControlError(msg)
    if values["reference_source"] == "topic":
        if values["exit_at_end"]:
            raise ControlError("controller: exit_at_end needs a profile; a topic has no end")
        return None
    if values["exit_at_end"] and values["profile.repeat"]:
        raise ControlError(
            "controller: with profile.repeat, exit_at_end would never take effect; set one of them to false"
        )
    group = {n.removeprefix("profile."): v for n, v in values.items() if n.startswith("profile.")}
    group["levels"], group["holds"] = tuple(group["levels"]), tuple(group["holds"])
    return Profile(**group, unit=unit)


def changed_profile(before: Mapping[str, Any], values: Mapping[str, Any]) -> Profile | None:
    """The profile from values some of which were changed while the controller runs.

    The range of set-points was chosen for this rig when the controller started, so it can only shrink.

    Raises:
        ControlError: as for `profile_from`, or the range would grow.
    """
    for name, outside in (("lowest", float.__lt__), ("highest", float.__gt__)):
        was, wanted = before[f"profile.{name}"], values[f"profile.{name}"]
        if outside(wanted, was):
            msg = (
                f"controller: profile.{name} can only narrow the range while it runs; {wanted:g} "
                f"is outside {was:g}; restart the controller with it"
            )
            raise ControlError(msg)
    return profile_from(values)
