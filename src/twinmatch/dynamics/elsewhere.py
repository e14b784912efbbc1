"""Interface of structures whose equations are not in the plant's file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from twinmatch.dynamics.declarations import Parameter, State

__all__ = ["Elsewhere"]


class Elsewhere(Protocol):
    """Source of a structure whose equations are external, possibly in another language.

    Output, drive and disturbances are those of the plant's file. States and parameters may be the plant's,
    too, or be declared here.
    """

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Parameters that only this structure has, by name."""

    @property
    def states(self) -> Mapping[str, State]:
        """States that only this structure has, by name."""

    @property
    def kernels(self) -> Any:
        """The functions and names of a module of compiled kernels, except those that track changes.

        They raise `StructureLostError` once the external equations are gone.
        """

    @property
    def lost(self) -> str:
        """Why it can no longer be run, in a sentence; empty while it can."""
