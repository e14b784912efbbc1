"""Check that the FMUs that a session was judged with are available.

A session only names its FMUs; the user of verify provides them. The names of such structures contain a hash
of FMU and map, so that another FMU of the same name is not mistaken for the original.
"""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.fmu import is_fmu, unmarked

__all__ = ["ForeignError", "check_fmus"]


class ForeignError(TwinmatchError):
    """The FMUs that a session was judged with are missing, or there are others."""


def check_fmus(name: str, plant: type[Plant], recorded: Sequence[str]) -> None:
    """Compare the FMUs among the recorded structures with those of the plant now.

    Raises:
        ForeignError: they differ.
    """
    able = [name for name, held in plant.structures.items() if held.external and not held.external.lost]
    then, now = ([s for s in those if is_fmu(s)] for those in (recorded, able))
    missing, more = [s for s in then if s not in now], [s for s in now if s not in then]
    if missing:
        other = [s for s in more if unmarked(s) == unmarked(missing[0])]
        what = f"; the one given, {other[0]!r}, is another FMU or has another map" if other else ""
        msg = (
            f"session {name}: was judged with the structure {missing[0]!r}, an FMU{what}; give that FMU's "
            "map file with --allow-fmu FILE"
        )
        raise ForeignError(msg)
    if more:
        msg = f"session {name}: was judged without the FMU {more[0]!r}; leave out --allow-fmu"
        raise ForeignError(msg)
