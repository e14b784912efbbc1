"""What a live run consists of: the rig's configuration, the virtual rig if there is one, where to record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["LivePlan", "VirtualPlan"]


@dataclass(frozen=True)
class VirtualPlan:
    """A virtual rig instead of a real one."""

    speed: float = 1.0
    """Plant time per wall time."""
    faults: tuple[str, ...] = ()
    """Such as `drive-lost@300`."""
    board: str = "auto"
    seed: int = 0

    @property
    def arguments(self) -> list[str]:
        """For `twinmatch virtual-rig`."""
        words = ["--speed", f"{self.speed:g}", "--board", self.board, "--seed", f"{self.seed}"]
        for fault in self.faults:
            words += ["--fault", fault]
        return words


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

    @property
    def simulated_time(self) -> bool:
        """Whether the nodes live by the virtual rig's clock."""
        return self.virtual is not None

    def rig_arguments(self, addresses: Mapping[str, str]) -> list[str]:
        """ROS arguments of bridges and controller; `addresses` are those the virtual rig printed."""
        words = ["--ros-args", "--params-file", str(self.config)]
        if addresses:
            host, port = addresses["camera"].rsplit(":", 1)
            words += ["-p", f"camera_bridge:host:={host}", "-p", f"camera_bridge:port:={port}"]
            words += ["-p", f"pwm_bridge:port:={addresses['serial']}"]
            words += ["-p", f"plant_pace:address:={addresses['clock']}"]
        for name, value in self.overrides.items():
            words += ["-p", f"{name}:={value}"]
        return [*words, *self._time()]

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
