"""Plants, each declared in its own file.

`find_plant` finds the plants of this package, those of other installed packages (entry points of the group
`twinmatch.plants`), and those in a file, by its path.
"""

from __future__ import annotations

from typing import Final

from twinmatch.dynamics import Plant, PlantError
from twinmatch.plants.files import (
    installed_names,
    installed_plant,
    is_plant_file,
    load_plant,
    loaded,
    source_of,
)
from twinmatch.plants.incubator import Incubator
from twinmatch.plants.peltier import Peltier
from twinmatch.plants.tclab import TCLab, TCLabBoth

__all__ = [
    "PLANTS",
    "Incubator",
    "Peltier",
    "TCLab",
    "TCLabBoth",
    "UnknownPlantError",
    "find_plant",
    "plant_named",
    "written_name",
]

PLANTS: Final[dict[str, type[Plant]]] = {
    plant.name: plant for plant in (Peltier, TCLab, TCLabBoth, Incubator)
}
"""The plants that come with this package, by name."""


class UnknownPlantError(PlantError):
    """This process has no plant of that name; another process may have loaded its file."""


def find_plant(name: str) -> type[Plant]:
    """The plant of this name, or the one in this file.

    A file is code that is run. So for names from a recording or from the network, use `plant_named`.

    Raises:
        PlantError: there is none, or its file cannot be used.
    """
    if is_plant_file(name):
        plant = load_plant(name)
        if plant.name in PLANTS:
            raise PlantError(
                f"{name}: its plant is called {plant.name}, like one that comes with twinmatch; give it "
                f"another name, such as class {plant.__name__}(Plant, name='my_{plant.name}')"
            )
        return plant
    return plant_named(name)


def plant_named(name: str) -> type[Plant]:
    """The plant of this name from a recording or message: one that is installed, or from a file that was
    loaded because the user named it. This function never loads a file.

    Raises:
        UnknownPlantError: there is none.
    """
    if name in PLANTS:
        return PLANTS[name]
    plant = loaded(name) or installed_plant(name)
    if plant is not None:
        return plant
    if is_plant_file(name):
        msg = f"the plant is in a file, {name}; files are run only if you name them: add --plant {name}"
        raise UnknownPlantError(msg)
    names = ", ".join(dict.fromkeys([*PLANTS, *installed_names()]))
    raise UnknownPlantError(
        f"plant {name!r}: not known; choose from {names}. One in a file is named by its path: --plant "
        f"{name}.py, or plant: {name}.py in a configuration"
    )


def written_name(plant: type[Plant]) -> str:
    """The name of a plant in settings, with which `find_plant` finds it again: its name, or its file."""
    return source_of(plant) or plant.name
