"""Whether a session can be judged again with the FMUs that it was judged with.

A session names its FMUs, but that runs no program: who verifies it gives them. The names of such structures
carry a mark of FMU and map, so that another FMU of the same name is not taken for the one that was there.
"""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.fmu import is_fmu, unmarked

__all__ = ["ForeignError", "check_fmus"]


class ForeignError(TwinmatchError):
    """The FMUs that a session was judged with are not there, or there are others."""


def check_fmus(name: str, plant: type[Plant], recorded: Sequence[str]) -> None:
    """Compare the FMUs among the structures that a session was judged with and those of its plant now.

    Raises:
        ForeignError: they are not the same.
    """
    able = [name for name, held in plant.structures.items() if held.elsewhere and not held.elsewhere.lost]
    then, now = ([s for s in those if is_fmu(s)] for those in (recorded, able))
    missing, more = [s for s in then if s not in now], [s for s in now if s not in then]
    if missing:
        other = [s for s in more if unmarked(s) == unmarked(missing[0])]
        what = f"; the one given is {other[0]!r}, another FMU or another map" if other else ""
        msg = (
            f"session {name}: was judged with the structure {missing[0]!r}, an FMU{what}; give the one it "
            "was, with --allow-fmu FILE, the file that makes it a structure of the plant"
        )
        raise ForeignError(msg)
    if more:
        msg = f"session {name}: was judged without the FMU {more[0]!r}; leave out --allow-fmu"
        raise ForeignError(msg)
