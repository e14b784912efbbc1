"""The parts of a live run: plant, configuration, virtual plant if any, and where to record.

Beside a foreign rig, a sampler takes the place of bridge and controller: see `attach_plan`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Final

from twinmatch.launching.processes import LaunchError
from twinmatch.links.kit_link import require_package, require_port
from twinmatch.nodes.step import PATIENCE
from twinmatch.parameters.declared import render
from twinmatch.parameters.sampler import (
    SAMPLER,
    sampler_values,
    twin_beside,
    understood,
)
from twinmatch.parameters.twin import table_of, values_of
from twinmatch.sampling.sources import SignalMap


def ros_arguments(values: Mapping[str, object], *files: object) -> list[str]:
    """The words after `--ros-args` for parameter files and, above them, these values."""
    words = [("--params-file", f"{file}") for file in files]
    words += [("-p", f"{name}:={value}") for name, value in values.items()]
    return ["--ros-args", *chain.from_iterable(words)]


@dataclass(frozen=True)
class VirtualPlan:
    """A virtual rig instead of a real one."""

    speed: float = 1.0
    """Plant time per wall time, at most; infinite: as fast as the machine allows."""
    faults: tuple[str, ...] = ()
    """Faults to inject, such as `drive-lost@300`."""
    board: str = "auto"
    seed: int = 0
    plant: str = "peltier"

    @property
    def arguments(self) -> list[str]:
        """Command-line arguments for `twinmatch virtual-rig`."""
        speed = "max" if self.speed == math.inf else f"{self.speed:g}"
        words = ["--in-step", "--plant", self.plant, "--speed", speed]
        words += ["--board", self.board, "--seed", f"{self.seed}"]
        for fault in self.faults:
            words += ["--fault", fault]
        return words


@dataclass(frozen=True)
class Wiring:
    """How to start the process that drives a plant."""

    program: str
    """Program with the plant's nodes and the controller."""
    bridge: str
    """Name of the node that holds the serial port."""
    check: Callable[[str], None] = lambda _: None
    """Checks the port (empty: not given) before anything is started; raises if it cannot be used."""
    more: Mapping[str, str] = field(default_factory=dict)
    """More parameters of its nodes."""

    def settings(self, addresses: Mapping[str, str]) -> dict[str, str]:
        """Address parameters of its nodes."""
        values = dict(self.more)
        if "camera" in addresses:
            host, port = addresses["camera"].rsplit(":", 1)
            values |= {"camera_bridge:host": host, "camera_bridge:port": port}
        if "serial" in addresses:
            values[f"{self.bridge}:port"] = addresses["serial"]
        return values


def _check_kit(port: str) -> None:
    require_package()
    if port:
        require_port(port)


WIRINGS: Final = {
    "peltier": Wiring("rig", "pwm_bridge"),
    "tclab": Wiring("tclab_rig", "tclab_bridge", _check_kit),
    "tclab-both": Wiring(
        "tclab_rig", "tclab_bridge", _check_kit, {"tclab_bridge:plant": "tclab-both"}
    ),
}
"""By plant name."""

_IN_STEP: Final = (
    "camera_bridge:stall_timeout",
    "camera_bridge:stale_after",
    "pwm_bridge:clock_timeout",
    "tclab_bridge:clock_timeout",
    "tclab_bridge:deadline",
)
"""Deadlines by the wall clock, which mean nothing while the plant waits for its graph."""


