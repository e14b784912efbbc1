"""FMUs taken in as structures of a plant.

The name of such a structure carries a mark, the first digits of a hash of FMU and map: who reads it in a
verdict knows which program it was, and the same name means the same program.
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
from twinmatch.fmu.trial import tried
from twinmatch.plants.absent import MARK, is_marked

__all__ = ["FmuSource", "adopt_fmus", "is_fmu", "unmarked"]


class FmuSource:
    """What stands behind a structure that is an FMU; see `twinmatch.dynamics.Elsewhere`."""

    def __init__(self, of: FmuMap, name: str, digest: str) -> None:
        self.map, self.runner = of, Runner(of, f"{of.plant.title}, {name}", digest)

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Those that only the FMU has."""
        return self.map.parameters

    @property
    def states(self) -> Mapping[str, State]:
        """Those that only the FMU has."""
        return self.map.states

    @property
    def lost(self) -> str:
        """Why it cannot be run any more; empty while it can."""
        return self.runner.lost

    @cached_property
    def kernels(self) -> Any:
        """Its functions."""
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
    """The name of a structure as its map has it."""
    return MARK.sub("", structure)


def adopt_fmus(file: Path) -> tuple[Model, ...]:
    """Take in the FMUs of a file as structures of its plant; each is loaded and tried.

    Whoever calls this has the user's word that these programs may run.

    Raises:
        FmuError: the file or an FMU cannot be used.
        PlantError: a structure cannot be what it is said to be.
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
        tried(model)
    except BaseException:
        of.plant.disown(name)
        raise
    return model


def _digest(of: FmuMap) -> str:
    try:
        if of.file.stat().st_size > MOST_BYTES:
            raise FmuError(f"{of.place}: {of.file} is larger than {MOST_BYTES >> 20} MiB; no FMU is")
        return digest_of(of.file)
    except OSError as error:
        raise FmuError(f"{of.place}: {of.file} cannot be read: {error.strerror}") from error


def _mark(of: FmuMap, digest: str) -> str:
    """Of the FMU and of all that its map says but where it is."""
    starts = {name: formula.text for name, formula in of.starts.items()}
    what = (
        digest, of.kind, _sorted(of.links.items()), _sorted(starts.items()), of.free,
        _sorted(of.fixed.items()), of.free_starts, _sorted(of.parameters.items()), _sorted(of.states.items()),
    )  # fmt: skip
    return hashlib.sha256(repr(what).encode()).hexdigest()[:8]


def _sorted(items: Iterable[tuple[str, Any]]) -> list[tuple[str, Any]]:
    return sorted((name, repr(value)) for name, value in items)
