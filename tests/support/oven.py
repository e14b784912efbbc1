"""The oven of `foreign_rig.py` as a plant file, and its topics as the sampler's map."""

from __future__ import annotations

from pathlib import Path

RIG = Path(__file__).with_name("foreign_rig.py")
PERIOD = 0.1
HOLD = 80
MAP = {
    "reference": "/oven/set_point:data",
    "output": "/oven/temperature",
    "input": "/oven/heater:data",
}

_OVEN = '''\
"""An oven: heat in, heat lost to the room."""

from twinmatch.dynamics import Drive, Equations, Output, Parameter, PidGains, Plant, State, Structure


class Oven(Plant, name="oven"):
    """One heat capacity."""

    title = "oven"
    temperature = Output(unit="°C", noise=0.02, span=(-10.0, 120.0))
    heater = Drive(unit="%", limits=(0.0, 100.0), noise=1.0)
    block = State(unit="°C", span=(0.0, 110.0))
    gain = Parameter(unit="W/%", default=0.8, bounds=(0.05, 5.0), positive=True)
    loss = Parameter(unit="W/K", default=1.0, bounds=(0.1, 10.0), positive=True)
    capacity = Parameter(unit="J/K", default=6.0, bounds=(0.5, 100.0), positive=True)
    structures = {"block": Structure(free=("gain", "capacity"))}
    loop = PidGains(4.0, 2.0, 0.0, 1.0, low=0.0, high=100.0, period=0.1)

    def equations(self, parts):
        """Energy."""
        heat = self.gain * self.heater - self.loss * (self.block - 20)
        return Equations(
            rates={self.block: heat / self.capacity}, output=self.block, start={self.block: self.temperature}
        )
'''


def oven_file(folder: Path) -> Path:
    """The plant file, written into a folder."""
    path = folder / "oven.py"
    path.write_text(_OVEN)
    return path
