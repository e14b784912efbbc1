"""Plants of other people: in installed packages, and in files named by the user.

Packages declare theirs as entry points of the group `twinmatch.plants`:

[project.entry-points."twinmatch.plants"]
tank = "my_package.tank:Tank"

A plant in a file is loaded, found again by name, and sent to other processes: its class is pickled as the
path of the file, because other processes cannot import its module by name.
"""

from __future__ import annotations

import copyreg
import hashlib
import importlib.util
import sys
import traceback
from functools import lru_cache
from importlib.machinery import SourceFileLoader
from importlib.metadata import EntryPoint, entry_points
from itertools import chain
from operator import attrgetter
from pathlib import Path
from types import CodeType, ModuleType
from typing import Final, NamedTuple

from twinmatch.dynamics import Law, Plant, PlantError, channel
from twinmatch.dynamics.definition import PlantType
from twinmatch.dynamics.equations import (
    PATIENCE,
    TooLongError,
    at_most,
    error_words,
    is_interrupt,
)

GROUP: Final = "twinmatch.plants"
MODULE_PREFIX: Final = "twinmatch_plant_file_"
"""Prefix of the names of modules loaded from a path."""


class PlantFilesLoaded(NamedTuple):
    """The plant files that this process has run."""

    by_file: dict[Path, type[Plant]]
    """The plant in each."""
    by_name: dict[str, type[Plant]]
    """The plants by their names, which are unique."""
    written: dict[str, str]
    """The path as the user wrote it, by name of the plant."""


LOADED: Final = PlantFilesLoaded({}, {}, {})


def installed_names() -> tuple[str, ...]:
    """Names of the plants that installed packages declare."""
    return tuple(declared_plants())


def installed_plant(name: str) -> type[Plant] | None:
    """The plant of this name; None if no package declares it.

    Raises:
        PlantError: the declared object is not a plant, or cannot be imported.
    """
    point = declared_plants().get(name)
    if point is None:
        return None
    package = point.dist.name if point.dist is not None else point.module
    try:
        plant = point.load()
    except BaseException as error:
        if is_interrupt(error):
            raise
        msg = f"plant {name!r} of {package}: cannot be imported ({error_words(error)})"
        raise PlantError(msg) from error
    if not (isinstance(plant, type) and issubclass(plant, Plant)):
        raise PlantError(
            f"plant {name!r} of {package}: {point.value} is not a Plant; declare the class"
        )
    if plant.name != name:
        msg = f"plant {name!r} of {package}: its class is named {plant.name!r}; give both the same name"
        raise PlantError(msg)
    return plant


@lru_cache(maxsize=1)
def declared_plants() -> dict[str, EntryPoint]:
    """The plants that installed packages declare, by name; looked up once in a process."""
    return {point.name: point for point in entry_points(group=GROUP)}


def is_plant_file(name: str) -> bool:
    """Whether this is the name of a file, not of a plant."""
    return name.endswith(".py") or "/" in name or "\\" in name


def load_plant(name: str) -> type[Plant]:
    """The plant in a file; the file is run, once in a process.

    Raises:
        PlantError: no such file, a mistake in it, no plant or several, or a plant with the name of another
        file's.
    """
    path = Path(name).expanduser().resolve()
    if path in LOADED.by_file:
        return LOADED.by_file[path]
    if not path.is_file():
        raise PlantError(
            f"{name}: there is no such file (looked for {path}); give the file with the plant"
        )
    if path.suffix != ".py":
        raise PlantError(f"{name}: is not a Python file; give one that ends in .py")
    plant = _plant_in(_run(path, name), name)
    other_file = LOADED.written.get(plant.name)
    if other_file is not None:
        raise PlantError(
            f"{name}: its plant is called {plant.name}, like that of {other_file}; give one of them another "
            "name"
        )
    LOADED.by_file[path] = LOADED.by_name[plant.name] = plant
    LOADED.written[plant.name] = name
    return plant


def load_law(name: str) -> Law:
    """The law that a file calls `loop`, as a plant does in its class; the file is run.

    Raises:
        PlantError: no such file, a mistake in it, or no such law.
    """
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        raise PlantError(
            f"{name}: there is no such file (looked for {path}); give the file with the law"
        )
    law = getattr(_run(path, name), "loop", None)
    if not isinstance(law, Law):
        raise PlantError(f"{name}: has no law; write one such as loop = PidGains(…)")
    return law


