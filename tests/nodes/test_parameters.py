"""Parameter tables: what is accepted, what is refused and how, and the files in config/."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plant_files import plant_file
from twinmatch.parameters.declared import ParameterError, Setting, check, render
from twinmatch.parameters.twin import (
    read_settings,
    recorded_values,
    settings_from,
    twin_table,
    twin_values,
    values_of,
)
from twinmatch.plants import Peltier, TCLab
from twinmatch.twin import TwinSettings

CONFIG = Path(__file__).resolve().parents[2] / "config"

TABLE = (
    Setting("rate", 1.0, "How fast.", "Hz", 0.5, 10.0),
    Setting("depth", 5, "How deep.", low=1),
    Setting("name", "plate", "What.", choices=("plate", "sink")),
    Setting("loud", False, "Whether."),
    Setting("gains", [1.0, 2.0], "Of what.", "dB", high=6.0),
    Setting("parts", ["a"], "Which."),
)


def test_defaults() -> None:
    assert check("node", TABLE, {}) == {p.name: p.default for p in TABLE}


def test_built_in_parameters_are_skipped() -> None:
    given_ones = {
        "use_sim_time": True,
        "qos_overrides./clock.subscription.depth": 3,
        "start_type_description_service": True,
    }
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
        (
            "qos_overrides./plant/sample.subscription.depth",
            1,
            "node: qos_overrides./plant/sample.subscription.depth cannot be set: reliability",
        ),
        ("zzz", 1.0, "node: there is no parameter zzz; choose from: depth, gains, loud, name, parts, rate"),
        ("rate", "fast", "node: parameter rate is 'fast'; it must be a number"),
        ("rate", True, "node: parameter rate is True; it must be a number"),
        ("rate", 0.4, "node: parameter rate is 0.4; allowed: Hz, 0.5 to 10"),
        ("rate", math.nan, "node: parameter rate is nan; allowed:"),
        ("rate", math.inf, "node: parameter rate is inf; allowed:"),
        ("rate", None, "node: parameter rate is None; it must be a number"),
        ("depth", 0, "node: parameter depth is 0; allowed: at least 1"),
        ("depth", 2.0, "node: parameter depth is 2.0; it must be a whole number"),
        ("depth", True, "node: parameter depth is True; it must be a whole number"),
        ("name", "core", "node: parameter name is 'core'; allowed: one of: plate, sink"),
        ("loud", 1, "node: parameter loud is 1; it must be true or false"),
        ("gains", [1.0, 7.0], "node: parameter gains is [1.0, 7.0]; allowed: dB, at most 6"),
        ("gains", ["x"], "node: parameter gains is ['x']; every item must be a number"),
        ("gains", 1.0, "node: parameter gains is 1.0; it must be a list"),
        ("parts", [1], "node: parameter parts is [1]; every item must be text"),
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
    found = [("twin.yaml", "/**", twin_table()), ("tclab_twin.yaml", "/**", twin_table(TCLab))]
    try:
        from twinmatch.nodes.player import Player
    except ImportError:
        return found
    return [*found, ("player.yaml", "player", Player.PARAMETERS)]


@pytest.mark.parametrize(("name", "section", "table"), files(), ids=lambda value: str(value)[:12])
def test_file_agrees_with_its_table(name: str, section: str, table: tuple[Setting, ...]) -> None:
    """Every parameter is in the file with its description, unit and range, and its value is allowed."""
    text = (CONFIG / name).read_text(encoding="utf-8")
    values = yaml.safe_load(text)[section]["ros__parameters"]
    assert list(values) == [parameter.name for parameter in table]
    checked = check(name, table, values)
    assert text.endswith(render(section, table, checked)), (
        f"write it again:\n{render(section, table, checked)}"
    )


def test_twin_file_holds_the_defaults() -> None:
    assert read_settings(CONFIG / "twin.yaml") == TwinSettings()


def twin_file(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "twin.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in lines), encoding="utf-8"
    )
    return path


@pytest.mark.parametrize("structure", Peltier.structures)
def test_every_structure_has_its_own_start_values(structure: str, tmp_path: Path) -> None:
    settings = read_settings(twin_file(tmp_path, f"structure: {structure}", "start.seebeck: 0.08"))
    model = Peltier.model(structure)
    assert settings.start == model.parameters(seebeck=0.08)
    assert settings.free == model.structure.free
    assert settings_from(twin_values("twin", values_of(settings))) == settings


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plant: nothing_like_it", "plant 'nothing_like_it': not known; choose from peltier"),
        ("structure: two sinks", "no structure 'two sinks'; it has held sink, "),
        ("start.seebek: 0.1", "there is no parameter start.seebek; did you mean start.seebeck?"),
        (
            "start.sensor_lag: 0.3",
            "'held sink' has no sensor_lag; choose a structure that has: sink with mass, sensor",
        ),
        ("start.seebeck: -0.1", "parameter start.seebeck is -0.1; allowed: V/K, at least 0"),
        ("start.heat_capacity: 0.0", "heat_capacity is 0 J/K; it must be finite and positive"),
        (
            "free: [seebeck, sensor_lag]",
            "'sensor_lag']; allowed: one of: seebeck",
        ),
        ("noise.pwm: 7.0", "noise.pwm is now called noise.input; rename it"),
        ("camera.noise: 0.1", "camera.noise is now called sensor.noise; rename it"),
        ("pid.limit: 200.0", "pid.limit is now called pid.low and pid.high; rename it"),
        ("limits.fault_y: 12.0", "limits.fault_y is no longer used"),
        ("pid.high: 256.0", "parameter pid.high is 256.0; allowed: PWM, -255 to 255"),
        ("pid.high: -255.0", "the limits -255.0 and -255.0 in increasing order"),
        ("pid.proportional: -3.0", "parameter pid.proportional is -3.0; allowed: PWM/°C, 0 to 10000"),
        ("sensor.pause_period: 0.5", "a pause every 0.5 s leaves no time between pauses of 0.9 s"),
    ],
)
def test_what_a_twin_cannot_have_is_refused_in_words(line: str, message: str, tmp_path: Path) -> None:
    path = twin_file(tmp_path, line)
    with pytest.raises(ParameterError) as caught:
        read_settings(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_left_parts_out_by_zeros_still_works(tmp_path: Path) -> None:
    zeros = ("sink_heat_capacity", "sink_convection", "sensor_lag", "seebeck_slope")
    path = twin_file(tmp_path, "start.seebeck: 0.08", *(f"start.{name}: 0.0" for name in zeros))
    assert read_settings(path).start == Peltier.model().parameters(seebeck=0.08)


def test_recorded_values_are_understood_under_the_names_they_had() -> None:
    old = {"noise.temperature": 0.2, "noise.pwm": 5.0, "camera.noise": 0.3, "pid.limit": 200.0}
    old |= {
        "limits.fault_y": 12.0,
        "start.sink_heat_capacity": 250.0,
        "start.sink_convection": 6.0,
        "start.sensor_lag": 0.0,
    }
    settings = settings_from(recorded_values("session", old))
    assert (settings.noise.output, settings.noise.input, settings.sensor.noise) == (0.2, 5.0, 0.3)
    assert (settings.gains.low, settings.gains.high) == (-200.0, 200.0)
    assert settings.start == Peltier.model("sink with mass").parameters(
        sink_heat_capacity=250.0, sink_convection=6.0
    )


def test_a_plant_in_a_file_is_run_for_a_configuration_and_not_for_a_recording(tmp_path: Path) -> None:
    path = plant_file(tmp_path, "block_configured")
    with pytest.raises(
        ParameterError,
        match=r"files are run only if you name them: add --plant "
        r".*configured\.py",
    ):
        recorded_values("session", {"plant": str(path)})
    settings = read_settings(twin_file(tmp_path, f'plant: "{path}"'))
    assert settings.plant.name == "block_configured"
    assert settings.gains is None
    again = recorded_values("session", {"plant": f"/elsewhere/{path.name}", "loop": "unknown"})
    assert settings_from(again) == settings
    assert values_of(settings)["plant"] == str(path)
    with pytest.raises(ParameterError, match="is for plant block_configured, but the data are of"):
        read_settings(twin_file(tmp_path, f'plant: "{path}"'), "peltier")
