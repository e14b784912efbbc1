"""The parts of a live run: plant, configuration, virtual plant if any, and where to record."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from twinmatch.launching.processes import LaunchError
from twinmatch.links.kit_link import require_package, require_port
from twinmatch.nodes.step import PATIENCE

__all__ = ["WIRINGS", "LivePlan", "VirtualPlan", "Wiring"]


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

    module: str
    """Module with the plant's nodes and the controller, run as one process."""
    bridge: str
    """Name of the node that holds the serial port."""
    check: Callable[[str], None] = lambda _: None
    """Checks the port (empty: not given) before anything is started; raises if it cannot be used."""

    def settings(self, addresses: Mapping[str, str]) -> dict[str, str]:
        """Address parameters of its nodes."""
        found: dict[str, str] = {}
        if "camera" in addresses:
            host, port = addresses["camera"].rsplit(":", 1)
            found |= {"camera_bridge:host": host, "camera_bridge:port": port}
        if "serial" in addresses:
            found[f"{self.bridge}:port"] = addresses["serial"]
        return found


def _check_kit(port: str) -> None:
    require_package()
    if port:
        require_port(port)


WIRINGS: Final = {
    "peltier": Wiring("twinmatch.nodes.rig", "pwm_bridge"),
    "tclab": Wiring("twinmatch.nodes.tclab_rig", "tclab_bridge", _check_kit),
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
    def simulated_time(self) -> bool:
        """Whether the nodes run on the virtual rig's clock."""
        return self.virtual is not None

    @property
    def in_step(self) -> bool:
        """Whether the plant waits for the graph, because it may run faster than real time."""
        return self.virtual is not None and self.virtual.speed > 1

    def rig_arguments(self, addresses: Mapping[str, str]) -> list[str]:
        """ROS arguments of bridges and controller; `addresses` are those that the virtual rig prints."""
        words = ["--ros-args", "--params-file", str(self.config), "-p", f"controller:plant:={self.plant}"]
        found = dict(addresses)
        if self.port:
            found["serial"] = self.port
        for name, value in self.wiring.settings(found).items():
            words += ["-p", f"{name}:={value}"]
        patient = dict.fromkeys(_IN_STEP if self.in_step else (), f"{PATIENCE}")
        for name, value in {**patient, **self.overrides}.items():
            words += ["-p", f"{name}:={value}"]
        return [*words, *self._time()]

    def wait_for(self, readers: str) -> list[str]:
        """ROS arguments to hold back the first sample until these nodes (space-separated) subscribe."""
        patience = 30.0 if self.virtual is None else 180.0
        return ["-p", f"controller:readers:={readers}", "-p", f"controller:wait_timeout:={patience}"]

    def twin_arguments(self) -> list[str]:
        """ROS arguments of the twin's nodes."""
        words = ["--ros-args"]
        if self.twin_config is not None:
            words += ["--params-file", str(self.twin_config)]
        if self.candidates is not None:
            words += ["-p", f"discriminator:candidates:={self.candidates}"]
        return [*words, *self._time()]

    def recorder_arguments(self, session: Path) -> list[str]:
        """ROS arguments of the recorder."""
        words = ["--ros-args", "--params-file", str(self.config)]
        words += [
            "-p",
            f"recorder:folder:={session.absolute().parent}",
            "-p",
            f"recorder:name:={session.name}",
        ]
        return [*words, *self._time()]

    def _time(self) -> list[str]:
        return ["-p", "use_sim_time:=true"] if self.simulated_time else []
