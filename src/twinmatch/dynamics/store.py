"""Storage of the machine code made from a plant's equations: one file per plant and set of parts.

Its name carries a hash of everything it is made from: the sources of plant and compiler, the versions of the
libraries involved, and the processor. So any change gives a new file, and an outdated one is never run. A
second file has the derived equations in its name instead of the plant's sources: a change of a default, a
bound or a comment takes that one, and nothing is compiled.

A wheel may bring such files of the plants that come with twinmatch, for a common kind of processor.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import inspect
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twinmatch.compiled import told
from twinmatch.dynamics import filters, kernels, runs
from twinmatch.dynamics.code import plant_formulas
from twinmatch.dynamics.declarations import PlantError
from twinmatch.dynamics.definition import PlantDefinition
from twinmatch.dynamics.equations import Derived, derive
from twinmatch.dynamics.machine import FUNCTIONS, compiled_object, linked, target
from twinmatch.kept import cache_folder

_HERE = Path(__file__).parent
_COMPILER = (
    "code.py",
    "declarations.py",
    "definition.py",
    "equations.py",
    "machine.py",
    "store.py",
    "terms.py",
    "../optimiser.py",
)
_PROGRAMS = ("llvmlite", "sympy")
SHIPPED: Final = _HERE.parent / "machine_code"
"""The folder that wheels of `make dist` bring; a checkout has none."""


KERNELS: Final = (
    kernels.advance,
    kernels.advance_side_by_side,
    kernels.begin,
    kernels.outputs_at,
    kernels.parts,
    kernels.slopes_at,
    kernels.step_count,
    runs.run,
    runs.run_with_tangents,
    runs.search,
    runs.start_at,
    filters.correct,
    filters.predict,
    filters.track,
)


class Kernels:
    """The kernels, called with one plant's code; names of its quantities, and a digest of its equations."""

    RATE_LIMIT = kernels.RATE_LIMIT
    MAX_STEPS = kernels.MAX_STEPS

    def __init__(
        self,
        machine_code: bytes,
        names: Mapping[str, Sequence[str]],
        sizes: Mapping[str, int],
        equations: str,
    ) -> None:
        self._owner, addresses = linked(machine_code)
        self.EQUATIONS = equations
        self.STATES, self.PARAMETERS, self.UNKNOWN, self.QUANTITIES = (
            tuple(names[kind])
            for kind in ("states", "parameters", "unknown", "quantities")
        )
        numbers = {
            **addresses,
            **sizes,
            **{f"n_{kind}": len(listed) for kind, listed in names.items()},
        }
        self.code = np.array(
            [numbers[name] for name in (*FUNCTIONS, *kernels.SIZES)], dtype=np.int64
        )
        for kernel in KERNELS:
            setattr(self, kernel.__name__, functools.partial(kernel, self.code))

    def call(self, kernel: Any, *arguments: Any) -> Any:
        """The results of another kernel for this plant."""
        return kernel(self.code, *arguments)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def kernels_of(
    plant: type[PlantDefinition], parts: frozenset[str], unknown: frozenset[str]
) -> Kernels:
    """The kernels of a plant with some of its parts, with tangents for the parameters `unknown`.

    Its equations are compiled if they are not there yet.

    Raises:
        PlantError: the equations cannot be used, or the cache folder cannot be written.
    """
    key = (plant, parts, unknown)
    if key not in _LOADED:
        file_name = f"{plant.name}_{_fingerprint(plant, parts, unknown)}.code"
        path = cache_folder() / file_name
        content = _whole(SHIPPED / file_name) or _whole(path)
        if content is None:
            content = _code_of_equations(plant.name, derive(plant(), parts, unknown))
            _write_atomically(path, content)
        head, _, machine_code = content.partition(b"\n")
        _LOADED[key] = Kernels(machine_code, **json.loads(head))
    return _LOADED[key]


_LOADED: dict[
    tuple[type[PlantDefinition], frozenset[str], frozenset[str]], Kernels
] = {}


