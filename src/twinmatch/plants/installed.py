"""Plants of other installed packages, which declare them as entry points of the group `twinmatch.plants`:

[project.entry-points."twinmatch.plants"]
tank = "my_package.tank:Tank"
"""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Final

from twinmatch.dynamics import Plant, PlantError

__all__ = ["GROUP", "installed_names", "installed_plant"]

GROUP: Final = "twinmatch.plants"


def installed_names() -> tuple[str, ...]:
    """Names of the plants that installed packages declare."""
    return tuple(_declared())


def installed_plant(name: str) -> type[Plant] | None:
    """The plant of this name; None if no package declares it.

    Raises:
        PlantError: the declared object is not a plant, or cannot be imported.
    """
    point = _declared().get(name)
    if point is None:
        return None
    package = point.dist.name if point.dist is not None else point.module
    try:
        plant = point.load()
    except Exception as error:
        msg = f"plant {name!r} of {package}: cannot be imported ({type(error).__name__}: {error})"
        raise PlantError(msg) from error
    if not (isinstance(plant, type) and issubclass(plant, Plant)):
        msg = f"plant {name!r} of {package}: {point.value} is not a Plant; declare the class"
        raise PlantError(msg)
    if plant.name != name:
        msg = f"plant {name!r} of {package}: its class is named {plant.name!r}; give both the same name"
        raise PlantError(msg)
    return plant


@lru_cache(maxsize=1)
def _declared() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}
