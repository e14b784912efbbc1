"""Compilation of numeric kernels, and their cache on disk, which is valid until their code changes.

numba caches compiled code under a stamp of the kernel's own source file: after a change of another file whose
functions or constants the kernel uses, numba alone would run outdated code. Here the stamp covers all of them
(`kernel_stamps`).

A module generated at run time is cached like any other if it is in `sys.modules` under its name.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import importlib.util
import itertools
import os
import pickle
import secrets
import sys
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any, Final, TypeVar, overload

import llvmlite.binding
import numba
from llvmlite import ir
from numba import types
from numba.core import event
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.environment import Environment, lookup_environment
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

from twinmatch.errors import TwinmatchError
from twinmatch.kernel_stamps import OPTIONS, fields_of, hash_of_file, stamp_of
from twinmatch.kernel_turns import KernelTurn
from twinmatch.processor import COMMON, processor

_NEWEST: Final = (0, 68)
"""The newest numba whose insides are as used here (tests/test_compiled.py); pyproject.toml agrees."""


class NumbaError(TwinmatchError):
    """The installed numba is too new."""


def check_version(version: str) -> None:
    """Refuse a numba that is newer than those tried; its insides may have changed their meaning.

    Raises:
        NumbaError: it is.
    """
    major, minor = (int(number) for number in version.split(".")[:2])
    if (major, minor) > _NEWEST:
        newest = ".".join(map(str, _NEWEST))
        raise NumbaError(
            f"numba {version} is newer than this twinmatch, which was tried with {newest} and older; install "
            f"`numba=={newest}.*`, or a newer twinmatch"
        )


check_version(numba.__version__)


def _choose_processor() -> None:
    """Have numba compile for a common kind of processor, unless its settings name one.

    numba keeps what it has compiled under the processor's name, so code that came with a wheel is found.
    """
    is_chosen = numba.config.CPU_NAME is not None
    if not is_chosen and processor().name == COMMON:
        numba.config.CPU_NAME, numba.config.CPU_FEATURES = processor()


_choose_processor()


def start_runtime() -> None:
    """Do what the first kernel of a process does, which takes longer than to load it."""
    rtsys.initialize(cpu_target.target_context)


def _number_apart() -> None:
    """Start numba's numbers of compiled functions somewhere else than in any other process.

    It starts from one in every process, so kernels cached by two processes could have the same name. If such
    a kernel is loaded twice, alone and inside another, one uses the other's data and fails
    ("'descr' is NULL").
    """
    FunctionIdentity._unique_ids = itertools.count(secrets.randbits(48))


_number_apart()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_number_apart)


def _load_lapack() -> None:
    """Load the LAPACK that kernels call, a module of `scipy.linalg`, without that package: it imports half of
    scipy and numpy's Fortran compiler, a quarter of a second, and is left to be imported as usual."""
    package = "scipy.linalg"
    described = importlib.util.find_spec(package)
    if package in sys.modules or described is None:
        return
    sys.modules[package] = importlib.util.module_from_spec(described)
    try:
        for name in ("cython_blas", "cython_lapack"):
            importlib.import_module(f"{package}.{name}")
    finally:
        del sys.modules[package]


_load_lapack()

told: Final[list[Callable[[str], None]]] = []
"""Those that want to know what is compiled now."""
before_kernels: Final[list[Callable[[], None]]] = []
"""Called before a kernel is compiled, by the thread that compiles it."""

_OWN_SOURCE: Final = hash_of_file(__file__)
"""This module, as it was imported: how kernels are compiled."""

_Function = TypeVar("_Function", bound=Callable[..., Any])


@overload
def compiled(function: _Function, /) -> _Function: ...


@overload
def compiled(
    *,
    inside: bool = False,
    inlined: bool = False,
    innermost: bool = False,
    addressed: bool = False,
) -> Callable[[_Function], _Function]: ...


