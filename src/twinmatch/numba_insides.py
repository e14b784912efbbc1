"""All that twinmatch uses of numba beyond what numba documents.

Nothing else imports from `numba.core`, or uses an attribute of numba's that begins with `_`. What is used is listed in
`tests/test_numba_insides.py`, which says where another version of numba differs. A version that was not tried is
refused before anything here could go wrong with it.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import pickle
import sys
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any, Final

import llvmlite.binding
import numba
from numba import types

from twinmatch.errors import TwinmatchError
from twinmatch.optimiser import optimise, simplify_functions
from twinmatch.reference_counts import COUNTING, counting_module

OLDEST: Final = (0, 60)
NEWEST: Final = (0, 68)
"""The versions of numba whose insides are as used here; pyproject.toml agrees."""


class NumbaError(TwinmatchError):
    """The installed numba cannot be used."""


def check_version(version: str) -> None:
    """Refuse a numba that is older or newer than those tried: its insides may have another meaning.

    Raises:
        NumbaError: it is.
    """
    oldest, newest = (".".join(map(str, tried)) for tried in (OLDEST, NEWEST))
    major, minor = (int(number) for number in version.split(".")[:2])
    if not OLDEST <= (major, minor) <= NEWEST:
        raise NumbaError(
            f"numba {version} is not among the versions that this twinmatch was tried with, {oldest} to "
            f"{newest}; install `numba=={newest}.*`, or another twinmatch"
        )


check_version(numba.__version__)

# below the check: another version may lack them
from numba.core.bytecode import FunctionIdentity  # noqa: E402
from numba.core.caching import (  # noqa: E402
    CompileResultCacheImpl,
    FunctionCache,
)
from numba.core.codegen import JITCodeLibrary  # noqa: E402
from numba.core.environment import Environment, lookup_environment  # noqa: E402
from numba.core.registry import cpu_target  # noqa: E402
from numba.core.runtime import rtsys  # noqa: E402


def start_runtime() -> None:
    """Do what the first kernel of a process does, which takes longer than to load it."""
    rtsys.initialize(cpu_target.target_context)


def number_functions_from(first: int) -> None:
    """Give the functions that are compiled from now on these numbers, which are a part of their names."""
    FunctionIdentity._unique_ids = itertools.count(first)


def make_part(kernel: Any) -> None:
    """Have a kernel compiled for other kernels only, and once for all values of an argument.

    numba would compile another one for each constant truth value.
    """
    compile_ = kernel._compiler.compile
    template = kernel.get_call_template

    def compiled_as_written(*arguments: Any) -> Any:
        with _as_written():
            return compile_(*arguments)

    def template_of_kinds(arguments: Any, keywords: Any) -> Any:
        kinds = {name: types.unliteral(kind) for name, kind in keywords.items()}
        return template(tuple(map(types.unliteral, arguments)), kinds)

    kernel._compiler.compile = compiled_as_written
    kernel.get_call_template = template_of_kinds


def make_entry(
    kernel: Any, part: Any, compile_: Callable[[Any, Any], Any], cache: Any
) -> None:
    """Have a kernel compiled by a function of its arguments' types and of its result's, and kept in a cache.

    Other kernels that call it take the part in its place.
    """
    kernel._compiler.compile = compile_
    kernel.get_call_template = part.get_call_template
    kernel.get_overload = part.get_overload
    kernel._cache = cache


@contextlib.contextmanager
def _as_written() -> Iterator[None]:
    codegen = cpu_target.target_context.codegen()
    before = codegen._library_class, codegen.set_env
    codegen._library_class = _Part
    codegen.set_env = lambda *_: None
    try:
        yield
    finally:
        codegen._library_class, codegen.set_env = before


class _Part(JITCodeLibrary):
    """Code to be linked into kernels, as it was written.

    numba optimises and translates every function together with all that it calls, so at each level of calls
    everything below once more: four fifths of its time.
    """

    def _optimize_functions(self, module: Any) -> None:
        simplify_functions(module)

    def _optimize_final_module(self) -> None:
        """The kernels that this is linked into are optimised."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        self._ensure_finalized()
        return 0


