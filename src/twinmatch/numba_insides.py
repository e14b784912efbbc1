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
from collections.abc import Callable, Iterable, Iterator
from types import FunctionType
from typing import Any, Final

import llvmlite.binding
import numba
from numba import types

from twinmatch.errors import TwinmatchError
from twinmatch.optimiser import optimise, simplify_functions
from twinmatch.reference_counts import COUNTING, counting_module

OLDEST: Final = (0, 61)
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
from numba.core.cpu import CPUContext  # noqa: E402
from numba.core.environment import _rebuild_env  # noqa: E402
from numba.core.registry import cpu_target  # noqa: E402
from numba.core.runtime import rtsys  # noqa: E402
from numba.core.runtime.context import NRTContext  # noqa: E402


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
    """Within the block, numba compiles parts. Its lock is held, so nobody else compiles in it."""
    codegen = cpu_target.target_context.codegen()
    replacements: tuple[tuple[Any, str, Any], ...] = (
        (codegen, "_library_class", _Part),
        (codegen, "set_env", lambda *_: None),
        # numba makes an entry for C of each of its own functions
        (CPUContext, "create_cfunc_wrapper", lambda *_: None),
        (types.Function, "get_call_type", _call_type),
        (NRTContext, "get_meminfos", _references),
    )
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in replacements]
    try:
        _set_all(replacements)
        yield
    finally:
        _set_all(before)


def _set_all(attributes: Iterable[tuple[Any, str, Any]]) -> None:
    """Set attributes, each given by its owner, its name and its value."""
    for owner, name, value in attributes:
        setattr(owner, name, value)


_find_call_type: Final = types.Function.get_call_type


def _call_type(function: Any, context: Any, arguments: Any, keywords: Any) -> Any:
    """The signature of one of numba's functions or operators for these arguments.

    numba tries all definitions of a function in turn, each time that it is called: ten of an addition. Parts make
    16 700 calls, of 550 kinds. A function with another definition more is another function here.
    """
    if keywords:
        return _find_call_type(function, context, arguments, keywords)
    return _call_type_of_kinds(function, context, arguments)


@functools.cache
def _call_type_of_kinds(function: Any, context: Any, kinds: tuple[Any, ...]) -> Any:
    return _find_call_type(function, context, kinds, {})


def _references(
    counter: Any, builder: Any, kind: Any, value: Any
) -> list[tuple[Any, Any]]:
    """The counted references that a value holds, with their types.

    numba takes all numbers out of a value to look for references in them, too: seven and more of each array, which is
    a fifth of the instructions of parts.
    """
    layouts = cpu_target.target_context.data_model_manager
    layout = layouts[kind]
    references = []
    if layout.has_nrt_meminfo():
        references.append((kind, layout.get_nrt_meminfo(builder, value)))
    for member_kind, member in layout.traverse(builder):
        if layouts[member_kind].contains_nrt_meminfo():
            references += _references(counter, builder, member_kind, member(value))
    return references


class _Part(JITCodeLibrary):
    """Code to be linked into kernels, as it was written, without what it calls.

    numba optimises and translates every function together with all that it calls, so at each level of calls
    everything below once more: four fifths of its time.
    """

    def _optimize_functions(self, module: Any) -> None:
        simplify_functions(module)

    def finalize(self) -> None:
        """Link nothing: the kernels that this is linked into link what it calls, too."""
        self._finalize_dynamic_globals()
        self._finalized = True

    def module(self) -> Any:
        """Its functions alone, to be linked."""
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:
        """Its functions with all that they call, for kernels of others."""
        module = self.module().clone()
        _, *called = _callers_first(self)
        _link_all(module, called)
        return module

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        self._ensure_finalized()
        return 0


def _callers_first(part: _Part) -> list[Any]:
    """The libraries of a part and of all functions that it calls, whether directly or not.

    LLVM links only those functions of a module that are called from what it has linked before.
    """
    return [*_callees_first(part, set())][::-1]


def _callees_first(library: Any, visited: set[Any]) -> Iterator[Any]:
    """A library, if it was not visited before, behind those of all functions that it calls."""
    if library in visited:
        return
    visited.add(library)
    # another library, such as numba's runtime, holds all that it calls
    if isinstance(library, _Part):
        for callee in library._linking_libraries:
            yield from _callees_first(callee, visited)
    yield library


def _link_all(module: Any, libraries: list[Any]) -> None:
    """Link libraries into a module, each once, which stay as they are."""
    for library in libraries:
        is_part = isinstance(library, _Part)
        linked = library.module() if is_part else library._get_module_for_linking()
        module.link_in(linked, preserve=True)


class _EntryPoint(JITCodeLibrary):
    """An entry point from Python with all that it calls, which counts references to arrays by itself."""

    def link(self, part: _Part) -> None:
        """Link a part with all that it calls, each function once."""
        _link_all(self._final_module, _callers_first(part))

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
    wrapped = library, part.fndesc, part.environment, part.call_helper
    context.create_cpython_wrapper(*wrapped, release_gil=True)
    if addressed:
        context.create_cfunc_wrapper(*wrapped)
    library.link(part.library)
    entry = context.get_executable(library, part.fndesc, part.environment)
    result = part._replace(library=library, entry_point=entry, metadata={})
    for inner in result._find_referenced_environments():
        library.codegen.set_env(inner.env_name, inner)
    return result


class _KernelFiles(CompileResultCacheImpl):
    def __init__(self, function: FunctionType, stamp: Callable[[], str]) -> None:
        super().__init__(function)
        self.locator.get_source_stamp = stamp

    def reduce(self, result: Any) -> tuple[Any, ...]:
        """As numba's, but without references to the modules of the functions inside a kernel."""
        *whole, inner = super().reduce(result)
        return *whole, [
            (environment.consts, environment.env_name) for environment in inner
        ]

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


def _environment(constants: list[Any], name: str) -> Any:
    """The environment of a function inside a kernel, whose module nothing asks for."""
    environment = _rebuild_env(__name__, constants, name)
    # an entry point adds those of its results
    environment.consts[:] = max(environment.consts, constants, key=len)
    return environment


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
        """What is kept; nothing if the index holds a class of arguments that is gone."""
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
