"""Files of candidates: plants, structures, names, and files from before there were structures."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests.support.rig import rig
from twinmatch.dynamics import PlantError
from twinmatch.plants import Peltier
from twinmatch.plants.records import parameters_from
from twinmatch.sessions.candidates import CandidateFileError, parse_candidates, read_candidates

PAPER = Path(__file__).resolve().parents[2] / "config" / "paper_candidates.yaml"


def entry(text: str) -> str:
    return f"candidates:\n  - {{name: a, operating_point: 50.0, {text}}}\n"


def test_the_papers_family_has_the_papers_structure() -> None:
    family = read_candidates(PAPER)
    assert [c.operating_point for c in family] == [30.0, 50.0, 70.0, 90.0]
    assert family[0].parameters == rig(seebeck=0.0963, conductance=0.3, heat_capacity=34.9)
    assert {c.parameters.model for c in family} == {Peltier.model()}


def test_a_structure_is_taken_by_its_name() -> None:
    text = entry("plant: peltier, structure: 'sink with mass, sensor lag', sensor_lag: 0.4")
    (found,) = parse_candidates(text, "family")
    assert found.parameters == rig("sink with mass, sensor lag", sensor_lag=0.4)


def test_without_a_structure_the_values_say_which_parts_there_are() -> None:
    (found,) = parse_candidates(entry("sink_heat_capacity: 250.0, sink_convection: 6.0"), "family")
    assert found.parameters == rig("sink with mass", sink_heat_capacity=250.0, sink_convection=6.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seebek: 0.1", "no parameter 'seebek' in this structure; it has seebeck, resistance"),
        ("seebeck: high", "seebeck is 'high'; give a number"),
        ("seebeck: -1.0", "seebeck is -1 V/K; it must be finite and at least 0"),
        ("plant: kettle", "plant 'kettle': not known; choose from peltier"),
        ("structure: two sinks", "no structure 'two sinks'; it has held sink"),
        ("structure: held sink, sensor_lag: 1.0", "no parameter 'sensor_lag' in this structure"),
    ],
)
def test_what_no_candidate_can_be_is_refused_in_words(text: str, message: str) -> None:
    with pytest.raises(CandidateFileError) as caught:
        parse_candidates(entry(text), "family")
    assert str(caught.value).startswith("family: candidate 1: ")
    assert message in str(caught.value)


OLD = {
    "seebeck": 0.06, "resistance": 3.3, "conductance": 0.5, "heat_capacity": 27.0, "ambient": 295.0,
    "sink_heat_capacity": math.inf, "sink_convection": 0.0, "sensor_lag": 0.0, "seebeck_slope": 0.0,
    "drive_ripple": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "structure"),
    [
        ({}, "held sink"),
        ({"sink_heat_capacity": 250.0}, "sink with mass"),
        ({"sink_heat_capacity": 250.0, "sensor_lag": 0.5}, "sink with mass, sensor lag"),
        (
            {"sink_heat_capacity": 250.0, "seebeck_slope": 1e-4},
            "sink with mass, free ambient, switched drive, α(T)",
        ),
        (
            {"sink_heat_capacity": 250.0, "sensor_lag": 0.5, "seebeck_slope": 1e-4},
            "sink with mass, free ambient, switched drive, sensor lag, α(T)",
        ),
    ],
)
def test_what_was_written_down_before_plants_had_structures(
    changes: dict[str, float], structure: str
) -> None:
    """Every number that meant something then is there, and has the value it had."""
    values = OLD | changes
    found = parameters_from("", "", values)
    assert found.model is Peltier.model(structure)
    assert all(found[name] == value for name, value in values.items() if name in found)
    assert {name for name, value in values.items() if value and math.isfinite(value)} <= set(found)


def test_a_sink_that_was_held_beside_a_lag_is_a_sink_that_hardly_moves() -> None:
    found = parameters_from("peltier", "", OLD | {"sensor_lag": 0.5})
    assert found["sensor_lag"] == 0.5
    assert found["sink_heat_capacity"] > 1e9


def test_unknown_plants_are_named() -> None:
    with pytest.raises(PlantError, match="plant 'kettle': not known"):
        parameters_from("kettle", "", {"seebeck": 0.1})