class _EntryPoint(JITCodeLibrary):
    """An entry point from Python with all that it calls, which counts references to arrays by itself."""

    def _optimize_final_module(self) -> None:
        counting = llvmlite.binding.parse_assembly(str(counting_module()))
        self._final_module.link_in(counting)
        for name in COUNTING:
            # kernels of others continue to use those of numba
            self._final_module.get_function(name).linkage = "internal"
        optimise(self._final_module)


def entry_point(part: Any, *, addressed: bool) -> Any:
    """A compiled part with all that it calls, optimised once, with an entry from Python.

    Args:
        part: what compiling it has given.
        addressed: it has an entry for C, too.
    """
    context = part.target_context
    library = _EntryPoint(context.codegen(), part.fndesc.qualname)
    library.enable_object_caching()
    library._shared_module = llvmlite.binding.parse_assembly("")  # kernels link parts
    library.add_linking_library(part.library)
    wrapped = library, part.fndesc, part.environment, part.call_helper
    context.create_cpython_wrapper(*wrapped, release_gil=True)
    if addressed:
        context.create_cfunc_wrapper(*wrapped)
    entry = context.get_executable(library, part.fndesc, part.environment)
    result = part._replace(library=library, entry_point=entry, metadata={})
    for inner in result._find_referenced_environments():
        library.codegen.set_env(inner.env_name, inner)
    return result


class _KernelFiles(CompileResultCacheImpl):
    def __init__(self, function: FunctionType, stamp: Callable[[], str]) -> None:
        super().__init__(function)
        self._locator: Any = _Stamped(super().locator, stamp)

    def reduce(self, result: Any) -> tuple[Any, ...]:
        """As numba's, but without references to the modules of the functions inside a kernel."""
        *whole, inner = super().reduce(result)
        return (
            *whole,
            [(env.globals["__name__"], env.consts, env.env_name) for env in inner],
        )

    def rebuild(self, target_context: Any, reduced: tuple[Any, ...]) -> Any:
        """The kernel, ready to be called: three times as fast as numba, which imports the modules of all
        functions inside and parses the intermediate code."""
        whole, described, *further, inner = reduced
        target_context.codegen()._engine._defined_symbols.add(
            described.llvm_cpython_wrapper_name
        )
        environments = [_environment(*arguments) for arguments in inner]
        return super().rebuild(
            target_context, (whole, described, *further, environments)
        )


def _environment(module: str, constants: list[Any], name: str) -> Environment:
    """The environment of a function inside a kernel."""
    environment = lookup_environment(name)
    if environment is None:
        names = (
            vars(sys.modules[module]) if module in sys.modules else {"__name__": module}
        )
        environment = Environment(names)
        environment.env_name = name
        Environment._memo[name] = environment
    if len(constants) > len(environment.consts):
        # an entry point adds those of its results
        environment.consts[:] = constants
    return environment


class _Stamped:
    """numba's cache location of a kernel, with another stamp."""

    def __init__(self, locator: Any, stamp: Callable[[], str]) -> None:
        self._locator = locator
        self.get_source_stamp = stamp

    def __getattr__(self, name: str) -> Any:
        return getattr(self._locator, name)


class KernelCache(FunctionCache):
    """numba's cache of a kernel on disk, under our stamp."""

    def __init__(
        self,
        function: FunctionType,
        stamp: Callable[[], str],
        fields: Callable[[Any], Iterator[tuple[str, ...]]],
    ) -> None:
        """Find the files.

        Args:
            function: that of the kernel.
            stamp: what the kernel is made from, as one hash.
            fields: the fields of all named tuples in a signature, which numba identifies by the class's name.

        Raises:
            RuntimeError: no folder can be written to, neither beside the source nor in the user's home.
        """
        self._impl_class = functools.partial(_KernelFiles, stamp=stamp)
        super().__init__(function)
        self._fields = fields
        self._read_index = self._cache_file._load_index
        self._cache_file._load_index = self._index

    def load(self, signature: Any, target_context: Any) -> Any:
        """A kept kernel, without numba's compiler, which it loads first: a fifth of a second; None if there is none."""
        rtsys.initialize(target_context)
        return self._load_overload(signature, target_context)

    def _index(self) -> dict[Any, Any]:
        """What is cached; nothing if the index names a class of arguments of another version."""
        try:
            index: dict[Any, Any] = self._read_index()
        except (AttributeError, ImportError, pickle.UnpicklingError):
            return {}
        return index

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        return (
            *super()._index_key(signature, codegen),
            tuple(self._fields(signature)),
        )
