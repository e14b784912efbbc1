"""FMUs added to a plant as structures.

The name of such a structure contains the first digits of a hash of FMU and map, so that the name in a verdict
identifies the program.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from twinmatch.dynamics import Model, Parameter, State, Structure, begin, simulate_driven
from twinmatch.fmu.archive import MOST_BYTES, FmuError, digest_of
from twinmatch.fmu.differences import Differences
from twinmatch.fmu.kernels import FmuKernels
from twinmatch.fmu.mapping import FmuMap, read_maps
from twinmatch.fmu.runner import Runner
from twinmatch.plants.records import MARK, is_marked

SAMPLES = 8
_STATE = 1e-4
"""Tolerance of a state, in units of its span: a restarted solver chooses other steps."""


def check_restart(model: Model) -> None:
    """Simulate a few samples in one run, and again restarting at each from its states; both must agree.

    Forecasts start from states that an observer has estimated. An FMU with internal states that its map does
    not name, such as a filter, would then give wrong forecasts.

    Raises:
        FmuError: they disagree, or the FMU has no finite values.
    """
    plant, kernels = model.plant, model.kernels
    low, high = plant.drive.limits
    drive = np.repeat([0.5 * (plant.drive.rest + high), 0.5 * (plant.drive.rest + low)], SAMPLES // 2)
    parameters = model.parameters()
    period = 1.0 if plant.loop is None else plant.loop.period
    y = float(np.mean(plant.output.set_points or plant.output.span))
    run = simulate_driven(parameters, drive, states=begin(parameters, y), period=period)
    spans = np.array([state.span[1] - state.span[0] for state in model.declared_states])
    for k, u in enumerate(drive.tolist()):
        after = kernels.advance(parameters.vector, run.states[k], u, model.disturbances, period, run.steps)
        seen, _ = kernels.outputs_at(parameters.vector, run.states[k], plant.drive.rest, model.disturbances)
        off = np.abs(after - run.states[k + 1]) / spans if spans.size else np.zeros(1)
        if abs(seen - run.output[k]) > plant.output.noise or off.max() > _STATE:
            what = f"its output {seen:g} instead of {run.output[k]:g}"
            if off.max() > _STATE:
                name = model.states[int(np.argmax(off))]
                what = f"{name} {after[np.argmax(off)]:g} instead of {run.states[k + 1][np.argmax(off)]:g}"
            raise FmuError(
                f"{model.title}: restarted from its states, the FMU has {what}; it has internal states that "
                "its map does not name: name all, or export it as model exchange"
            )


class FmuSource:
    """The implementation of a structure that is an FMU; see `twinmatch.dynamics.Elsewhere`."""

    def __init__(self, of: FmuMap, name: str, digest: str) -> None:
        self.map, self.runner = of, Runner(of, f"{of.plant.title}, {name}", digest)

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Parameters that only the FMU has."""
        return self.map.parameters

    @property
    def states(self) -> Mapping[str, State]:
        """States that only the FMU has."""
        return self.map.states

    @property
    def lost(self) -> str:
        """Why it can no longer be run; empty while it can."""
        return self.runner.lost

    @cached_property
    def kernels(self) -> Any:
        """Its kernels."""
        of = self.map
        parameters = {**of.plant.parameters, **of.parameters}
        states = {**of.plant.states, **of.states}
        places = Differences(
            of.plant,
            [parameters[name] for name in of.known_parameters],
            [states[name] for name in of.known_states],
            of.starts,
        )
        return FmuKernels(self.runner, places)


def is_fmu(structure: str) -> bool:
    """Whether the name of a structure is that of an FMU."""
    return is_marked(structure)


def unmarked(structure: str) -> str:
    """The name of a structure in its map, without the hash."""
    return MARK.sub("", structure)


def adopt_fmus(file: Path) -> tuple[Model, ...]:
    """Add the FMUs of a map file to its plant as structures; each is loaded and checked.

    Call it only if the user has allowed these programs to run.

    Raises:
        FmuError: the file or an FMU cannot be used.
        PlantError: a structure is not valid for the plant.
    """
    return tuple(_adopted(of) for of in read_maps(file))


def _adopted(of: FmuMap) -> Model:
    digest = _digest(of)
    name = f"{of.name} (FMU {_mark(of, digest)})"
    held = of.plant.structures.get(name)
    if held is not None and held.external is not None and not held.external.lost:
        return of.plant.model(name)
    for other in [n for n in of.plant.structures if unmarked(n) == of.name and n != of.name]:
        of.plant.disown(other)
    source = FmuSource(of, name, digest)
    model = of.plant.adopt(
        name,
        Structure(
            free=of.free,
            fixed=of.fixed,
            free_starts=of.free_starts,
            starts=of.searches,
            watched=of.watched,
            text=f"FMU {of.file.name}",
            external=source,
        ),
    )
    try:
        source.runner.start()
        check_restart(model)
        source.runner.in_use = True
    except BaseException:
        of.plant.disown(name)
        raise
    return model


def _digest(of: FmuMap) -> str:
    if not of.file.is_file():  # a pipe or a device would never end
        raise FmuError(f"{of.place}: {of.file} does not exist or is not a file; give the path of an FMU")
    try:
        if of.file.stat().st_size > MOST_BYTES:
            raise FmuError(f"{of.place}: {of.file} is larger than the limit of {MOST_BYTES >> 20} MiB")
        return digest_of(of.file)
    except OSError as error:
        raise FmuError(f"{of.place}: {of.file} cannot be read: {error.strerror}") from error


def _mark(of: FmuMap, digest: str) -> str:
    """First digits of a hash of the FMU and its map, without the path of the file."""
    starts = {name: formula.text for name, formula in of.starts.items()}
    what = (
        digest, of.kind, _sorted(of.links.items()), _sorted(starts.items()), of.free,
        _sorted(of.fixed.items()), of.free_starts, _sorted(of.parameters.items()), _sorted(of.states.items()),
    )  # fmt: skip
    return hashlib.sha256(repr(what).encode()).hexdigest()[:8]


def _sorted(items: Iterable[tuple[str, Any]]) -> list[tuple[str, Any]]:
    return sorted((name, repr(value)) for name, value in items)
