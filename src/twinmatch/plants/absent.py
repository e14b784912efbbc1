"""Stand-ins for external structures in a process without them, such as a page that only displays them.

The name of an external structure ends in a mark, as in `the maker's (FMU 0ab36ba3)`, which distinguishes it
from an unknown name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, NoReturn

from twinmatch.dynamics import Parameter, Plant, State, Structure, StructureLostError

__all__ = ["MARK", "is_marked", "stand_in"]

MARK: Final = re.compile(r" \(FMU [0-9a-f]{8}\)$")
_ANYTHING: Final = (-1e300, 1e300)


def is_marked(structure: str) -> bool:
    """Whether this is the name of an external structure."""
    return MARK.search(structure) is not None


def stand_in(plant: type[Plant], structure: str, names: Sequence[str]) -> None:
    """Declare a structure by the names of its parameters; it cannot be run.

    Raises:
        PlantError: a structure of the plant's file has that name.
    """
    plant.adopt(structure, Structure(free=(), watched=False, elsewhere=_Absent(plant, structure, names)))


class _Absent:
    """The source of such a structure."""

    def __init__(self, plant: type[Plant], structure: str, names: Sequence[str]) -> None:
        self.lost = f"{structure} is not loaded in this process; load its FMU with --allow-fmu"
        self.states: Mapping[str, State] = {}
        self.parameters: Mapping[str, Parameter] = {
            name: Parameter(default=0.0, bounds=_ANYTHING, text=name)
            for name in names
            if name not in plant.parameters
        }
        self.kernels: Any = _NoKernels(tuple(names), self.lost)


class _NoKernels:
    """Kernels with names only."""

    STATES: tuple[str, ...] = ()
    QUANTITIES: tuple[str, ...] = ()

    def __init__(self, names: tuple[str, ...], why: str) -> None:
        self.PARAMETERS = self.UNKNOWN = names
        self._why = why

    def __getattr__(self, name: str) -> NoReturn:
        if name.startswith("_"):
            raise AttributeError(name)
        raise StructureLostError(self._why)
