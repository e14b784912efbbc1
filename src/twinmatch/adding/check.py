"""All checks of a plant file that need no data.

Equations, declarations, behaviour at its defaults and within the bounds of its parameters, and which faults
cannot be told apart.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from itertools import combinations
from typing import Any, Final

import numpy as np

from twinmatch.adding.confusions import confusions
from twinmatch.adding.dimensions import Dimensions
from twinmatch.adding.trial import (
    CheckedPlant,
    Finding,
    affordable,
    inseparable,
    modes,
    run_trial,
    time_constants,
    trial_for,
)
from twinmatch.dynamics import (
    Equations,
    Model,
    Parameters,
    Plant,
    PlantError,
    advance,
    begin,
)
from twinmatch.dynamics.equations import outputs_of, written_equations
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_OF_STRUCTURE: Final = re.compile(r"structure ('[^']*'|\"[^\"]*\"): ")
_NUMBER: Final = re.compile(r"(?<![\w.])-?\d")
Shown = Callable[[str, int, int], None]
"""Called with what is being done, how many parts of it are, and of how many."""


def check_plant(
    plant: type[Plant], period: float | None = None, show: Shown = lambda *_: None
) -> CheckedPlant:
    """Check a plant.

    Args:
        plant: the plant.
        period: sampling period, s; by default that of its loop. Without either, checks that depend on it are
            skipped.
        show: called before every check with what is checked, the number of checks made, and that of all.
    """
    if period is None and plant.loop is not None:
        period = plant.loop.period
    findings: list[Finding] = []
    notes: list[str] = []
    unusable = ""
    try:
        for faults, remarks in _steps(plant, period, show):
            findings += faults
            notes += [note for note in remarks if note not in notes]
        notes += [] if findings else confusions(plant, period)
    except PlantError as error:
        unusable = str(error)
    return CheckedPlant(
        plant.title, tuple(_once(findings, plant.title)), tuple(notes), unusable
    )


def _once(findings: Iterable[Finding], title: str) -> Iterator[Finding]:
    """Findings that several structures share, once: their numbers are those of the first."""
    by_message: dict[str, dict[str, Finding]] = {}
    for finding in findings:
        structure, message = _structure_and_message(finding)
        has_numbers_of_structure = structure or message.startswith(f"{title}:")
        key = _NUMBER.split(message)[0] if has_numbers_of_structure else message
        by_message.setdefault(key, {}).setdefault(
            structure, finding._replace(what=message)
        )
    for by_structure in by_message.values():
        message, todo = next(iter(by_structure.values()))
        yield Finding(f"{_structures_in_words(list(by_structure))}{message}", todo)


def _structure_and_message(finding: Finding) -> tuple[str, str]:
    """The quoted name of the structure that a finding begins with, empty without one, and what follows it."""
    begins_with_structure = _OF_STRUCTURE.match(finding.what)
    if begins_with_structure is None:
        return "", finding.what
    return begins_with_structure[1], finding.what[begins_with_structure.end() :]


def _structures_in_words(names: list[str]) -> str:
    """The beginning of a finding of these structures."""
    *first_names, last = names
    if first_names:
        return f"structures {', '.join(first_names)} and {last}: "
    return f"structure {last}: " if last else ""


def _steps(
    plant: type[Plant], period: float | None, show: Shown
) -> Iterator[tuple[Iterable[Finding], list[str]]]:
    total = len(plant.structures) + 1
    show("checking declarations and units", 0, total)
    dimensions = Dimensions(plant)
    for parts in dict.fromkeys(
        structure.parts for structure in plant.structures.values()
    ):
        dimensions.check(parts)
    yield dimensions.findings.values(), _unit_notes(dimensions)
    yield (
        unreached(plant),
        [f"disturbance {n}: in no equation" for n in idle_disturbances(plant)],
    )
    yield coarse(plant), []
    yield _unused(plant), []
    for number, name in enumerate(plant.structures, 1):
        show(f"checking structure {name}", number, total)
        model = plant.model(name)
        yield misdeclared(model), []
        yield ranges(model), []
        yield pace(model, period)
        yield inseparable(model), []
        yield in_bounds(model, period), []


def _unit_notes(dimensions: Dimensions) -> list[str]:
    notes = []
    if dimensions.unknown_units:
        notes.append(
            f"unknown units are treated as plain numbers: {', '.join(dimensions.unknown_units)}"
        )
    if dimensions.unchecked:
        listed = ", ".join(sorted(dimensions.unchecked))
        notes.append(
            f"units were not checked where these numbers multiply: {listed}. To give such a number a unit, "
            "declare it as a Parameter that is in no `free`"
        )
    return notes


def _unused(plant: type[Plant]) -> Iterator[Finding]:
    models: list[Model] = [plant.model(name) for name in plant.structures]
    used = {name for model in models for name in (*model.declared, *model.states)}
    parts = {
        part for structure in plant.structures.values() for part in structure.parts
    }
    for message, todo, declared, in_use in (
        (
            "parameter {}: no structure depends on it",
            "use it in the equations",
            plant.parameters,
            used,
        ),
        (
            "state {}: no structure gives it a rate",
            "give it a rate and a start",
            plant.states,
            used,
        ),
        (
            "part {!r}: no structure has it",
            "add a structure with it",
            plant.parts,
            parts,
        ),
    ):
        yield from (
            Finding(message.format(n), f"remove it, or {todo}")
            for n in declared
            if n not in in_use
        )


def unreached(plant: type[Plant]) -> Iterator[Finding]:
    """Drive and states that do not act on the output, and parts that change nothing."""
    equations = _equations(plant)
    for name, written in equations.items():
        place = f"structure {name!r}"
        outputs = list(outputs_of(plant(), written).values())
        acting = _acting(written, outputs)
        used = _names(
            [
                *outputs,
                *(
                    rate
                    for state, rate in written.rates.items()
                    if str(state) in acting
                ),
            ]
        )
        for drive in plant.drives:
            if drive not in used:
                problem = f"{place}: the drive {drive} does not act on the output"
                yield Finding(
                    problem,
                    f"use self.{drive} in the rate of a state that the output depends on",
                )
        for state in (
            str(state) for state in written.rates if str(state) not in acting
        ):
            problem = f"{place}: state {state} does not act on the output, so no recording can show it"
            yield Finding(
                problem, "remove it, or use it in the output or in another rate"
            )
    yield from _same(plant, equations)


def idle_disturbances(plant: type[Plant]) -> list[str]:
    """Names of disturbances that are in no equation."""
    used: set[str] = set()
    for written in _equations(plant).values():
        outputs = outputs_of(plant(), written).values()
        used |= _names([*written.rates.values(), *outputs, *written.start.values()])
    return [name for name in plant.disturbances if name not in used]


def _equations(plant: type[Plant]) -> dict[str, Equations]:
    """By structure; FMUs have none here."""
    return {
        name: written_equations(plant(), structure.parts)
        for name, structure in plant.structures.items()
        if structure.external is None
    }


def _acting(written: Equations, outputs: list[Any]) -> set[str]:
    """States that act on an output, at once or through others."""
    states = {str(state): rate for state, rate in written.rates.items()}
    acting = _names(outputs) & set(states)
    while reached := (_names(states[name] for name in acting) & set(states)) - acting:
        acting |= reached
    return acting


def _same(plant: type[Plant], equations: dict[str, Equations]) -> Iterator[Finding]:
    """Structures with other parts but the same equations."""
    for first, second in combinations(equations, 2):
        parts = plant.structures[second].parts ^ plant.structures[first].parts
        if parts and _are_same(equations[first], equations[second]):
            listed = " and ".join(sorted(parts))
            problem = f"structures {first!r} and {second!r} have the same equations: {listed} changes nothing"
            yield Finding(
                problem, "use the part in `equations`, or remove one of the structures"
            )


def _are_same(first: Equations, second: Equations) -> bool:
    return (first.rates, first.output, first.start) == (
        second.rates,
        second.output,
        second.start,
    )


def _names(expressions: Iterable[Any]) -> set[str]:
    return {str(s) for e in expressions for s in getattr(e, "free_symbols", ())}


class _Simulation(Rule):
    """How a plant is tried, and how slow its simulation may be."""

    points: int = 24
    """Points within the bounds of the parameters at which it is tried."""
    slow: int = 40
    """Steps per sample from which fits are slow: a hundred windows of a thousand samples take a minute."""
    too_slow: int = 400
    """Steps per sample from which those windows take ten minutes, too long beside a running plant."""
    most_samples: float = 1e5
    """A time constant of more sampling periods needs recordings that are too long to be matched."""
    growth: float = 1e-6
    """Growth rates below this share of the plant's fastest rate are rounding."""


