"""Storage of the code generated from a plant's equations: one Python module per plant and set of parts.

The module consists of `kernels.py`, `runs.py` and so on, with the plant's functions in place of `derived.py`.
Its name carries a hash of everything it is generated from: the sources of plant and generator, and the
versions of the libraries involved. So any change gives a new module, and an outdated one is never run. The
folder is `$TWINMATCH_CACHE`, or `twinmatch` in the user's cache folder; numba keeps its machine code there,
too.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.metadata
import importlib.util
import inspect
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from twinmatch.dynamics.code import derived_source
from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.definition import PlantDefinition
from twinmatch.dynamics.equations import derive

__all__ = ["cache_folder", "kernels_of", "source_hash"]

_HERE = Path(__file__).parent
_TEMPLATES = ("kernels.py", "runs.py", "filters.py")
_GENERATOR = (
    "code.py",
    "declarations.py",
    "definition.py",
    "equations.py",
    "store.py",
    "terms.py",
    *_TEMPLATES,
)
_JOINED = ("__future__", "twinmatch.dynamics.derived", "twinmatch.dynamics.kernels")
_PROGRAMS = ("numba", "numpy", "sympy")


def cache_folder() -> Path:
    """Where generated modules are kept."""
    given = os.environ.get("TWINMATCH_CACHE")
    if given:
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "twinmatch"


def kernels_of(plant: type[PlantDefinition], parts: frozenset[str], unknown: frozenset[str]) -> Any:
    """The compiled kernels of a plant with some of its parts, with tangents for the parameters `unknown`.

    They are generated if they are not there yet.

    Raises:
        PlantError: the equations cannot be used, or the cache folder cannot be written.
    """
    key = (plant, parts, unknown)
    if key not in _LOADED:
        _LOADED[key] = _module_for(plant, parts, unknown)
    return _LOADED[key]


_LOADED: dict[tuple[type[PlantDefinition], frozenset[str], frozenset[str]], ModuleType] = {}


def _module_for(plant: type[PlantDefinition], parts: frozenset[str], unknown: frozenset[str]) -> ModuleType:
    name = f"{plant.name}_{_fingerprint(plant, parts, unknown)}"
    path = cache_folder() / f"{name}.py"
    if not path.exists():
        what = f"{plant.title}, {', '.join(sorted(parts))}" if parts else plant.title
        print(f"twinmatch: preparing the equations of: {what} (some seconds, once)", file=sys.stderr)
        _write_atomically(path, _module_text(plant, parts, unknown))
    return _load(f"twinmatch_plants_{name}", path)


def _module_text(plant: type[PlantDefinition], parts: frozenset[str], unknown: frozenset[str]) -> str:
    derived = derive(plant(), parts, unknown)
    known = {
        "STATES": derived.states,
        "PARAMETERS": derived.parameters,
        "UNKNOWN": derived.unknown,
        "QUANTITIES": derived.quantities,
    }
    names = "".join(f"{name} = {tuple(map(str, what))}\n" for name, what in known.items())
    head = (
        f'"""Generated from the equations of {plant.name}; generated again when they change."""\n\n'
        "import math\n\nfrom twinmatch.compiled import compiled\n\n"
    )
    body = "\n".join([names, derived_source(derived), *map(_template, _TEMPLATES)])
    return "from __future__ import annotations\n\n" + head + body + "\n"


def _template(file: str) -> str:
    """The text of one of the files, without imports from files that become part of the same module."""
    text = (_HERE / file).read_text(encoding="utf-8")
    lines = text.splitlines()
    for node in reversed(ast.parse(text).body):
        if isinstance(node, ast.ImportFrom) and node.module in _JOINED:
            del lines[node.lineno - 1 : node.end_lineno]
    return "\n".join(lines)


def _write_atomically(path: Path, text: str) -> None:
    """Write a file atomically: several processes may write it at the same time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, draft = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            Path(draft).replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(draft).unlink()
            raise
    except OSError as error:
        msg = (
            f"{path.parent}: cannot keep the prepared equations there: {error.strerror}; "
            "set TWINMATCH_CACHE to a writable folder"
        )
        raise PlantError(msg) from error


def _load(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise PlantError(f"{path}: is not a Python module; remove it")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # numba looks its functions' module up there
    spec.loader.exec_module(module)
    return module


def _fingerprint(plant: type[PlantDefinition], parts: frozenset[str], unknown: frozenset[str]) -> str:
    what = (sys.version_info[:2], plant.__qualname__, sorted(parts), sorted(unknown))
    digest = hashlib.sha256(repr(what).encode())
    for file in (_HERE / name for name in _GENERATOR):
        digest.update(file.read_bytes())
    for program in _PROGRAMS:
        digest.update(importlib.metadata.version(program).encode())
    for file in sorted(_sources(plant)):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def source_hash(plant: type[PlantDefinition]) -> str:
    """A hash of the files that define the plant."""
    digest = hashlib.sha256()
    for file in sorted(_sources(plant)):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _sources(plant: type[PlantDefinition]) -> set[Path]:
    """The files of the class and its bases, and the files beside them that their modules import from."""
    waiting = [sys.modules.get(base.__module__) for base in plant.__mro__ if base is not object]
    found: set[Path] = set()
    while waiting:
        module = waiting.pop()
        file = getattr(module, "__file__", None)
        if module is None or file is None or Path(file) in found:
            continue
        path = Path(file)
        if path.parent == _HERE:
            continue
        found.add(path)
        for value in vars(module).values():
            other = (
                value if inspect.ismodule(value) else sys.modules.get(getattr(value, "__module__", "") or "")
            )
            beside = getattr(other, "__file__", None)
            if beside is not None and Path(beside).parent == path.parent:
                waiting.append(other)
    return found
