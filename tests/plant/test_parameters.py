"""Numbers a rig can and cannot have."""

from __future__ import annotations

import math

import pytest

from twinmatch.plant import PARAMETER_NAMES, Driver, PlantError, PlantState, RigParameters


def test_every_parameter_has_its_name() -> None:
    assert tuple(RigParameters.__dataclass_fields__) == PARAMETER_NAMES


def test_replace_changes_only_what_it_names() -> None:
    rig = RigParameters(seebeck=0.1).replace(conductance=0.5)
    assert (rig.seebeck, rig.conductance, rig.heat_capacity) == (0.1, 0.5, 15.0)
    with pytest.raises(PlantError, match="'alpha' is none of seebeck, resistance"):
        rig.replace(alpha=0.1)


def test_the_sink_has_mass_when_its_capacity_is_finite() -> None:
    assert not RigParameters().sink_has_mass
    assert RigParameters(sink_heat_capacity=300.0).sink_has_mass


@pytest.mark.parametrize("name", PARAMETER_NAMES)
@pytest.mark.parametrize("value", [math.nan, -math.inf, -1.0])
def test_impossible_values_are_refused(name: str, value: float) -> None:
    if name == "seebeck_slope" and value == -1.0:
        assert RigParameters(seebeck_slope=value).seebeck_slope == value
        return
    with pytest.raises(PlantError, match=f"{name} is {value}; it must be finite"):
        RigParameters(**{name: value})


@pytest.mark.parametrize("name", ["resistance", "heat_capacity", "sink_heat_capacity"])
def test_zero_is_refused_where_it_means_nothing(name: str) -> None:
    with pytest.raises(PlantError, match=f"{name} is 0.0; it must be finite and positive"):
        RigParameters(**{name: 0.0})


def test_a_share_is_at_most_one() -> None:
    with pytest.raises(PlantError, match=r"drive_ripple is 1\.5; it is a share between 0 and 1"):
        RigParameters(drive_ripple=1.5)


def test_celsius_is_noticed() -> None:
    with pytest.raises(PlantError, match=r"ambient is 23\.0 K; give kelvin between 150 and 600, not °C"):
        RigParameters(ambient=23.0)


def test_the_sensor_is_at_the_plate_unless_it_is_told_otherwise() -> None:
    assert PlantState(300.0, 296.0) == PlantState(300.0, 296.0, 300.0)
    with pytest.raises(PlantError, match="plant state: sensor is -1"):
        PlantState(300.0, 296.0, -1.0)


@pytest.mark.parametrize("value", [0.0, -3.0, math.inf, math.nan])
def test_a_state_is_above_absolute_zero(value: float) -> None:
    with pytest.raises(PlantError, match="plant state: plate is"):
        PlantState(value, 296.0)
    with pytest.raises(PlantError, match="plant state: sink is"):
        PlantState(296.0, value)


@pytest.mark.parametrize(
    ("name", "value"), [("supply", 0.0), ("bridge_resistance", -0.1), ("current_limit", math.inf)]
)
def test_a_driver_has_possible_numbers(name: str, value: float) -> None:
    with pytest.raises(PlantError, match=f"driver: {name} is {value}"):
        Driver(**{name: value})


def test_full_pwm_is_the_supply() -> None:
    assert Driver().volts_per_count * 255.0 == 12.0