_SIMULATION: Final = _Simulation()


def coarse(plant: type[Plant]) -> Iterator[Finding]:
    """Whether steps that stand out from the output's noise fit into its span."""
    for y in plant.outputs.values():
        low, high = y.span
        if y.least_step > high - low:
            step = f"a step that stands out is {y.least_step:g} {y.unit}, more than its span {low:g} to {high:g}"
            problem = f"{y.name}: with a noise of {y.noise:g} {y.unit}, {step}"
            yield Finding(
                problem, "correct `noise`, the scatter of a reading at rest, or `span`"
            )


def misdeclared(model: Model) -> Iterator[Finding]:
    """Contradictory declarations of one structure."""
    place = f"structure {model.structure_name!r}"
    for name in model.structure.free:
        low, high = model.declared[name].bounds
        value = model.defaults[name]
        if not low <= value <= high:
            problem = f"{place}: the default of {name}, {value:g}, is outside its bounds {low:g} to {high:g}"
            yield Finding(
                problem, "widen the bounds, or correct the default (or `fixed`)"
            )


def ranges(model: Model) -> Iterator[Finding]:
    """Whether outputs and states stay within their spans, at the defaults.

    Not asked where nothing pulls a state back, as at a motor's angle: how far it goes depends on the time.
    """
    parameters = model.parameters()
    trial = trial_for(parameters)
    run, _ = run_trial(parameters, trial)
    states = begin(parameters, trial.outputs, input=trial.inputs[0])
    _, by_state, _, _, output_by_state, _, _ = model.kernels.slopes_at(
        parameters.vector, states, trial.inputs[0], model.disturbances
    )
    integrates = ~by_state.any(axis=0)
    outputs = model.plant.outputs
    for y, values, by_state_of_output in zip(
        outputs.values(), run.outputs.T, output_by_state, strict=True
    ):
        low = float(values.min())
        high = float(values.max())
        if (low < y.span[0] or high > y.span[1]) and not by_state_of_output[
            integrates
        ].any():
            name = f"the output {y.name}" if len(outputs) > 1 else "the output"
            yield Finding(
                f"{model.title}: with the defaults, over the drive's range, {name} goes from {low:.4g} to "
                f"{high:.4g} {y.unit}, beyond its span {y.span[0]:g} to {y.span[1]:g}",
                "widen `span` of the output, or check default values and units of the parameters",
            )
    least = states.copy()
    most = states.copy()
    for u, row in zip(trial.inputs, trial.disturbances, strict=True):
        states = advance(parameters, states, u, trial.period, row)
        least = np.minimum(least, states)
        most = np.maximum(most, states)
    for k, name in enumerate(model.states):
        span = model.plant.states[name].span
        if (least[k] < span[0] or most[k] > span[1]) and not integrates[k]:
            yield Finding(
                f"{model.title}: state {name} goes from {least[k]:.4g} to {most[k]:.4g}, beyond its span "
                f"{span[0]:g} to {span[1]:g}",
                "widen `span` of the state: it determines the simulation's step",
            )


