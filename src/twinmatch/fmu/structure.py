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

from twinmatch.dynamics import Model, Parameter, State, Structure
from twinmatch.fmu.archive import MOST_BYTES, digest_of
from twinmatch.fmu.errors import FmuError
from twinmatch.fmu.kernels import FmuKernels
from twinmatch.fmu.mapping import FmuMap, read_maps
from twinmatch.fmu.places import Places
from twinmatch.fmu.runner import Runner
from twinmatch.fmu.trial import check_restart
from twinmatch.plants.absent import MARK, is_marked

__all__ = ["FmuSource", "adopt_fmus", "is_fmu", "unmarked"]


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
        places = Places(
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
    if held is not None and held.elsewhere is not None and not held.elsewhere.lost:
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
            elsewhere=source,
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