@dataclass(frozen=True)
class LivePlan:
    """One live run."""

    config: Path
    """Parameter file with a section per node."""
    session: Path | None = None
    """Folder to record into; None: nothing is recorded."""
    twin_config: Path | None = None
    """Parameter file of the twin's nodes; None: their defaults."""
    virtual: VirtualPlan | None = None
    candidates: Path | None = None
    overrides: Mapping[str, str] = field(default_factory=dict)
    """More parameters of the rig's nodes, such as `controller:profile.repeat` → `false`."""
    plant: str = "peltier"
    """Name of the plant."""
    port: str = ""
    """Serial port of the plant, if not that of the configuration."""
    keep_driving: bool = False
    """Whether the run continues when its session cannot be written."""

    @property
    def wiring(self) -> Wiring:
        """How its nodes are started.

        Raises:
            LaunchError: twinmatch has no nodes to drive this plant.
        """
        if self.plant not in WIRINGS:
            msg = f"plant {self.plant!r}: no nodes to drive it; choose one of {', '.join(WIRINGS)}"
            raise LaunchError(msg)
        return WIRINGS[self.plant]

    @property
    def driver(self) -> str:
        """Name of the process that publishes the samples."""
        return "rig"

    @property
    def in_step(self) -> bool:
        """Whether the plant waits for the graph, because it may run faster than real time."""
        return self.virtual is not None and self.virtual.speed > 1

    def rig_arguments(self, addresses: Mapping[str, str]) -> list[str]:
        """ROS arguments of bridges and controller; `addresses` are those that the virtual rig prints."""
        places = {**addresses, "serial": self.port} if self.port else addresses
        patient = dict.fromkeys(_IN_STEP if self.in_step else (), PATIENCE)
        values = {
            "controller:plant": self.plant,
            **self.wiring.settings(places),
            **patient,
            **self.overrides,
        }
        return ros_arguments({**values, **self._time()}, self.config)

    def wait_for(self, readers: str) -> list[str]:
        """ROS arguments to hold back the first sample until these nodes (space-separated) subscribe."""
        patience = 30.0 if self.virtual is None else 180.0
        return [
            "-p",
            f"controller:readers:={readers}",
            "-p",
            f"controller:wait_timeout:={patience}",
        ]

    def clock_arguments(self, addresses: Mapping[str, str]) -> list[str]:
        """ROS arguments of the node that publishes the virtual rig's clock."""
        patient = {"patience": PATIENCE} if self.in_step else {}
        return ros_arguments({"address": addresses["clock"], **patient})

    def twin_arguments(self) -> list[str]:
        """ROS arguments of the twin's nodes."""
        files = () if self.twin_config is None else (self.twin_config,)
        nodes = () if self.candidates is None else ("discriminator", "matcher")
        candidate_files = {f"{node}:candidates": self.candidates for node in nodes}
        return ros_arguments({**candidate_files, **self._time()}, *files)

    def recorder_arguments(self, session: Path, continues: str = "") -> list[str]:
        """ROS arguments of the recorder of a session, which may continue another one."""
        values = {
            "recorder:folder": session.absolute().parent,
            "recorder:name": session.name,
        }
        if continues:
            values["recorder:continues"] = continues
        return ros_arguments({**values, **self._time()}, self.config)

    @property
    def simulated(self) -> bool:
        """Whether the nodes have the time of /clock. At real time they need none, as on a real plant: each of
        its messages would cost every node as much as a sample."""
        return self.virtual is not None and self.virtual.speed != 1

    def _time(self) -> dict[str, str]:
        return {"use_sim_time": "true"} if self.simulated else {}


@dataclass(frozen=True)
class AttachPlan(LivePlan):
    """A run beside a foreign rig: a sampler in place of bridge and controller."""

    sampler: Path = Path()
    """Parameter file of the sampler."""
    sim_time: bool = False
    """Whether the rig is a simulated one whose time is on /clock."""

    @property
    def simulated(self) -> bool:
        """Whether that is so."""
        return self.sim_time

    @property
    def driver(self) -> str:
        """The sampler: it drives nothing, but is the source of the samples."""
        return SAMPLER

    @property
    def wiring(self) -> Wiring:
        """How it is started."""
        return Wiring(SAMPLER, "")

    def rig_arguments(self, addresses: Mapping[str, str]) -> list[str]:  # noqa: ARG002
        """ROS arguments of the sampler."""
        return ros_arguments(self._time(), self.sampler)

    def wait_for(self, readers: str) -> list[str]:
        """As for a rig, but longer: a rig that runs on its own is not held up while a twin is compiled."""
        return [
            "-p",
            f"{SAMPLER}:readers:={readers}",
            "-p",
            f"{SAMPLER}:readers_timeout:=180.0",
        ]


def attach_plan(
    folder: Path,
    given_map: SignalMap,
    *,
    config: Path | None = None,
    twin_config: Path | None = None,
    candidates: Path | None = None,
    session: Path | None = None,
    source: str = "",
) -> AttachPlan:
    """Combine files and command line, and write the parameter files of the processes.

    Args:
        folder: where the files are written.
        given_map: plant, sampling period and map of the command line; they override the file.
        config: parameter file with a section `sampler`, and perhaps `recorder`; `use_sim_time` of the sampler
            is that of all nodes.
        twin_config: parameter file of the twin; plant and sampling period default to those of the sampler.
        candidates: file of initial candidates.
        session: folder to record into.
        source: URL of the source; empty: that of the file, or ROS.

    Raises:
        TwinmatchError: something does not exist, or parameters contradict each other.
    """
    values, sim_time = sampler_values(config, given_map, source)
    settings = twin_beside(values, twin_config)
    plant = settings.plant
    twin_values = values_of(settings)
    sampler = folder / "sampler.yaml"
    twin = folder / "twin.yaml"
    sampler.write_text(render(SAMPLER, *understood(SAMPLER, values)), "utf-8")
    twin.write_text(render("/**", table_of(settings), twin_values), "utf-8")
    return AttachPlan(
        config=config or sampler,
        session=session,
        twin_config=twin,
        candidates=candidates,
        plant=plant.name,
        sampler=sampler,
        sim_time=sim_time,
    )