def pace(model: Model, period: float | None) -> tuple[list[Finding], list[str]]:
    """Compare time constants and sampling period, s."""
    parameters = model.parameters()
    lags = time_constants(parameters)
    place = f"structure {model.structure_name!r}"
    if not lags.size:
        return [], ["there is no finite time constant (an integrator)"]
    faults = [*_growing(place, parameters)]
    listed = ", ".join(f"{lag:.3g} s" for lag in lags)
    notes = [f"time constants at the defaults: {listed}"]
    if period is None:
        return faults, notes
    try:
        steps = parameters.steps(period)
    except PlantError as error:
        todo = "replace the fast state by its steady-state value, or sample faster"
        return [
            *faults,
            Finding(f"{place}: {str(error).partition(': ')[2]}", todo),
        ], notes
    problem = (
        f"{place}: a sample of {period:g} s takes {steps} simulation steps; its shortest time constant "
        f"is {lags[0]:.3g} s"
    )
    if steps > _SIMULATION.too_slow:
        todo = "replace the fast state by its steady-state value, or narrow the spans of the states"
        faults.append(Finding(problem, todo))
    elif steps > _SIMULATION.slow:
        notes.append(f"{problem}: fits are slow")
    slowest = f"{place}: its slowest time constant, {lags[-1]:.3g} s, is"
    if lags[-1] < period:
        todo = "sample faster, or check the units of the parameters (s, not min)"
        faults.append(Finding(f"{slowest} below the period of {period:g} s", todo))
    if lags[-1] > _SIMULATION.most_samples * period:
        many = f"{lags[-1] / period:.2g} periods of {period:g} s: no window can show it"
        faults.append(
            Finding(
                f"{slowest} {many}",
                "sample less often, hold that state, or check units (s, not h)",
            )
        )
    return faults, notes


