"""The parameters of the twin's nodes, one table for all three, and the settings they make.

Matcher, discriminator and twin simulator must agree on these, so they share the table, and an offline
replay reads the same file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from twinmatch.health import HealthSettings
from twinmatch.matching import Noise
from twinmatch.nodes.parameters import Parameter, ParameterError, check
from twinmatch.plant import PARAMETER_NAMES, Camera, PidGains, RigParameters
from twinmatch.twin import ScheduleSettings, TrustLimits, TwinError, TwinSettings

__all__ = ["TWIN_PARAMETERS", "at_period", "read_settings", "settings_from"]

_D = TwinSettings()
_S, _L, _G, _C, _N, _R = _D.schedule, _D.limits, _D.gains, _D.camera, _D.noise, _D.start
_H = _D.health

TWIN_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("period", _D.period, "Sample time of the loop.", "s", 0.01, 60.0),
    Parameter(
        "schedule.stride", _S.stride, "Samples between two looks while nothing moves.", "samples", 4, 10000
    ),
    Parameter(
        "schedule.min_step", _S.min_step, "Smallest set-point change that starts a regime.", "°C", 0.1, 100.0
    ),
    Parameter("schedule.min_span", _S.min_span, "A shorter regime joins the next one.", "samples", 10, 10000),
    Parameter("schedule.span", _S.span, "A regime is judged this long after its step.", "samples", 20, 10000),
    Parameter(
        "schedule.lead", _S.lead, "Samples kept before the previous regime's step.", "samples", 1, 1000
    ),
    Parameter("schedule.capacity", _S.capacity, "Longest window.", "samples", 40, 100000),
    Parameter("free", list(_D.free), "Rig parameters that a match may change.", choices=PARAMETER_NAMES),
    Parameter("start.seebeck", _R.seebeck, "Seebeck coefficient α to start from.", "V/K", 0.001, 1.0),
    Parameter("start.resistance", _R.resistance, "Electrical resistance R.", "Ω", 0.1, 100.0),
    Parameter("start.conductance", _R.conductance, "Thermal conductance K to start from.", "W/K", 0.0, 100.0),
    Parameter("start.heat_capacity", _R.heat_capacity, "Heat capacity C to start from.", "J/K", 0.1, 1e5),
    Parameter("start.ambient", _R.ambient, "Ambient temperature.", "K", 200.0, 400.0),
    Parameter(
        "start.sink_heat_capacity",
        0.0,
        "Heat capacity of the heat sink; 0: the sink is held at ambient.",
        "J/K",
        0.0,
        1e6,
    ),
    Parameter("start.sink_convection", _R.sink_convection, "Convection of the heat sink.", "W/K", 0.0, 1e4),
    Parameter(
        "start.sensor_lag", _R.sensor_lag, "Lag with which the camera follows the plate.", "s", 0.0, 1e3
    ),
    Parameter("start.seebeck_slope", _R.seebeck_slope, "Change of α with temperature.", "V/K²", -1e-2, 1e-2),
    Parameter(
        "start.drive_ripple",
        _R.drive_ripple,
        "Share of the bridge's switching that the module feels.",
        "",
        0.0,
        1.0,
    ),
    Parameter("noise.output", _N.output, "Noise of the temperature (1 σ).", "°C", 1e-4, 10.0),
    Parameter("noise.input", _N.input, "Noise of the control (1 σ).", "PWM", 1e-3, 255.0),
    Parameter(
        "pid.proportional", _G.proportional, "Proportional gain of the running PID.", "PWM/°C", 0.0, 1e4
    ),
    Parameter("pid.integral", _G.integral, "Integral gain.", "PWM/(°C·s)", 0.0, 1e4),
    Parameter("pid.derivative", _G.derivative, "Derivative gain.", "PWM·s/°C", 0.0, 1e4),
    Parameter("pid.back_calculation", _G.back_calculation, "Anti-windup gain.", "1/s", 0.0, 1e3),
    Parameter("pid.limit", _G.limit, "Largest output.", "PWM", 1.0, 255.0),
    Parameter(
        "camera.noise", _C.noise, "Noise of the camera the twin is seen through (1 σ).", "°C", 0.0, 10.0
    ),
    Parameter("camera.resolution", _C.resolution, "Resolution of that camera; 0: none.", "°C", 0.0, 10.0),
    Parameter("seed", _D.seed, "Seed of that camera's noise.", "", 0, 2**31),
    Parameter("decimals", _D.decimals, "Decimal places of the information gain's tables.", "", 0, 9),
    Parameter("most_candidates", _D.most_candidates, "Candidates kept in the family.", "", 1, 64),
    Parameter(
        "regime_width",
        _D.regime_width,
        "Operating points closer than half of this are one regime.",
        "°C",
        0.1,
        500.0,
    ),
    Parameter(
        "limits.doubtful_y", _L.doubtful_y, "Residual RMS that makes the twin doubtful.", "°C", 1e-3, 1e3
    ),
    Parameter("limits.fault_y", _L.fault_y, "Residual RMS that is a fault.", "°C", 1e-3, 1e3),
    Parameter("limits.doubtful_u", _L.doubtful_u, "The same for the control.", "PWM", 1e-3, 1e3),
    Parameter("limits.fault_u", _L.fault_u, "The same for the control.", "PWM", 1e-3, 1e3),
    Parameter(
        "health.lost",
        _H.lost,
        "Share of the drive's expected effect below which it is lost.",
        "",
        0.01,
        0.99,
    ),
    Parameter("health.jump", _H.jump, "Step of a reading that no plate can make.", "°C", 0.1, 1e3),
    Parameter("health.frozen", _H.frozen, "How long one reading has to be repeated.", "s", 1.0, 1e4),
    Parameter("health.drift", _H.drift, "Unexplained slow heating, in its uncertainty.", "", 0.1, 1e3),
    Parameter("health.start", _H.start, "Time after the first sample without alarms.", "s", 0.1, 1e4),
    Parameter(
        "recent", 60, "Samples over which the live twin's residuals are averaged.", "samples", 1, 100000
    ),
    Parameter("candidates", "", "File of candidates to begin with, for the discriminator; empty: none."),
)
"""Name, default, meaning, unit and range of everything in `TwinSettings`, and two that single nodes need."""


def settings_from(values: Mapping[str, Any]) -> TwinSettings:
    """Settings from checked parameter values.

    Raises:
        TwinmatchError: values that do not go together.
    """

    def group(prefix: str) -> dict[str, Any]:
        return {n.removeprefix(prefix): v for n, v in values.items() if n.startswith(prefix)}

    start = group("start.")
    start["sink_heat_capacity"] = start["sink_heat_capacity"] or math.inf
    return TwinSettings(
        period=values["period"],
        schedule=ScheduleSettings(**group("schedule.")),
        free=tuple(values["free"]),
        start=RigParameters(**start),
        noise=Noise(**group("noise.")),
        gains=PidGains(period=values["period"], **group("pid.")),
        camera=Camera(**group("camera.")),
        seed=values["seed"],
        decimals=values["decimals"],
        most_candidates=values["most_candidates"],
        regime_width=values["regime_width"],
        limits=TrustLimits(**group("limits.")),
        health=HealthSettings(period=values["period"], **group("health.")),
    )


def read_settings(path: Path | None) -> TwinSettings:
    """Settings from the sections of a ROS parameter file that concern the twin's nodes.

    Without a file, the defaults. Sections of other nodes are passed over.

    Raises:
        ParameterError: the file is not there, is no parameter file, or has a parameter that does not
            exist or is out of range.
    """
    if path is None:
        return settings_from(check("twin", TWIN_PARAMETERS, {}))
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise ParameterError(msg) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        msg = f"{path}: is no YAML file: {str(error).splitlines()[0]}"
        raise ParameterError(msg) from error
    given: dict[str, Any] = {}
    for node in ("/**", "matcher", "discriminator", "/matcher", "/discriminator"):
        section = content.get(node) if isinstance(content, dict) else None
        if section is None:
            continue
        parameters = section.get("ros__parameters") if isinstance(section, dict) else None
        if not isinstance(parameters, dict):
            msg = f"{path}: section {node} has no ros__parameters; see the files in config/"
            raise ParameterError(msg)
        given.update(_flat(parameters))
    if not given:
        msg = f"{path}: has no section /**, matcher or discriminator; see the files in config/"
        raise ParameterError(msg)
    try:
        return settings_from(check(str(path), TWIN_PARAMETERS, given))
    except ParameterError:
        raise
    except ValueError as error:
        msg = f"{path}: {error}"
        raise ParameterError(msg) from error


def at_period(settings: TwinSettings, period: float, config: Path | None) -> TwinSettings:
    """The settings for a session's sample time (s); a file that says another one is a mistake.

    Raises:
        TwinError: `config`, the file the settings are from, has another period.
    """
    if abs(period - settings.period) <= 0.01 * settings.period:
        return settings
    if config is not None:
        msg = f"{config}: the period is {settings.period:g} s, but the samples come every {period:g} s"
        raise TwinError(msg)
    return replace(settings, period=period, gains=replace(settings.gains, period=period))


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = value
    return flat
