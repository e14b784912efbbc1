"""Plants as files of somebody else, for tests that load them by their path."""

from __future__ import annotations

from pathlib import Path

HEATED = '''\
"""A heated block in a room whose temperature is measured; nobody knows its loop."""

from twinmatch.dynamics import Disturbance, Drive, Equations, Output, Parameter, Plant, State, Structure


class Heated(Plant, name="NAME"):
    """Heat in, heat lost to the room."""

    temperature = Output(unit="°C", noise=0.1, span=(-10.0, 120.0))
    heater = Drive(unit="%", limits=(0.0, 100.0), noise=1.0)
    room = Disturbance(unit="°C", default=20.0)
    block = State(unit="°C", span=(0.0, 110.0))
    gain = Parameter(unit="W/%", default=0.5, bounds=(0.05, 5.0), positive=True)
    loss = Parameter(unit="W/K", default=1.0, bounds=(0.1, 10.0), positive=True)
    capacity = Parameter(unit="J/K", default=100.0, bounds=(10.0, 1000.0), positive=True)
    structures = {"block": Structure(free=("gain", "capacity"))}

    def equations(self, parts):
        lost = self.loss * (self.block - self.room)
        return Equations(
            rates={self.block: (self.gain * self.heater - lost) / self.capacity},
            output=self.block,
            start={self.block: self.temperature},
        )
'''


def plant_file(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """Write the heated block into `folder` under a name of its own, with some of its text changed."""
    text = HEATED.replace("NAME", name)
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / f"{name}.py"
    path.write_text(text, encoding="utf-8")
    return path