def _growing(place: str, parameters: Parameters) -> Iterator[Finding]:
    """Modes that grow by themselves in the middle of the plant's range."""
    poles = modes(parameters)
    growth = float(poles.real.max(initial=0.0))
    if growth > _SIMULATION.growth * float(np.abs(poles).max(initial=0.0)):
        problem = f"{place}: it is unstable at its defaults: deviations grow by e in {1 / growth:.3g} s"
        yield Finding(
            problem,
            "look for a wrong sign in the rates; an unstable plant needs a known `loop`",
        )


def in_bounds(model: Model, period: float | None) -> Iterator[Finding]:
    """Whether the plant can be simulated within the bounds, at points spread over them and sampled every
    `period` s; None: as fast as each needs."""
    free = [name for name in model.structure.free if name in model.declared]
    if not free:
        return
    try:
        trial = trial_for(model.parameters(), period)
    except PlantError:
        return
    bad: list[str] = []
    for row in _spread_points(len(free), _SIMULATION.points):
        values = {
            n: _within(model, n, float(part)) for n, part in zip(free, row, strict=True)
        }
        where = ", ".join(f"{n} = {v:.3g}" for n, v in values.items())
        try:
            point = model.parameters(**values)
            trial_period = trial.period if period else affordable(point, trial.period)
            run, _ = run_trial(point, trial._replace(period=trial_period))
        except PlantError as error:
            bad.append(f"{where}: {str(error).removeprefix(f'{model.title}: ')}")
            continue
        spans = [np.ptp(y.span) for y in model.plant.outputs.values()]
        largest = float(np.abs(run.outputs).max())
        if (np.abs(run.outputs).max(axis=0) > 1e4 * np.array(spans)).any():
            bad.append(f"{where}: its output diverges to {largest:.2g}")
    if bad:
        share = f"{len(bad)} of {_SIMULATION.points} points"
        problem = f"structure {model.structure_name!r}: cannot be simulated at {share}"
        todo = "narrow the bounds to values that are physically possible"
        yield Finding(f"{problem} within the bounds, such as {bad[0]}", todo)


def _spread_points(dimensions: int, count: int) -> FloatArray:
    """Points spread over a unit cube, shape (count, dimensions), the same in every run.

    A Latin hypercube: of as many slices of each dimension as there are points, every one holds one of them.
    """
    random = np.random.default_rng(5)
    slices = random.permuted(np.tile(np.arange(count), (dimensions, 1)), axis=1).T
    return np.asarray(
        (slices + random.random((count, dimensions))) / count, dtype=np.float64
    )


def _within(model: Model, name: str, part: float) -> float:
    """A value between the bounds: on a logarithmic scale where they are positive and far apart."""
    low, high = model.declared[name].bounds
    if low > 0 and high > 10 * low:
        return float(low * (high / low) ** part)
    return low + part * (high - low)
