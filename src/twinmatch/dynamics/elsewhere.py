"""Where a structure comes from whose equations are not in the plant's file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from twinmatch.dynamics.declarations import Parameter, State

__all__ = ["Elsewhere"]


class Elsewhere(Protocol):
    """What stands behind a structure whose equations somebody else wrote, in another language perhaps.

    The plant's output, drive and disturbances are those of its file. States and parameters may be the plant's
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
        """The functions and names that a module of compiled kernels has, but for those that track changes.

        They raise `StructureLostError` once there is nothing behind them any more.
        """

    @property
    def lost(self) -> str:
        """Why it cannot be run any more, in a sentence; empty while it can."""
