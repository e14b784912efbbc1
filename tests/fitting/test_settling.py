"""How much of a window's start is simulated and not compared."""

from __future__ import annotations

import numpy as np
import pytest

from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    Sensor,
    State,
    Structure,
    begin,
    simulate_driven,
)
from twinmatch.fitting import fit_structure
from twinmatch.fitting.structures import settling_samples
from twinmatch.plants import Incubator, Peltier, TCLab, TCLabBoth
from twinmatch.signals import Window


class ShutTank(Plant, name="shut_tank"):
    """A tank without an outlet: it only integrates."""

    height = Output(unit="dm", noise=0.01, span=(0.0, 10.0))
    inflow = Drive(unit="l/s", limits=(0.0, 4.0), noise=0.05)
    level = State(unit="dm", span=(0.0, 10.0))
    area = Parameter(unit="dm²", default=6.0, bounds=(1.0, 30.0), positive=True)
    structures = {"shut": Structure(free=("area",))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """What flows in stays."""
        return Equations(
            rates={self.level: self.inflow / self.area},
            output=self.level,
            start={self.level: self.height},
        )


@pytest.mark.parametrize(
    ("plant", "period", "samples"),
    [
        (Peltier, 1.0, 60),
        (Incubator, 3.0, 20),
        (Incubator, 60.0, 5),
        (Incubator, 0.1, 60),
        (TCLabBoth, 5.0, 12),
        (TCLab, 5.0, 60),
        (ShutTank, 1.0, 60),
    ],
)
def test_it_is_a_part_of_the_time_constant(
    plant: type[Plant], period: float, samples: int
) -> None:
    """Six tenths of 100 s, between 5 and 60 samples; an integrator has no time constant.

    Where one heater of a kit is driven, its temperature behind the sensor's lag is neither read nor estimated.
    """
    assert settling_samples(plant, period) == samples


def test_a_heater_that_is_on_in_the_first_minutes_only_shows_its_bed() -> None:
    """Sampled every 3 s, 60 samples are three minutes: all in which the heater was on would be left out.

    The readings have a fifth of the noise that the file says, and a part in a hundred of the movement.
    """
    truth = Incubator.model("air and bed").parameters(
        bed_heat_capacity=300.0, bed_conductance=2.5, box_conductance=0.8
    )
    heater = np.repeat([1.0, 0.0], [40, 160])
    rooms = np.full((heater.size, 1), 21.0)
    run = simulate_driven(
        truth,
        heater,
        states=begin(truth, 21.0, disturbances=rooms[0]),
        period=3.0,
        disturbances=rooms,
        sensor=Sensor(noise=0.02).realise(heater.size, 3.0, 7),
    )
    window = Window(
        np.full(heater.size, 21.0),
        run.output,
        heater,
        period=3.0,
        disturbances=rooms,
    )
    fitted = fit_structure([window], truth.model, law=None).parameters
    for name in truth.model.structure.free:
        assert fitted[name] == pytest.approx(truth[name], rel=0.03), name
