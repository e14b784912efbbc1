"""The twin beside a foreign rig: the parameter files of sampler and twin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinmatch.launching.plan import LivePlan, Wiring
from twinmatch.launching.processes import LaunchError
from twinmatch.nodes.sampler import sources_of, understood
from twinmatch.parameters.declared import ParameterError, Values, check, flattened, render
from twinmatch.parameters.loop import closing_of
from twinmatch.parameters.twin import at_period, read_settings, twin_table, values_of
from twinmatch.plants import find_plant, written_name
from twinmatch.sessions.column_map import ColumnMap
from twinmatch.sessions.documents import DocumentError, read_yaml
from twinmatch.sessions.mapped import by_signal
from twinmatch.sessions.sampling import REFERENCE

__all__ = ["AttachPlan", "attach_plan"]

SAMPLER = "sampler"


@dataclass(frozen=True)
class AttachPlan(LivePlan):
    """A run beside a foreign rig: a sampler in place of bridge and controller."""

    sampler: Path = Path()
    """Parameter file of the sampler."""

    @property
    def driver(self) -> str:
        """The sampler: it drives nothing, but is the source of the samples."""
        return SAMPLER

    @property
    def wiring(self) -> Wiring:
        """How it is started."""
        return Wiring("twinmatch.nodes.sampler", "")

    def rig_arguments(self, addresses: Mapping[str, str]) -> list[str]:  # noqa: ARG002
        """ROS arguments of the sampler."""
        return ["--ros-args", "--params-file", str(self.sampler)]

    def wait_for(self, readers: str) -> list[str]:
        """As for a rig, but longer: a rig that runs on its own is not held up while a twin is compiled."""
        return ["-p", f"{SAMPLER}:readers:={readers}", "-p", f"{SAMPLER}:readers_timeout:=180.0"]


def attach_plan(
    folder: Path,
    said: ColumnMap,
    *,
    config: Path | None = None,
    twin_config: Path | None = None,
    candidates: Path | None = None,
    session: Path | None = None,
) -> AttachPlan:
    """Combine files and command line, and write the parameter files of the processes.

    Args:
        folder: where the files are written.
        said: plant, sampling period and map of the command line; they override the file.
        config: parameter file with a section `sampler`, and perhaps `recorder`.
        twin_config: parameter file of the twin; plant and sampling period default to those of the sampler.
        candidates: file of initial candidates.
        session: folder to record into.

    Raises:
        TwinmatchError: something does not exist, or parameters contradict each other.
    """
    values = _sampler_values(config, said)
    plant = find_plant(values["plant"])
    driven = REFERENCE not in sources_of(SAMPLER, values)
    held = read_settings(twin_config, written_name(plant), driven=driven)
    if driven and held.gains is not None:
        msg = (
            f"{twin_config}: the twin runs in closed loop, but no topic is mapped to its reference; map one, "
            "or set loop: unknown"
        )
        raise LaunchError(msg)
    settings = at_period(held, values["period"], twin_config)
    twin_values = values_of(settings)
    sampler, twin = folder / "sampler.yaml", folder / "twin.yaml"
    sampler.write_text(render(SAMPLER, understood(SAMPLER, values), values), "utf-8")
    table = twin_table(plant, twin_values["structure"], closing_of(twin_values))
    twin.write_text(render("/**", table, twin_values), "utf-8")
    return AttachPlan(
        config=config or sampler,
        session=session,
        twin_config=twin,
        candidates=candidates,
        plant=plant.name,
        sampler=sampler,
    )


def _sampler_values(config: Path | None, said: ColumnMap) -> Values:
    """The sampler's parameters, checked."""
    given = _section(config) if config is not None else {}
    if said.plant:
        given["plant"] = said.plant
    if said.period is not None:
        given["period"] = said.period
    place = str(config) if config is not None else "attach"
    plant = find_plant(str(given.get("plant", "peltier")))
    for signal, source in by_signal(plant, said.sources).items():
        given[f"map.{signal}"] = source.text
    values = check(place, understood(place, given), given)
    sources_of(place, values)
    return values


def _section(path: Path) -> dict[str, Any]:
    """The sampler's section of a parameter file."""
    try:
        content = read_yaml(path)
    except DocumentError as error:
        raise ParameterError(str(error)) from error
    section = content.get(SAMPLER) if isinstance(content, dict) else None
    parameters = section.get("ros__parameters") if isinstance(section, dict) else None
    if not isinstance(parameters, dict):
        msg = f"{path}: has no section {SAMPLER} with ros__parameters; see config/attach.yaml"
        raise ParameterError(msg)
    return flattened(parameters)