def loaded(name: str) -> type[Plant] | None:
    """The plant of this name loaded from a file; also found by the file's name, in any folder."""
    if name in LOADED.by_name:
        return LOADED.by_name[name]
    if is_plant_file(name):
        file = name.replace("\\", "/").rpartition("/")[2]
        return next(
            (plant for path, plant in LOADED.by_file.items() if path.name == file), None
        )
    return None


def source_of(plant: type[Plant]) -> str:
    """The file of a plant, as the user wrote it; empty if it was imported."""
    return LOADED.written[plant.name] if LOADED.by_name.get(plant.name) is plant else ""


class _FromSource(SourceFileLoader):
    """Python takes the bytecode it has kept for the file's if second and size are the same: an edit may be
    missed, so none is kept of plant files."""

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        return self.source_to_code(self.get_data(self.path), self.path)


def _run(path: Path, name: str) -> ModuleType:
    """Import the module in a file."""
    module_name = MODULE_PREFIX + hashlib.sha256(str(path).encode()).hexdigest()[:16]
    loader = _FromSource(module_name, str(path))
    spec = importlib.util.spec_from_file_location(module_name, path, loader=loader)
    if spec is None or spec.loader is None:
        raise PlantError(f"{name}: is not a Python module; give a file of Python code")
    module = importlib.util.module_from_spec(spec)
    # the generator looks up the source of the equations there
    sys.modules[spec.name] = module
    beside = str(path.parent)
    # a plant may import tables and functions from files beside it
    sys.path.append(beside)
    try:
        with at_most():
            spec.loader.exec_module(module)
    except BaseException as error:
        del sys.modules[spec.name]
        if is_interrupt(error):
            raise
        raise PlantError(f"{_place(name, path, error)}: {_words(error)}") from error
    finally:
        sys.path.remove(beside)
    return module


def _plant_in(module: ModuleType, name: str) -> type[Plant]:
    plants = set()
    for value in vars(module).values():
        if (
            isinstance(value, type)
            and issubclass(value, Plant)
            and value.__module__ == module.__name__
        ):
            plants.add(value)
    bases = set(chain.from_iterable(plant.__mro__[1:] for plant in plants))
    last = sorted(plants - bases, key=attrgetter("__name__"))
    if not last:
        raise PlantError(
            f"{name}: has no plant; write a class such as class Tank(Plant): …"
        )
    if len(last) > 1:
        names = ", ".join(plant.__name__ for plant in last)
        raise PlantError(
            f"{name}: has {len(last)} plants, {names}; give each its own file"
        )
    return last[0]


def _place(name: str, path: Path, error: BaseException) -> str:
    """File and line of a mistake."""
    if isinstance(error, SyntaxError) and error.lineno is not None:
        return f"{name}, line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    line = next(
        (frame.lineno for frame in reversed(frames) if frame.filename == str(path)),
        None,
    )
    return name if line is None else f"{name}, line {line}"


def _words(error: BaseException) -> str:
    if isinstance(error, PlantError):
        return str(error)
    if isinstance(error, SyntaxError):
        return f"invalid Python: {error.msg}"
    if isinstance(error, SystemExit):
        return "the file exits Python; remove that call"
    if isinstance(error, TooLongError):
        return f"the file was not loaded within {PATIENCE:g} s; look for a loop without end"
    return error_words(error)


def _reduced(plant: type[Plant]) -> str | tuple[object, ...]:
    """Pickle a plant by the path of its file, or, like any class, by its name."""
    if plant.channel_of is not None:
        return channel, plant.channel_of
    if plant.__module__.startswith(MODULE_PREFIX):
        path = next(
            (
                path
                for path, loaded_plant in LOADED.by_file.items()
                if loaded_plant is plant
            ),
            None,
        )
        if path is not None:
            return load_plant, (str(path),)
    return plant.__qualname__


copyreg.pickle(PlantType, _reduced)  # type: ignore[arg-type] # typeshed has no string among its answers
