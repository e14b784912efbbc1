"""The parameters of the running loop and of the twin's nodes, and the settings they define.

Controller and twin must agree on sampling period and PID; matcher, discriminator and twin simulator on all,
so they share one table, and an offline replay reads the same file. The start values, with their units and
ranges, are those of the selected `plant` and `structure`.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from twinmatch.dynamics import (
    FROM_PLANT_FILE,
    Drive,
    FromPlantFile,
    Law,
    LoopLaw,
    Model,
    Output,
    PidGains,
    PidLoops,
    Plant,
    PlantError,
    Sensor,
    law_for,
    pids_of,
)
from twinmatch.dynamics.pace import time_scale
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Noise
from twinmatch.parameters.declared import (
    ParameterError,
    Setting,
    Values,
    check,
    group,
    parameters_of,
    sections_of,
)
from twinmatch.plants import Peltier, find_plant, plant_named, written_name
from twinmatch.plants.records import structure_of
from twinmatch.twin import (
    ForecastSettings,
    ScheduleSettings,
    TrustLimits,
    TwinError,
    TwinSettings,
)

UNKNOWN: Final = "unknown"
"""Value of `loop` for a twin that is driven by the recorded input."""

_SHORTEST: Final = 1e-6
"""Least sampling period of recorded samples, s: those of a converter are some microseconds apart."""
_MAX_GAIN = 1e4
"""Largest gain; a larger one means a wrong unit."""


def unit_of(signal: Output | Drive) -> str:
    """Unit of a control or reading; a control's name where it has none."""
    return signal.unit or (signal.name if isinstance(signal, Drive) else "")


def closing_of(values: Mapping[str, Any]) -> LoopLaw:
    """The loop that parameter `loop` selects; without it, that of the plant file."""
    return (
        None
        if values.get("loop", FromPlantFile.LOOP.value) == UNKNOWN
        else FROM_PLANT_FILE
    )


def loop_parameters(
    plant: type[Plant],
    closing: LoopLaw = FROM_PLANT_FILE,
    *,
    shortest: float = 1e-3,
) -> tuple[Setting, ...]:
    """The sampling period, and the gains of the plant's controller if it is known: of several PIDs, lists.

    `shortest`: least period that is allowed, s; default: what a loop on this machine can keep.
    """
    usual = plant.loop.period if plant.loop else 1.0
    pids = pids_of(law_for(plant, usual, closing))
    period = Setting(
        "period", usual, "Sampling period of the loop.", "s", shortest, 1e5
    )
    if not pids:
        return (period,)
    drives = plant.drives.values()
    u = joined_units(map(unit_of, drives))
    y = joined_units(output.unit for output in plant.outputs.values())
    limits = _widest([drive.limits for drive in drives])

    def gain(
        name: str, text: str, unit: str = "", span: tuple[float, float] | None = None
    ) -> Setting:
        values = [getattr(pid, name) for pid in pids]
        low, high = span or _widest(list(map(_span, values)))
        return Setting(f"pid.{name}", one_or_each(values), text, unit, low, high)

    flag = "Derivative of the measurement instead of the error: no kick at set-point steps."
    return (
        period,
        gain("proportional", "Proportional gain of the running PID.", f"{u}/{y}"),
        gain("integral", "Integral gain.", f"{u}/({y}·s)"),
        gain("derivative", "Derivative gain.", f"{u}·s/{y}"),
        gain("back_calculation", "Anti-windup gain.", "1/s", (0.0, 1e3)),
        gain("low", "Lower output limit.", u, limits),
        gain("high", "Upper output limit.", u, limits),
        gain("on_measurement", flag, span=(-math.inf, math.inf)),
    )