def _whole(path: Path) -> bytes | None:
    """The content of a file, or None if there is none or it is damaged: damaged machine code must not run."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return (
        content[32:] if hashlib.sha256(content[32:]).digest() == content[:32] else None
    )


def _code_of_equations(plant: str, derived: Derived) -> bytes:
    """A line with all names and sizes, and the machine code; kept for all plants with these equations."""
    path = cache_folder() / f"equations_{_fingerprint_of_equations(derived)}.code"
    content = _whole(path)
    if content is None:
        for tell in told:
            tell(f"the equations of {plant}")
        content = _compile(derived)
        _write_atomically(path, content)
    return content


def _compile(derived: Derived) -> bytes:
    """The content of such a file."""
    formulas = plant_formulas(derived)
    symbols_by_kind = {
        "states": derived.states,
        "parameters": derived.parameters,
        "unknown": derived.unknown,
        "quantities": derived.quantities,
    }
    names = {
        kind: [str(symbol) for symbol in symbols]
        for kind, symbols in symbols_by_kind.items()
    }
    sizes = {
        "n_inputs": formulas.n_inputs,
        "n_outputs": formulas.n_outputs,
        "n_constants": len(formulas.constants.results),
        "n_switches": len(formulas.switches.results),
    }
    head = json.dumps({"names": names, "sizes": sizes, "equations": digest_of(derived)})
    return head.encode() + b"\n" + compiled_object(formulas)


def digest_of(derived: Derived) -> str:
    """A hash of the equations as formulas: unlike `source_hash`, it ignores comments, bounds and defaults."""
    formulas = ("conditions", "rates", "outputs", "start")
    signals = ("states", "inputs", "disturbances", "measured")
    written = {
        name: list(map(str, getattr(derived, name))) for name in (*signals, *formulas)
    }
    return hashlib.sha256(json.dumps(written).encode()).hexdigest()[:16]


def _write_atomically(path: Path, content: bytes) -> None:
    """Write content after its hash, atomically: several processes may write the file at the same time."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, draft = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(content).digest() + content)
            Path(draft).replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(draft).unlink()
            raise
    except OSError as error:
        raise PlantError(
            f"{path.parent}: cannot keep the compiled equations there: {error.strerror}; "
            "set TWINMATCH_CACHE to a writable folder"
        ) from error


def _fingerprint(
    plant: type[PlantDefinition], parts: frozenset[str], unknown: frozenset[str]
) -> str:
    """A hash of all that the code of a plant is made from: its sources as they are in its files."""
    chosen = (plant.__qualname__, sorted(parts), sorted(unknown))
    digest = _digest_with_compiler(repr(chosen))
    for file in sorted(_sources(plant)):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _fingerprint_of_equations(derived: Derived) -> str:
    """The same, of a plant whose equations are derived, with every digit of their numbers."""
    import sympy  # noqa: PLC0415

    quantities = tuple(derived.quantities.items())  # their order counts
    in_order = {**vars(derived), "quantities": quantities}
    parts = [f"{name} {sympy.srepr(value)}" for name, value in in_order.items()]
    return _digest_with_compiler("\n".join(parts)).hexdigest()[:16]


def _digest_with_compiler(equations: str) -> hashlib._Hash:
    """A hash of equations, however they are written, and of what compiles them."""
    digest = _compiler().copy()
    digest.update(equations.encode())
    return digest


@functools.cache
def _compiler() -> hashlib._Hash:
    """A hash of the compiler, its libraries and the processor."""
    digest = hashlib.sha256(repr((sys.version_info[:2], target())).encode())
    for file in (_HERE / name for name in _COMPILER):
        digest.update(file.read_bytes())
    for program in _PROGRAMS:
        digest.update(importlib.metadata.version(program).encode())
    return digest


def source_hash(plant: type[PlantDefinition]) -> str:
    """A hash of the files that define the plant."""
    digest = hashlib.sha256()
    for file in sorted(_sources(plant)):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _sources(plant: type[PlantDefinition]) -> set[Path]:
    """The files of the class and its bases, and the files beside them that their modules import from."""
    waiting = [
        sys.modules.get(base.__module__) for base in plant.__mro__ if base is not object
    ]
    sources: set[Path] = set()
    while waiting:
        module = waiting.pop()
        file = getattr(module, "__file__", None)
        if module is None or file is None or Path(file) in sources:
            continue
        path = Path(file)
        if path.parent == _HERE:
            continue
        sources.add(path)
        for value in vars(module).values():
            imported = value
            if not inspect.ismodule(value):
                imported = sys.modules.get(getattr(value, "__module__", "") or "")
            imported_file = getattr(imported, "__file__", None)
            if imported_file is not None and Path(imported_file).parent == path.parent:
                waiting.append(imported)
    return sources