def compiled(
    function: Any = None,
    /,
    *,
    inside: bool = False,
    inlined: bool = False,
    innermost: bool = False,
    addressed: bool = False,
) -> Any:
    """Compile a function at its first call, and cache the result on disk; the kernel releases the GIL.

    No `fastmath`: the same input always gives the same bits. Division follows IEEE and does not raise.

    Args:
        function: the kernel; without it, a decorator.
        inside: only kernels call it, so no entry point from Python is compiled, which for a small function is
            half of the work; it is cached as part of its callers.
        inlined: as `inside`, and its source is inlined into its callers before compilation. For functions
            with one caller: linked ones would be optimised again at every level above.
        innermost: as `inside`, and its machine code is always inlined, whatever its size: for functions
            that cost no more than a call.
        addressed: it has an entry point for C, too.
    """
    options = {
        "inside": inside,
        "inlined": inlined,
        "innermost": innermost,
        "addressed": addressed,
    }
    if function is None:
        return functools.partial(compiled, **options)
    vars(function)[OPTIONS] = options
    alone: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    if inlined:
        alone["inline"] = "always"
    if innermost:
        alone["forceinline"] = True
    part = numba.njit(nogil=True, error_model="numpy", **alone)(function)
    part._compiler.compile = functools.partial(_compile_part, part._compiler.compile)
    part.get_call_template = functools.partial(_of_kinds, part.get_call_template)
    if inside or inlined or innermost:
        return part
    kernel = numba.njit(nogil=True, error_model="numpy")(function)
    turn = KernelTurn(function.__qualname__)
    kernel._compiler.compile = functools.partial(
        _compile_in_turn, turn, part, addressed
    )
    kernel.get_call_template = part.get_call_template
    kernel.get_overload = part.get_overload
    kernel._cache = _Cache(function, turn)
    return kernel


def _of_kinds(template: Callable[..., Any], args: Any, kws: Any) -> Any:
    """One kernel for all values of an argument; numba would compile another for each constant truth value."""
    return template(
        tuple(map(types.unliteral, args)),
        {k: types.unliteral(v) for k, v in kws.items()},
    )


class _Part(JITCodeLibrary):
    """Code to be linked into kernels, as it was written.

    numba optimises and translates every function together with all that it calls, so at each level of calls
    everything below once more: four fifths of its time.
    """

    def _optimize_final_module(self) -> None:
        """The kernels that this is linked into are optimised."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        self._ensure_finalized()
        return 0


class _EntryPoint(JITCodeLibrary):
    """An entry point from Python with all that it calls, which counts references to arrays by itself.

    numba counts them in steps that are atomic, as threads could share an array: a twentieth of the time of a
    replay. Here each call from Python makes counters of its own for its arrays, and a kernel starts no
    threads, so only the thread that called it counts them.
    """

    def _optimize_final_module(self) -> None:
        counting = llvmlite.binding.parse_assembly(str(_counting_module()))
        self._final_module.link_in(counting)
        for name in _COUNTING:
            # kernels of others continue to use those of numba
            self._final_module.get_function(name).linkage = "internal"
        super()._optimize_final_module()


_COUNTING: Final = ("NRT_incref", "NRT_decref")
"""Names by which compiled code counts one reference more to an array, and one less."""


def _counting_module() -> ir.Module:
    """How references to an array are counted within one thread; behind the last one the array is freed.

    Like numba's, these functions are not inlined: its optimiser looks for calls of them that cancel out.
    """
    module = ir.Module("counting")
    count_type = ir.IntType(64)
    array_type = ir.IntType(8).as_pointer()
    of_array = ir.FunctionType(ir.VoidType(), [array_type])
    free = ir.Function(module, of_array, "NRT_MemInfo_call_dtor")
    for name, change in zip(_COUNTING, (1, -1), strict=True):
        function = ir.Function(module, of_array, name)
        function.attributes.add("noinline")
        (array,) = function.args
        builder = ir.IRBuilder(function.append_basic_block())
        is_counted = builder.icmp_unsigned("!=", array, ir.Constant(array_type, None))
        with builder.if_then(is_counted):
            # the count is the first number of what numba keeps of an array
            place = builder.bitcast(array, count_type.as_pointer())
            count = builder.add(builder.load(place), ir.Constant(count_type, change))
            builder.store(count, place)
            if change < 0:
                is_last = builder.icmp_unsigned("==", count, ir.Constant(count_type, 0))
                with builder.if_then(is_last):
                    builder.call(free, [array])
        builder.ret_void()
    return module


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Compile without what costs a tenth of the time: the collector, which looks at all objects again and
    again and finds little, and numba's events, which tell listeners how long each pass took.

    numba's lock is held, so no other thread compiles.
    """
    collects = gc.isenabled()
    broadcast = event.broadcast
    gc.disable()
    event.broadcast = lambda _: None
    try:
        yield
    finally:
        event.broadcast = broadcast
        if collects:
            gc.enable()