def _widest(spans: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The range that holds all of these."""
    return min(low for low, _ in spans), max(high for _, high in spans)


def one_or_each(values: Sequence[Any]) -> Any:
    """The value of a single signal; of several, the list."""
    return values[0] if len(values) == 1 else list(values)


def joined_units(units: Iterable[str]) -> str:
    """The unit of signals; if they have several, all of them."""
    return ", ".join(dict.fromkeys(units))


def running_law(values: Mapping[str, Any], usual: Law | None) -> Law | None:
    """The controller from checked parameter values; `usual` is that of the plant file.

    Raises:
        ParameterError: a list of gains does not have one for each loop.
    """
    gains = group(values, "pid.")
    count = len(pids_of(usual))
    if count == 0:
        return usual
    if count == 1:
        return PidGains(period=values["period"], **gains)
    for name, of_loops in gains.items():
        if len(of_loops) != count:
            raise ParameterError(
                f"pid.{name} has {len(of_loops)} values; give one for each of {count} loops"
            )
    pids = []
    for k in range(count):
        gains_of_loop = {name: of_loops[k] for name, of_loops in gains.items()}
        pids.append(PidGains(period=values["period"], **gains_of_loop))
    return PidLoops.of(*pids)


def _span(default: float) -> tuple[float, float]:
    """The range of a gain, without the wrong sign, which would drive the plant away from its set-point."""
    return (0.0, _MAX_GAIN) if default >= 0 else (-_MAX_GAIN, 0.0)


_RENAMED: Final[Mapping[str, tuple[str, ...]]] = {
    "noise.temperature": ("noise.output",),
    "noise.pwm": ("noise.input",),
    "camera.noise": ("sensor.noise",),
    "camera.resolution": ("sensor.resolution",),
    "pid.limit": ("pid.low", "pid.high"),
}
"""Parameters of earlier versions, and their current names."""
_MONITOR: Final = "only the health monitor reports faults"
_BANDS: Final = "limits.doubtful sets how far beyond its bands a twin is doubtful"
_GONE: Final = {
    "schedule.min_input_step": "schedule.min_step is how far the output has to move, as expected of inputs",
    "limits.fault_y": _MONITOR,
    "limits.fault_u": _MONITOR,
    "limits.doubtful_y": _BANDS,
    "limits.doubtful_u": _BANDS,
    "health.drift": "health.change sets the evidence needed to report a change",
}
"""Removed parameters, and their replacements."""
_START: Final = "start."


def twin_table(
    plant: type[Plant] = Peltier,
    structure: str | None = None,
    closing: LoopLaw = FROM_PLANT_FILE,
    period: float | None = None,
    scale: float = 1.0,
) -> tuple[Setting, ...]:
    """Name, default, meaning, unit, range of everything in `TwinSettings`, and of what single nodes need.

    Windows and horizons depend on the sampling period, s (None: the plant file's), and on `schedule.scale`.
    """
    usual = plant.loop.period if plant.loop else 1.0
    has = TwinSettings.of(
        plant, structure, usual if period is None else period, closing, scale
    )
    return (
        *_plant(has.start.model),
        Setting(
            "loop",
            FromPlantFile.LOOP.value if closing is FROM_PLANT_FILE else UNKNOWN,
            "Whether the twin runs in the loop of the plant file; unknown: the recorded input drives it.",
            choices=(FromPlantFile.LOOP.value, UNKNOWN),
        ),
        *loop_parameters(plant, closing, shortest=_SHORTEST),
        *_numbers(has),
        Setting(
            "recent",
            60,
            "Samples over which the live twin's residuals are averaged.",
            "samples",
            1,
            100000,
        ),
        *_stand_ins(plant),
        Setting(
            "candidates",
            "",
            "File of initial candidates, for discriminator and matcher; empty: none.",
        ),
        Setting(
            "allow_fmu",
            "",
            "File that adds FMUs as structures of the plant and permits running them; empty: none.",
        ),
    )


def _stand_ins(plant: type[Plant]) -> tuple[Setting, ...]:
    """What only plants with several outputs have: of one sensor nothing else says what it should read."""
    text = "Outputs whose estimates the law takes while their sensors are not believed; as in the bridge."
    return () if len(plant.outputs) == 1 else (Setting("read_through", "", text),)


def outputs_named(place: str, text: str, plant: type[Plant]) -> tuple[str, ...]:
    """Names of outputs in a text with spaces between; each by its name or its symbol.

    Raises:
        ParameterError: the plant has no such output.
    """
    name_of = {
        unicodedata.normalize("NFKC", y.symbol): name
        for name, y in plant.outputs.items()
    }
    name_of |= {name: name for name in plant.outputs}
    words = text.split()
    if wrong := next((word for word in words if word not in name_of), None):
        outputs = " or ".join(plant.outputs)
        raise ParameterError(
            f"{place}: read_through has {wrong}, no output of plant {plant.name}; give {outputs}"
        )
    return tuple(name_of[word] for word in words)


def understood(
    place: str, given_values: Mapping[str, Any]
) -> tuple[tuple[Setting, ...], dict[str, Any]]:
    """The table for the plant and structure selected by the given values, and the values to check against it.

    Raises:
        ParameterError: there is no such plant or structure, or it lacks a given parameter.
    """
    _refuse_renamed(place, given_values)
    try:
        if given_values.get("allow_fmu"):
            from twinmatch.fmu import adopt_fmus  # noqa: PLC0415

            adopt_fmus(Path(str(given_values["allow_fmu"])))
        plant = find_plant(str(given_values.get("plant", Peltier.name)))
        named = given_values.get("structure")
        model = plant.model(None if named is None else str(named))
        table = _table(model, given_values)
    except PlantError as error:
        raise ParameterError(f"{place}: {error}") from error
    return table, _without_absent(place, given_values, model)


def _table(model: Model, given_values: Mapping[str, Any]) -> tuple[Setting, ...]:
    """The table for given values; what they have wrong is found when they are checked against it."""
    table = partial(
        twin_table, model.plant, model.structure_name, closing_of(given_values)
    )
    accepted: dict[str, Any] = {
        setting.name: setting.accept(given_values[setting.name], "twin")
        for setting in table()
        if setting.name in {"period", "schedule.scale"} & given_values.keys()
    }
    return (
        table(accepted.get("period"), accepted.get("schedule.scale", 1.0))
        if accepted
        else table()
    )


def twin_values(place: str, given_values: Mapping[str, Any]) -> Values:
    """All parameters: those given, checked, and the defaults of the others."""
    table, checkable = understood(place, given_values)
    return check(place, table, checkable)


def recorded_values(place: str, recorded: Mapping[str, Any]) -> Values:
    """All parameters of a node as recorded in a session; names of earlier versions are accepted.

    A plant file or FMUs that a session names are not run: the plant and its structures must be known already.

    Raises:
        ParameterError: as `twin_values`.
    """
    translated = {
        name: value
        for name, value in _translate(recorded).items()
        if name != "allow_fmu"
    }
    if "schedule.scale" not in translated and isinstance(
        period := translated.get("period", 1.0), int | float
    ):
        translated = _by_sample_time(period) | translated
    if "plant" in translated:
        try:
            translated["plant"] = written_name(plant_named(str(translated["plant"])))
        except PlantError as error:
            raise ParameterError(f"{place}: {error}") from error
    return twin_values(place, translated)


def settings_from(values: Mapping[str, Any]) -> TwinSettings:
    """Settings from checked parameter values."""
    plant = find_plant(values["plant"])
    period = values["period"]
    scale = values["schedule.scale"]
    usual = TwinSettings.of(
        plant, values["structure"], period, closing_of(values), scale
    )
    forecasts = group(values, "forecasts.")
    forecasts["horizons"] = tuple(forecasts["horizons"])
    sensor = group(values, "sensor.")
    sensor["pause_period"] = sensor["pause_period"] or None
    return replace(
        usual,
        schedule=replace(usual.schedule, **group(values, "schedule.")),
        free=tuple(values["free"]),
        start=usual.start.replace(**group(values, "start.")),
        noise=Noise(values["noise.output"], values["noise.input"]),
        law=running_law(values, usual.law),
        sensor=Sensor(**sensor),
        seed=values["seed"],
        decimals=values["decimals"],
        most_candidates=values["most_candidates"],
        regime_width=values["regime_width"],
        limits=TrustLimits(**group(values, "limits.")),
        health=replace(usual.health, **group(values, "health.")),
        forecasts=ForecastSettings(**forecasts),
        read_through=outputs_named("twin", values.get("read_through", ""), plant),
    )


def values_of(settings: TwinSettings) -> Values:
    """The parameter values that give these settings: the inverse of `settings_from`."""
    model = settings.start.model
    values: Values = {
        "plant": written_name(model.plant),
        "structure": model.structure_name,
        "free": list(settings.free),
        "loop": FromPlantFile.LOOP.value if settings.law is not None else UNKNOWN,
    }
    pids = pids_of(settings.law)
    for parameter in table_of(settings):
        owner, _, name = parameter.name.partition(".")
        if owner == "start":
            values[parameter.name] = settings.start[name]
        elif owner == "pid":
            values[parameter.name] = one_or_each([getattr(pid, name) for pid in pids])
        elif owner == "noise":
            values[parameter.name] = one_or_each(getattr(settings.noise, f"{name}s"))
        elif name:
            value = getattr(getattr(settings, owner), name) or type(parameter.default)()
            values[parameter.name] = list(value) if isinstance(value, tuple) else value
        elif hasattr(settings, owner):
            value = getattr(settings, owner)
            values.setdefault(
                owner, " ".join(value) if isinstance(value, tuple) else value
            )
    return values


def table_of(settings: TwinSettings) -> tuple[Setting, ...]:
    """The parameters of the twin with the defaults for these settings."""
    model = settings.start.model
    closing = FROM_PLANT_FILE if settings.law is not None else None
    return twin_table(
        model.plant,
        model.structure_name,
        closing,
        settings.period,
        settings.schedule.scale,
    )


def read_settings(
    path: Path | None, plant: str = "", *, driven: bool = False
) -> TwinSettings:
    """Settings from the sections of a ROS parameter file that concern the twin's nodes.

    Without a file, the defaults. Sections of other nodes are ignored.

    Args:
        path: the file, if there is one.
        plant: name of the plant to judge, as in recordings; empty: that of the file, or the Peltier rig.
        driven: whether the data have no set-points; the loop is then unknown, unless the file says otherwise.

    Raises:
        DocumentError: the file is missing, or is not YAML.
        ParameterError: it is not a parameter file, has a parameter that does not exist or is out of range, or
            is for another plant.
    """
    wanted = {"plant": written_name(plant_named(plant))} if plant else {}
    if driven:
        wanted["loop"] = UNKNOWN
    if path is None:
        return settings_from(twin_values("twin", wanted))
    written = sections_of(
        path, "/**", "matcher", "discriminator", "/matcher", "/discriminator"
    )
    values = twin_values(str(path), wanted | written)
    try:
        settings = settings_from(values)
    except TwinmatchError as error:
        raise ParameterError(f"{path}: {error}") from error
    if plant and settings.plant is not plant_named(plant):
        raise ParameterError(
            f"{path}: is for plant {settings.plant.name}, but the data are of plant {plant}"
        )
    return settings


def at_period(
    settings: TwinSettings, period: float, config: Path | None
) -> TwinSettings:
    """The settings for a session's sampling period (s), which must agree with the file's.

    Raises:
        TwinError: `config`, the file the settings are from, has another period.
    """
    if abs(period - settings.period) <= 0.01 * settings.period:
        return settings
    if config is not None:
        msg = f"{config}: the period is {settings.period:g} s, but that of the samples is {period:g} s"
        raise TwinError(msg)
    model = settings.start.model
    closing = FROM_PLANT_FILE if settings.law is not None else None
    return TwinSettings.of(model.plant, model.structure_name, period, closing)


def _by_sample_time(period: float) -> Values:
    """What earlier versions did not record; horizons followed the sample time, s."""
    scale = time_scale(period)
    usual = ForecastSettings()
    return {
        "schedule.gap": ScheduleSettings.gap,
        "forecasts.horizons": [horizon * scale for horizon in usual.horizons],
        "forecasts.every": usual.every * scale,
        "forecasts.memory": usual.memory * scale,
    }


def _plant(model: Model) -> tuple[Setting, ...]:
    plant = model.plant
    structure = model.structure
    starts = tuple(
        Setting(
            f"start.{name}",
            model.defaults[name],
            f"Start value: {declared.text} ({declared.symbol or name}).",
            declared.unit,
            0.0 if declared.positive else declared.least,
            declared.most,
        )
        for name, declared in model.declared.items()
    )
    return (
        Setting(
            "plant",
            written_name(plant),
            "The plant: its name, or the file that defines it.",
        ),
        Setting(
            "structure",
            model.structure_name,
            "Structure of the model: the parts it has, and with them its start values.",
            choices=tuple(plant.structures),
        ),
        Setting(
            "free",
            list(structure.free),
            "Parameters that a match may change.",
            choices=tuple(model.names),
        ),
        *starts,
        _noise("noise.output", "Noise of a reading (1 σ).", plant.outputs.values()),
        _noise("noise.input", "Noise of the control (1 σ).", plant.drives.values()),
    )


def _noise(name: str, text: str, signals: Collection[Output | Drive]) -> Setting:
    """The noise of outputs or drives: a number, or one each of several."""
    noises = one_or_each([signal.noise for signal in signals])
    return Setting(name, noises, text, joined_units(map(unit_of, signals)), 1e-6, 1e6)


def _numbers(has: TwinSettings) -> tuple[Setting, ...]:
    """Schedule, sensor, family, trust and health: the numbers in the settings under the same names."""
    plant = has.plant
    names = {
        "y": unit_of(next(iter(plant.outputs.values()))),
        "u": unit_of(next(iter(plant.drives.values()))),
    }
    sensor = (
        ("noise", "Noise of the simulated sensor of the twin (1 σ).", names["y"]),
        ("resolution", "Resolution of its readings; 0: continuous.", names["y"]),
        (
            "pause_period",
            "Time between two pauses, in which its reading stands still; 0: no pauses.",
            "s",
        ),
        ("pause_duration", "Duration of a pause.", "s"),
    )
    return (
        *parameters_of(has.schedule, "schedule.", **names),
        *(
            Setting(
                f"sensor.{name}", getattr(has.sensor, name) or 0.0, text, unit, 0.0, 1e6
            )
            for name, text, unit in sensor
        ),
        *parameters_of(has, **names),
        *parameters_of(has.forecasts, "forecasts.", **names),
        *parameters_of(has.limits, "limits.", **names),
        *parameters_of(has.health, "health.", **names),
    )


def _refuse_renamed(place: str, given_values: Mapping[str, Any]) -> None:
    for name, new_names in _RENAMED.items():
        if name in given_values:
            raise ParameterError(
                f"{place}: {name} is now called {' and '.join(new_names)}; rename it"
            )
    for name, instead in _GONE.items():
        if name in given_values:
            raise ParameterError(
                f"{place}: {name} is no longer used: {instead}; remove it"
            )


def _without_absent(
    place: str, given_values: Mapping[str, Any], model: Model
) -> dict[str, Any]:
    """The given values without zeros for what the structure lacks: earlier versions left parts out so.

    Raises:
        ParameterError: a parameter that this structure lacks has a value other than zero.
    """
    remaining = dict(given_values)
    for name, value in given_values.items():
        parameter = name.removeprefix(_START)
        if (
            parameter == name
            or parameter in model.declared
            or parameter not in model.plant.parameters
        ):
            continue
        if value:
            plant = model.plant
            having = [
                s for s in plant.structures if parameter in plant.model(s).declared
            ]
            absent = f"structure {model.structure_name!r} has no {parameter}"
            raise ParameterError(
                f"{place}: parameter {name} is {value}, but {absent}; "
                f"choose a structure that has: {', '.join(having) or 'none'}"
            )
        del remaining[name]
    return remaining


def _translate(recorded: Mapping[str, Any]) -> dict[str, Any]:
    translated = {
        name: value
        for name, value in recorded.items()
        if name not in {*_RENAMED, *_GONE}
    }
    for old, names in _RENAMED.items():
        if old in recorded:
            translated |= dict.fromkeys(names, recorded[old])
    if "pid.limit" in recorded:
        translated["pid.low"] = -recorded["pid.limit"]
    if (
        "structure" not in translated
        and translated.get("plant", Peltier.name) == Peltier.name
    ):
        starts = {
            n.removeprefix(_START): v
            for n, v in translated.items()
            if n.startswith(_START)
        }
        translated["structure"] = structure_of(Peltier, starts)
    return translated
