"""The parameters of the controller, and the profile they make."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinmatch.control import ControlError, Profile
from twinmatch.dynamics import Plant, PlantError
from twinmatch.nodes.loop_parameters import loop_parameters
from twinmatch.nodes.node import READERS
from twinmatch.nodes.parameters import Parameter
from twinmatch.plants import Peltier, find_plant, written_name

__all__ = ["changed_profile", "controller_table", "profile_from"]

_WAY = (1 / 7, 3 / 7, 5 / 7, 3 / 7)
"""Where in the range of sensible set-points the usual profile goes."""


def controller_table(plant: type[Plant] = Peltier) -> tuple[Parameter, ...]:
    """Name, default, meaning, unit and range of the parameters of a plant's controller.

    Raises:
        PlantError: the plant file names no controller, so there is none to run.
    """
    if plant.loop is None:
        raise PlantError(
            f"plant {plant.name}: its file has no `loop`; only a plant with one can be controlled"
        )
    y, (low, high) = plant.output, plant.output.span
    first, last = y.set_points or y.span
    levels = [first + (last - first) * share for share in _WAY]
    return (
        Parameter("plant", written_name(plant), "Which plant: its name, or the file it is in."),
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
            "profile.repeat", True, "Begin again at the end; otherwise the last level stays.", changeable=True
        ),
        Parameter(
            "profile.ramp",
            0.0,
            "Rate at which the set-point moves; 0: at once.",
            f"{y.unit}/s",
            0.0,
            high - low,
            changeable=True,
        ),
        Parameter(
            "profile.lowest",
            max(low, y.safe[0]),
            "Lowest set-point that is accepted, also from the topic; while the node runs it can only rise.",
            y.unit,
            low,
            high,
            changeable=True,
        ),
        Parameter(
            "profile.highest",
            min(high, y.safe[1]),
            "Highest set-point that is accepted; while the node runs it can only fall.",
            y.unit,
            low,
            high,
            changeable=True,
        ),
        Parameter("exit_at_end", False, "End when the profile, not repeated, is over."),
        Parameter("max_age", 2.0, "A reading older than this switches the output off.", "s", 0.05, 10.0),
        Parameter(
            "command_period",
            0.25,
            "The command is repeated so often; the bridge takes silence for a fault.",
            "s",
            0.01,
            1.0,
        ),
        Parameter("wait_for", 0, "Readers of plant/sample to wait for before the first tick.", "", 0, 100),
        READERS,
        Parameter("wait_timeout", 10.0, "Longest wait for them, by the wall's clock.", "s", 0.1, 3600.0),
    )


def profile_from(values: Mapping[str, Any]) -> Profile | None:
    """The profile from checked parameter values; None if the set-point comes from the topic.

    Raises:
        ControlError: a profile that cannot be run, an empty range, an end that never comes.
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
            "controller: exit_at_end waits for ever with profile.repeat; set one of them to false"
        )
    group = {n.removeprefix("profile."): v for n, v in values.items() if n.startswith("profile.")}
    group["levels"], group["holds"] = tuple(group["levels"]), tuple(group["holds"])
    return Profile(**group, unit=unit)


def changed_profile(before: Mapping[str, Any], values: Mapping[str, Any]) -> Profile | None:
    """The profile from values of which some were changed while the controller runs.

    The range of set-points was given for this rig when the controller was started, so it can only shrink.

    Raises:
        ControlError: as for `profile_from`; the range would grow.
    """
    for name, outside in (("lowest", float.__lt__), ("highest", float.__gt__)):
        was, wanted = before[f"profile.{name}"], values[f"profile.{name}"]
        if outside(wanted, was):
            msg = (
                f"controller: profile.{name} can only narrow the range while it runs; {wanted:g} "
                f"is beyond {was:g}; restart the controller with it"
            )
            raise ControlError(msg)
    return profile_from(values)
