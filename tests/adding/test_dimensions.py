"""Units of a plant's equations: what is right is let pass, what is wrong is named."""

from __future__ import annotations

from pathlib import Path
from zlib import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plant_files import plant_file
from tests.support.plants import Lag, Motor, Tank
from twinmatch.adding.dimensions import Dimensions
from twinmatch.dynamics import Drive, Equations, Output, Parameter, Plant, State, Structure
from twinmatch.plants import PLANTS, Peltier, find_plant


def told(plant: type[Plant]) -> list[str]:
    looked = Dimensions(plant)
    for structure in plant.structures.values():
        looked.check(structure.parts)
    return [found.what for found in looked.findings.values()]


@pytest.mark.parametrize("plant", [Lag, Motor, Tank, *PLANTS.values()], ids=lambda plant: plant.name)
def test_plants_whose_units_are_right_pass(plant: type[Plant]) -> None:
    assert told(plant) == []


def test_a_file_whose_units_are_right_passes(tmp_path: Path) -> None:
    assert told(find_plant(str(plant_file(tmp_path, "units_right")))) == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'gain = Parameter(unit="W/%"',
            'gain = Parameter(unit="V/%"',
            "the rate of block: .* added to .* in V",
        ),
        (
            'unit="J/K", default=100',
            'unit="J", default=100',
            "the rate of block: has the unit s.*, but needs °C per second",
        ),
        (
            'loss = Parameter(unit="W/K"',
            'loss = Parameter(unit="kW/K"',
            "0.001 times the unit|1000 times the unit",
        ),
        (
            'capacity = Parameter(unit="J/K"',
            'capacity = Parameter(unit="kJ/K"',
            "has 0.001 times the unit °C per",
        ),
        ('State(unit="°C"', 'State(unit="K"', "block is in K and room in °C|room is in °C and block in K"),
        (
            "start={self.block: self.temperature}",
            "start={self.block: self.temperature**2}",
            "the start of block",
        ),
        ("self.gain * self.heater", "self.gain * self.room**100000", "added to or compared"),
        ("output=self.block", "output=self.block * self.loss", "the output: has the unit W, but needs °C"),
        ("self.loss * (self.block - self.room)", "self.loss * (self.block**4 - self.room**4)", "a power of"),
        (
            "self.loss * (self.block - self.room)",
            "self.loss * (self.block - self.room) * __import__('sympy').exp(self.block)",
            "has the unit K",
        ),
    ],
)
def test_units_that_are_wrong_are_reported(tmp_path: Path, old: str, new: str, message: str) -> None:
    name = f"units_wrong_{crc32(repr((old, new)).encode())}"
    import re

    found = told(find_plant(str(plant_file(tmp_path, name, (old, new)))))
    assert any(re.search(message, what) for what in found), found


def test_the_size_of_a_high_power_is_not_judged(tmp_path: Path) -> None:
    change = ("self.gain * self.heater", "self.gain * self.heater**100000")  # (0.01)**100000 underflows
    assert told(find_plant(str(plant_file(tmp_path, "units_high", change)))) == []


def test_what_a_number_hides_is_not_judged_but_noted(tmp_path: Path) -> None:
    plant = find_plant(str(plant_file(tmp_path, "units_hidden", ("self.loss * (", "0.0123 * self.loss * ("))))
    looked = Dimensions(plant)
    looked.check(frozenset())
    assert looked.findings == {}
    assert looked.unchecked in ({"0.0123"}, {"-0.0123"})


def test_units_that_no_table_knows_are_named() -> None:
    assert Dimensions(Tank).unknown_units == []
    assert Dimensions(Peltier).unknown_units == ["PWM"]


UNITS = ("s", "min", "K", "m", "kg", "V", "A", "W", "1", "%", "J/K", "m²")


@given(st.sampled_from(UNITS), st.sampled_from(UNITS), st.sampled_from(UNITS))
def test_a_lag_whose_units_are_made_to_fit_passes_whatever_they_are(y: str, u: str, x: str) -> None:
    class Any(Plant, name="any_units"):
        out = Output(unit=y, noise=0.1, span=(-1.0, 1.0))
        drive = Drive(unit=u, limits=(-1.0, 1.0), noise=0.1)
        inside = State(unit=x, span=(-1.0, 1.0))
        seen = Parameter(unit=f"({y})/({x})", default=1.0, bounds=(0.1, 10.0))
        gain = Parameter(unit=f"({x})/({u})", default=1.0, bounds=(0.1, 10.0))
        lag = Parameter(unit="s", default=1.0, bounds=(0.1, 10.0))
        structures = {"any": Structure(free=("gain",))}  # noqa: RUF012

        def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
            return Equations(
                rates={self.inside: (self.gain * self.drive - self.inside) / self.lag},
                output=self.seen * self.inside,
                start={self.inside: self.out / self.seen},
            )

    assert told(Any) == []