def _compile_part(compile_: Callable[..., Any], *args: Any) -> Any:
    """Compile for other kernels only: nothing that could be called."""
    codegen = cpu_target.target_context.codegen()
    before = codegen._library_class, codegen.set_env
    codegen._library_class = _Part
    codegen.set_env = lambda *_: None
    try:
        return compile_(*args)
    finally:
        codegen._library_class, codegen.set_env = before


def _compile_in_turn(
    turn: KernelTurn, part: Any, addressed: bool, args: Any, return_type: Any
) -> Any:
    """An entry point from Python; the turn ends when it is kept on disk, or could not be compiled."""
    for begin in before_kernels:
        begin()
    _tell(part.py_func)
    try:
        return _compile_entry(part, addressed, args, return_type)
    except BaseException:
        turn.give_back()
        raise


def _tell(function: Callable[..., Any]) -> None:
    """Tell that a kernel is compiled now, here or by a process that is waited for."""
    for tell in told:
        tell(function.__name__.strip("_").replace("_", " "))


def _compile_entry(part: Any, addressed: bool, args: Any, return_type: Any) -> Any:  # noqa: ARG001
    """An entry point from Python: the kernel with all that it calls, optimised once.

    Parallel sums are combined into vector instructions; each sum still has a fixed order.
    """
    with _undisturbed():
        part.compile(tuple(args))
    compiled = part.overloads[tuple(args)]
    context = compiled.target_context
    library = _EntryPoint(context.codegen(), compiled.fndesc.qualname)
    library.enable_object_caching()
    library._shared_module = llvmlite.binding.parse_assembly("")  # kernels link parts
    library.add_linking_library(compiled.library)
    wrapped = library, compiled.fndesc, compiled.environment, compiled.call_helper
    before = numba.config.SLP_VECTORIZE
    numba.config.SLP_VECTORIZE = 1
    try:
        context.create_cpython_wrapper(*wrapped, release_gil=True)
        if addressed:
            context.create_cfunc_wrapper(*wrapped)
        entry = context.get_executable(library, compiled.fndesc, compiled.environment)
    finally:
        numba.config.SLP_VECTORIZE = before
    result = compiled._replace(library=library, entry_point=entry, metadata={})
    for inner in result._find_referenced_environments():
        library.codegen.set_env(inner.env_name, inner)
    return result


class _Cache:
    """numba's cache of a kernel, created on first use, when everything that the kernel names is defined."""

    def __init__(self, function: Callable[..., Any], turn: KernelTurn) -> None:
        self._function = function
        self._turn = turn

    @functools.cached_property
    def _kernel_cache(self) -> Any:
        try:
            return _KernelCache(self._function, self._turn)
        except RuntimeError:
            # no folder to write to, neither beside the source nor in the user's home
            return NullCache()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel_cache, name)


class _KernelFiles(CompileResultCacheImpl):
    def __init__(self, function: FunctionType) -> None:
        super().__init__(function)
        self._locator: Any = _Stamped(super().locator, function)

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


class _KernelCache(FunctionCache):
    _impl_class = _KernelFiles

    def __init__(self, function: Callable[..., Any], turn: KernelTurn) -> None:
        super().__init__(function)
        self._turn = turn
        self._tell = functools.partial(_tell, function)
        self._read_index = self._cache_file._load_index
        self._cache_file._load_index = self._index

    def _index(self) -> dict[Any, Any]:
        """What is cached; nothing if the index names a class of arguments of another version."""
        try:
            index: dict[Any, Any] = self._read_index()
        except (AttributeError, ImportError, pickle.UnpicklingError):
            return {}
        return index

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        # numba would load its whole compiler first (a fifth of a second), needed only to compile.
        rtsys.initialize(target_context)
        kernel = self._load_overload(sig, target_context)
        if kernel is not None:
            return kernel
        self._turn.take(self.cache_path, self._tell)
        # another process may have compiled it in the meantime
        kernel = super().load_overload(sig, target_context)
        if kernel is not None:
            self._turn.give_back()
        return kernel

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        finally:
            self._turn.give_back()

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        # numba identifies named-tuple arguments by class name only; their fields may change.
        return (*super()._index_key(sig, codegen), tuple(fields_of(sig)))


class _Stamped:
    """numba's cache location of a kernel, with our stamp."""

    def __init__(self, locator: Any, function: FunctionType) -> None:
        self._locator = locator
        self._function = function

    def get_source_stamp(self) -> str:
        return stamp_of(self._function, _OWN_SOURCE)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._locator, name)
