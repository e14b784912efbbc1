"""Parameter tables: what is accepted, what is refused and how, and the files in config/."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.nodes.parameters import Parameter, ParameterError, check, render
from twinmatch.nodes.twin_parameters import TWIN_PARAMETERS, read_settings
from twinmatch.twin import TwinSettings

CONFIG = Path(__file__).resolve().parents[2] / "config"

TABLE = (
    Parameter("rate", 1.0, "How fast.", "Hz", 0.5, 10.0),
    Parameter("depth", 5, "How deep.", low=1),
    Parameter("name", "plate", "What.", choices=("plate", "sink")),
    Parameter("loud", False, "Whether."),
    Parameter("gains", [1.0, 2.0], "Of what.", "dB", high=6.0),
    Parameter("parts", ["a"], "Which."),
)


def test_defaults() -> None:
    assert check("node", TABLE, {}) == {p.name: p.default for p in TABLE}


def test_built_in_parameters_are_passed_over() -> None:
    given_ones = {"use_sim_time": True, "qos_overrides./x.depth": 3, "start_type_description_service": True}
    assert check("node", TABLE, given_ones) == check("node", TABLE, {})


def test_whole_numbers_become_float64() -> None:
    values = check("node", TABLE, {"rate": 2, "gains": [3, 4.5]})
    assert values["rate"] == 2.0
    assert type(values["rate"]) is float
    assert [type(gain) for gain in values["gains"]] == [float, float]


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("rat", 1.0, "node: there is no parameter rat; did you mean rate?"),
        ("zzz", 1.0, "node: there is no parameter zzz; it has: depth, gains, loud, name, parts, rate"),
        ("rate", "fast", "node: parameter rate is 'fast'; it must be a number"),
        ("rate", True, "node: parameter rate is True; it must be a number"),
        ("rate", 0.4, "node: parameter rate is 0.4; allowed is Hz, 0.5 to 10"),
        ("rate", math.nan, "node: parameter rate is nan; allowed is"),
        ("rate", math.inf, "node: parameter rate is inf; allowed is"),
        ("rate", None, "node: parameter rate is None; it must be a number"),
        ("depth", 0, "node: parameter depth is 0; allowed is at least 1"),
        ("depth", 2.0, "node: parameter depth is 2.0; it must be a whole number"),
        ("depth", True, "node: parameter depth is True; it must be a whole number"),
        ("name", "core", "node: parameter name is 'core'; allowed is one of: plate, sink"),
        ("loud", 1, "node: parameter loud is 1; it must be true or false"),
        ("gains", [1.0, 7.0], "node: parameter gains is [1.0, 7.0]; allowed is dB, at most 6"),
        ("gains", ["x"], "node: parameter gains is ['x']; every item must be a number"),
        ("gains", 1.0, "node: parameter gains is 1.0; it must be a list"),
        ("parts", [1], "node: parameter parts is [1]; every item must be a text"),
    ],
)
def test_refusals(name: str, value: Any, message: str) -> None:
    with pytest.raises(ParameterError) as caught:
        check("node", TABLE, {name: value})
    assert str(caught.value).startswith(message)


@given(st.floats(allow_nan=False))
def test_a_number_is_accepted_exactly_within_its_range(value: float) -> None:
    try:
        accepted = check("node", TABLE, {"rate": value})["rate"]
    except ParameterError:
        assert not 0.5 <= value <= 10.0
    else:
        assert accepted == value
        assert 0.5 <= value <= 10.0


def test_rendered_section_reads_back() -> None:
    values = {"rate": 0.75, "name": "sink", "parts": ["x", "y"], "loud": True}
    section = yaml.safe_load(render("node", TABLE, values))["node"]["ros__parameters"]
    assert check("node", TABLE, section) == check("node", TABLE, values)


# Every parameter file, its section and the table it must agree with.
def files() -> list[tuple[str, str, Any]]:
    found = [("twin.yaml", "/**", TWIN_PARAMETERS)]
    try:
        from twinmatch.nodes.player import Player
    except ImportError:
        return found
    return [*found, ("player.yaml", "player", Player.PARAMETERS)]


@pytest.mark.parametrize(("name", "section", "table"), files(), ids=lambda value: str(value)[:12])
def test_file_agrees_with_its_table(name: str, section: str, table: tuple[Parameter, ...]) -> None:
    """Every parameter is in the file with its description, unit and range, and its value is allowed."""
    text = (CONFIG / name).read_text(encoding="utf-8")
    values = yaml.safe_load(text)[section]["ros__parameters"]
    assert list(values) == [parameter.name for parameter in table]
    checked = check(name, table, values)
    assert text.endswith(render(section, table, checked)), (
        f"write it anew:\n{render(section, table, checked)}"
    )


def test_twin_file_holds_the_defaults() -> None:
    assert read_settings(CONFIG / "twin.yaml") == TwinSettings()
