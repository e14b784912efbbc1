"""Parameter tables: what is accepted, what is refused and how, and the files in config/."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.support.places import PROJECT
from tests.support.plant_files import plant_file
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.camera_bridge import CameraBridge
from twinmatch.nodes.controller import controller_table, profiles_from
from twinmatch.nodes.gated import gate_limits, gate_table
from twinmatch.nodes.player import Player
from twinmatch.nodes.pwm_bridge import PwmBridge
from twinmatch.nodes.recorder import RecorderNode
from twinmatch.nodes.sampler import SamplerNode
from twinmatch.nodes.tclab_bridge import TCLabBridge
from twinmatch.parameters.declared import ParameterError, Setting, check, render
from twinmatch.parameters.sampler import (
    limits_of,
    sampler_table,
    sources_of,
    types_of,
    understood,
)
from twinmatch.parameters.twin import (
    read_settings,
    recorded_values,
    running_law,
    settings_from,
    twin_table,
    twin_values,
    values_of,
)
from twinmatch.plants import PLANTS, Peltier, TCLab, TCLabBoth, find_plant
from twinmatch.safety import GuardLimits, OutputGuard, RunawayLimits
from twinmatch.safety.limits import SafetyError
from twinmatch.sampling.channels import parse_channel
from twinmatch.twin import TwinSettings

CONFIG = PROJECT / "config"

TABLE = (
    Setting("rate", 1.0, "How fast.", "Hz", 0.5, 10.0),
    Setting("depth", 5, "How deep.", low=1),
    Setting("name", "plate", "What.", choices=("plate", "sink")),
    Setting("loud", False, "Whether."),
    Setting("gains", [1.0, 2.0], "Of what.", "dB", high=6.0),
    Setting("parts", ["a"], "Which."),
)


def test_parameters_that_are_not_given_have_their_defaults() -> None:
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
        (
            "zzz",
            1.0,
            "node: there is no parameter zzz; choose from: depth, gains, loud, name, parts, rate",
        ),
        ("rate", "fast", "node: parameter rate is 'fast'; it must be a number"),
        ("rate", True, "node: parameter rate is True; it must be a number"),
        ("rate", 0.4, "node: parameter rate is 0.4; allowed: Hz, 0.5 to 10"),
        ("rate", math.nan, "node: parameter rate is nan; allowed:"),
        ("rate", math.inf, "node: parameter rate is inf; allowed:"),
        ("rate", None, "node: parameter rate is None; it must be a number"),
        ("depth", 0, "node: parameter depth is 0; allowed: at least 1"),
        ("depth", 2.0, "node: parameter depth is 2.0; it must be a whole number"),
        ("depth", True, "node: parameter depth is True; it must be a whole number"),
        (
            "name",
            "core",
            "node: parameter name is 'core'; allowed: one of: plate, sink",
        ),
        ("loud", 1, "node: parameter loud is 1; it must be true or false"),
        (
            "gains",
            [1.0, 7.0],
            "node: parameter gains is [1.0, 7.0]; allowed: dB, at most 6",
        ),
        ("gains", ["x"], "node: parameter gains is ['x']; every item must be a number"),
        ("gains", 1.0, "node: parameter gains is 1.0; it must be a list"),
        ("parts", [1], "node: parameter parts is [1]; every item must be text"),
    ],
)
def test_a_wrong_name_type_or_value_is_refused_with_what_is_allowed(
    name: str, value: Any, message: str
) -> None:
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


EXAMPLE = {
    "map.reference": "/rig/set_point:data",
    "map.output": "/rig/temperature:temperature",
    "map.input": "/rig/command:data",
}
FILES: dict[tuple[str, str], tuple[Setting, ...]] = {
    ("twin.yaml", "/**"): twin_table(),
    ("tclab_twin.yaml", "/**"): twin_table(TCLab),
    ("player.yaml", "player"): Player.PARAMETERS,
    ("rig.yaml", "controller"): controller_table(),
    ("rig.yaml", "recorder"): RecorderNode.PARAMETERS,
    ("rig.yaml", "camera_bridge"): CameraBridge.PARAMETERS,
    ("rig.yaml", "pwm_bridge"): PwmBridge.PARAMETERS,
    ("attach.yaml", "sampler"): SamplerNode.PARAMETERS,
    ("attach.yaml", "recorder"): RecorderNode.PARAMETERS,
    ("tclab.yaml", "tclab_bridge"): TCLabBridge.PARAMETERS,
    ("tclab.yaml", "recorder"): RecorderNode.PARAMETERS,
}
"""By parameter file and section, the table that it must agree with."""


@pytest.mark.parametrize(("name", "section"), FILES)
def test_section_is_what_its_table_renders(name: str, section: str) -> None:
    """Every parameter is in the file with its description, unit and range, and has its default."""
    table = FILES[name, section]
    text = (CONFIG / name).read_text(encoding="utf-8")
    example = EXAMPLE if section == "sampler" else {}
    assert render(section, table, example) in text
    values = yaml.safe_load(text)[section]["ros__parameters"]
    assert list(values) == [parameter.name for parameter in table]
    assert check(name, table, values) == check(name, table, {}) | example


def test_the_kits_controller_differs_in_its_profile_alone() -> None:
    table = controller_table(TCLab)
    file_values = yaml.safe_load((CONFIG / "tclab.yaml").read_text("utf-8"))[
        "controller"
    ]["ros__parameters"]
    values = check("controller", table, file_values)
    usual = check("controller", table, {})
    assert profiles_from(values) is not None
    assert {n for n in values if values[n] != usual[n]} == {
        "profile.levels",
        "profile.holds",
    }


BOTH = (CONFIG / "tclab_both.yaml").read_text("utf-8")


def test_the_file_of_both_heaters_says_all_of_the_controller_and_of_the_bridge_which() -> (
    None
):
    table = controller_table(TCLabBoth)
    sections = yaml.safe_load(BOTH)
    profile = {
        name: sections["controller"]["ros__parameters"][name]
        for name in ("profile.levels", "profile.holds")
    }
    assert render("controller", table, profile) in BOTH
    first, second = profiles_from(check("controller", table, profile)) or ()
    assert [(first.reference(t), second.reference(t)) for t in (0, 450, 900)] == [
        (35, 35),
        (50, 35),
        (50, 45),
    ]
    assert check(
        "tclab_bridge",
        TCLabBridge.PARAMETERS,
        sections["tclab_bridge"]["ros__parameters"],
    )


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "profile.levels",
            [30.0, 40.0, 50.0],
            "has 3 values for 4 times; give one of each output (temperature, s",
        ),
        (
            "profile.levels",
            [30.0, 90.0] * 4,
            "profile of second_temperature: level 1 is 90 °C; give one in the",
        ),
        (
            "profile.lowest",
            [20.0],
            "profile.lowest has 1 values; give one for temperature and second_temperature",
        ),
        (
            "profile.highest",
            [75.0, -1.0],
            "profile.lowest 0 must be below profile.highest -1 °C",
        ),
        (
            "pid.integral",
            [1.0] * 3,
            "pid.integral has 3 values; give one for each of 2 loops",
        ),
    ],
)
def test_what_is_not_said_of_each_heater_is_one_line(
    name: str, value: list[float], message: str
) -> None:
    values = check("controller", controller_table(TCLabBoth), {name: value})
    with pytest.raises(TwinmatchError) as caught:
        (profiles_from(values), running_law(values, TCLabBoth.loop))
    assert message in str(caught.value)


def test_twin_file_holds_the_defaults() -> None:
    assert read_settings(CONFIG / "twin.yaml") == TwinSettings()


def twin_file(tmp_path: Path, *lines: str) -> Path:
    path = tmp_path / "twin.yaml"
    path.write_text(
        "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in lines),
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("structure", Peltier.structures)
def test_every_structure_has_its_own_start_values(
    structure: str, tmp_path: Path
) -> None:
    settings = read_settings(
        twin_file(tmp_path, f"structure: {structure}", "start.seebeck: 0.08")
    )
    model = Peltier.model(structure)
    assert settings.start == model.parameters(seebeck=0.08)
    assert settings.free == model.structure.free
    assert settings_from(twin_values("twin", values_of(settings))) == settings


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "plant: nothing_like_it",
            "plant 'nothing_like_it': not known; choose from peltier",
        ),
        ("structure: two sinks", "no structure 'two sinks'; it has held sink, "),
        (
            "start.seebek: 0.1",
            "there is no parameter start.seebek; did you mean start.seebeck?",
        ),
        (
            "start.sensor_lag: 0.3",
            "'held sink' has no sensor_lag; choose a structure that has: sink with mass, sensor",
        ),
        (
            "start.seebeck: -0.1",
            "parameter start.seebeck is -0.1; allowed: V/K, at least 0",
        ),
        (
            "start.heat_capacity: 0.0",
            "heat_capacity is 0 J/K; it must be finite and positive",
        ),
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
        (
            "pid.proportional: -3.0",
            "parameter pid.proportional is -3.0; allowed: PWM/°C, 0 to 10000",
        ),
        (
            "sensor.pause_period: 0.5",
            "a pause every 0.5 s leaves no time between pauses of 0.9 s",
        ),
    ],
)
def test_what_a_twin_cannot_have_is_refused_in_words(
    line: str, message: str, tmp_path: Path
) -> None:
    path = twin_file(tmp_path, line)
    with pytest.raises(ParameterError) as caught:
        read_settings(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_left_parts_out_by_zeros_still_works(tmp_path: Path) -> None:
    zeros = ("sink_heat_capacity", "sink_convection", "sensor_lag", "seebeck_slope")
    path = twin_file(
        tmp_path, "start.seebeck: 0.08", *(f"start.{name}: 0.0" for name in zeros)
    )
    assert read_settings(path).start == Peltier.model().parameters(seebeck=0.08)


def test_recorded_values_are_understood_under_the_names_they_had() -> None:
    old = {
        "noise.temperature": 0.2,
        "noise.pwm": 5.0,
        "camera.noise": 0.3,
        "pid.limit": 200.0,
    }
    old |= {
        "limits.fault_y": 12.0,
        "start.sink_heat_capacity": 250.0,
        "start.sink_convection": 6.0,
        "start.sensor_lag": 0.0,
    }
    settings = settings_from(recorded_values("session", old))
    assert (settings.noise.output, settings.noise.input, settings.sensor.noise) == (
        0.2,
        5.0,
        0.3,
    )
    assert (settings.law.low, settings.law.high) == (-200.0, 200.0)
    assert settings.start == Peltier.model("sink with mass").parameters(
        sink_heat_capacity=250.0, sink_convection=6.0
    )


def test_a_plant_in_a_file_is_run_for_a_configuration_and_not_for_a_recording(
    tmp_path: Path,
) -> None:
    path = plant_file(tmp_path, "block_configured")
    with pytest.raises(
        ParameterError,
        match=r"files are run only if you name them: add --plant "
        r".*configured\.py",
    ):
        recorded_values("session", {"plant": str(path)})
    settings = read_settings(twin_file(tmp_path, f'plant: "{path}"'))
    assert settings.plant.name == "block_configured"
    assert settings.law is None
    values_again = recorded_values(
        "session", {"plant": f"/elsewhere/{path.name}", "loop": "unknown"}
    )
    assert settings_from(values_again) == settings
    assert values_of(settings)["plant"] == str(path)
    with pytest.raises(
        ParameterError, match="is for plant block_configured, but the data are of"
    ):
        read_settings(twin_file(tmp_path, f'plant: "{path}"'), "peltier")


@pytest.mark.parametrize("kind", [PwmBridge, TCLabBridge])
def test_the_defaults_are_those_of_the_guard(kind: Any) -> None:
    assert gate_limits(kind.LIMITS, check("node", kind.PARAMETERS, {})) == kind.LIMITS
    assert GuardLimits() == PwmBridge.LIMITS


def test_each_limit_has_its_parameter() -> None:
    guard_values = {
        "command_timeout": 0.5,
        "temperature_timeout": 2.0,
        "highest": 90.0,
        "lowest": 5.0,
    }
    runaway = {
        "hysteresis": 1.0,
        "patience": 2.0,
        "gain": 3.0,
        "gain_time": 4.0,
        "wrong_way": 5.0,
    }
    prefixed = {
        f"runaway.{name}": value
        for name, value in (runaway | {"full_drive": 99.0}).items()
    }
    limits = gate_limits(
        PwmBridge.LIMITS,
        check("node", PwmBridge.PARAMETERS, {**guard_values, **prefixed}),
    )
    assert {name: getattr(limits, name) for name in guard_values} == guard_values
    assert limits.runaway == RunawayLimits(**runaway, full_drive=99.0)


def test_limits_that_contradict_each_other_are_refused() -> None:
    values = check("node", PwmBridge.PARAMETERS, {"highest": 10.0, "lowest": 20.0})
    with pytest.raises(SafetyError, match="must be below"):
        gate_limits(PwmBridge.LIMITS, values)


def test_units_are_those_of_the_plant() -> None:
    """A motor has no degrees: neither in its parameters nor in its faults."""
    limits = GuardLimits(
        highest=90.0, lowest=-90.0, thing="shaft", unit="rad/s", drive_unit="V"
    )
    table = {parameter.name: parameter for parameter in gate_table(limits)}
    assert table["highest"].unit == table["runaway.gain"].unit == "rad/s"
    assert table["runaway.patience"].unit == "rad/s·s"
    assert table["runaway.full_drive"].unit == "V"
    guard = OutputGuard(limits)
    guard.temperature(95.0, 0.0)
    assert guard.fault is not None
    assert guard.fault.message.startswith("the shaft is at 95.0 rad/s, above 90 rad/s")
    with pytest.raises(SafetyError, match=r"100\.0 rad/s must be below"):
        replace(limits, lowest=100.0)


def test_the_twin_knows_the_running_pid() -> None:
    twin = {p.name: p.default for p in twin_table()}
    shared = {
        p.name: p.default
        for p in controller_table()
        if p.name.startswith("pid.") or p.name == "period"
    }
    assert len(shared) == 8
    assert shared.items() <= twin.items()


def test_the_defaults_make_a_profile_and_suit_the_guard() -> None:
    values = check("controller", controller_table(), {})
    (profile,) = profiles_from(values) or ()
    assert profile.reference(0.0) == 30.0
    # The controller has to switch off, and to say so, before the bridge has to latch.
    assert values["max_age"] < GuardLimits().temperature_timeout
    assert 2 * values["command_period"] < GuardLimits().command_timeout


@pytest.mark.parametrize("name", sorted(PLANTS))
def test_every_plant_has_a_table_with_its_own_signals(name: str) -> None:
    plant = PLANTS[name]
    names = {parameter.name for parameter in sampler_table(plant)}
    loop = ["reference", "output", "input"]
    if name == "tclab-both":
        outputs = ["temperature", "second_temperature"]
        loop = [*outputs, *(f"{y}_reference" for y in outputs), "power", "second"]
    signals = {*loop, *plant.disturbances}
    assert {n for n in names if n.startswith("map.")} == {
        f"map.{signal}" for signal in signals
    }
    assert {n for n in names if n.startswith("max_age.")} == {
        f"max_age.{signal}" for signal in signals
    }


def test_a_plant_in_a_file_has_its_disturbances_and_ages_follow_the_period(
    tmp_path: Path,
) -> None:
    path = str(plant_file(tmp_path, "attached_block"))
    parameters = {
        "plant": path,
        "period": 0.1,
        "map.output": "/t",
        "map.input": "/u",
        "map.room": "/room; unit=K",
    }
    values = check("sampler", *understood("sampler", parameters))
    sources = sources_of("sampler", values)
    assert list(sources) == ["output", "input", "room"]
    limits = limits_of(values, sources)
    assert limits["output"].max_age == pytest.approx(0.3)
    assert (limits["input"].low, limits["input"].high) == pytest.approx(
        (0.0, 100.0), abs=1e-6
    )
    room = sources["room"]
    followed = room.follow(
        "room", "°C", room.channels("room"), ["std_msgs/msg/Float64"]
    )
    assert followed.value([300.0], 0.0) == pytest.approx(26.85)
    assert find_plant(path).disturbances.keys() == {"room"}


def test_several_topics_give_their_mean() -> None:
    parameters = {
        "map.output": "/t2:data, /t3:data; scale=0.1; offset=-4",
        "map.input": "/u",
    }
    source = sources_of(
        "sampler", check("sampler", *understood("sampler", parameters))
    )["output"]
    channels = source.channels("output")
    assert [channel.text for channel in channels] == ["/t2:data", "/t3:data"]
    followed = source.follow("output", "°C", channels, ["std_msgs/msg/Float64"] * 2)
    assert followed.value([200.0, 300.0], 0.0) == pytest.approx(21.0)


def test_units_that_messages_have_by_their_definition_are_known() -> None:
    parameters = {"map.output": "/t", "map.input": "/u"}
    source = sources_of(
        "sampler", check("sampler", *understood("sampler", parameters))
    )["output"]
    kinds = ["sensor_msgs/msg/Temperature"]
    warm = [parse_channel("/t:temperature")]
    assert source.follow("output", "K", warm, kinds).value(
        [20.0], 0.0
    ) == pytest.approx(293.15)
    assert source.follow("output", "°C", warm, kinds).value([20.0], 0.0) == 20.0
    with pytest.raises(
        TwinmatchError, match=r"in Pa \(according to sensor_msgs/msg/FluidPressure\)"
    ):
        source.follow(
            "output",
            "°C",
            [parse_channel("/t:fluid_pressure")],
            ["sensor_msgs/msg/FluidPressure"],
        )


def test_types_are_read_as_they_are_written() -> None:
    text = "/cmd std_msgs/msg/Float64, /t sensor_msgs/msg/Temperature"
    assert types_of("sampler", text) == {
        "/cmd": "std_msgs/msg/Float64",
        "/t": "sensor_msgs/msg/Temperature",
    }
    with pytest.raises(TwinmatchError, match="write TOPIC TYPE"):
        types_of("sampler", "/cmd")


def test_the_files_map_names_the_signals_in_their_order() -> None:
    values = check("sampler", SamplerNode.PARAMETERS, EXAMPLE)
    assert list(sources_of("sampler", values)) == ["reference", "output", "input"]
