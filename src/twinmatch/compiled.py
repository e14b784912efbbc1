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
import os
import secrets
import sys
from collections.abc import Callable, Iterator
from types import FunctionType
from typing import Any, Final, TypeVar, overload

import numba

from twinmatch import numba_insides, optimiser, reference_counts
from twinmatch.kernel_stamps import OPTIONS, fields_of, hash_of_file, stamp_of
from twinmatch.kernel_turns import KernelTurn
from twinmatch.numba_insides import start_runtime
from twinmatch.processor import COMMON, processor

__all__ = ["before_kernels", "compiled", "start_runtime", "told"]


def _choose_processor() -> None:
    """Have numba compile for a common kind of processor, unless its settings name one.

    numba keeps what it has compiled under the processor's name, so code that came with a wheel is found.
    """
    is_chosen = numba.config.CPU_NAME is not None
    if not is_chosen and processor().name == COMMON:
        numba.config.CPU_NAME, numba.config.CPU_FEATURES = processor()


_choose_processor()


def _number_apart() -> None:
    """Start numba's numbers of compiled functions somewhere else than in any other process.

    It starts from one in every process, so kernels cached by two processes could have the same name. If such
    a kernel is loaded twice, alone and inside another, one uses the other's data and fails
    ("'descr' is NULL").
    """
    numba_insides.number_functions_from(secrets.randbits(48))


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
"""Called before a kernel that is not on disk is compiled or waited for, by the thread that needs it."""

_HOW: Final = b"".join(
    hash_of_file(module.__file__)
    for module in (
        sys.modules[__name__],
        numba_insides,
        optimiser,
        reference_counts,
    )
)
"""The modules that say how kernels are compiled, as they were imported."""

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
    numba_insides.make_part(part)
    if inside or inlined or innermost:
        return part
    kernel = numba.njit(nogil=True, error_model="numpy")(function)
    turn = KernelTurn(function.__qualname__)
    compile_ = functools.partial(_compile_in_turn, turn, part, addressed)
    numba_insides.make_entry(kernel, part, compile_, _Cache(function, turn))
    return kernel


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Compile without the collector, which looks at all objects again and again and finds little.

    numba's lock is held, so no other thread compiles.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _compile_in_turn(
    turn: KernelTurn,
    part: Any,
    addressed: bool,
    args: Any,
    return_type: Any,  # noqa: ARG001
) -> Any:
    """An entry point from Python; the turn ends when it is kept on disk, or could not be compiled."""
    _tell(part.py_func)
    try:
        return _compile_entry(part, addressed, args)
    except BaseException:
        turn.give_back()
        raise


def _tell(function: Callable[..., Any]) -> None:
    """Tell that a kernel is compiled now, here or by a process that is waited for."""
    for tell in told:
        tell(function.__name__.strip("_").replace("_", " "))


def _compile_entry(part: Any, addressed: bool, args: Any) -> Any:
    """An entry point from Python: the kernel with all that it calls, optimised once."""
    with _undisturbed():
        part.compile(tuple(args))
    return numba_insides.entry_point(part.overloads[tuple(args)], addressed=addressed)


class _Cache:
    """The cache of a kernel, in which processes take turns.

    It is found on first use, when everything that the kernel names is defined.
    """

    def __init__(self, function: FunctionType, turn: KernelTurn) -> None:
        self._function = function
        self._turn = turn

    @functools.cached_property
    def _kept(self) -> Any:
        def stamp() -> str:
            return stamp_of(self._function, _HOW)

        try:
            return numba_insides.KernelCache(self._function, stamp, fields_of)
        except RuntimeError:
            return None

    @property
    def cache_path(self) -> str | None:
        """The folder; None if there is none to write to."""
        return None if self._kept is None else self._kept.cache_path

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The kernel that is kept, which another process may just compile; None: this one has to."""
        if self._kept is None:
            return None
        kernel = self._kept.load(signature, target_context)
        if kernel is not None:
            return kernel
        # not within a turn, which a copy of this process would have, too
        for begin in before_kernels:
            begin()
        self._turn.take(self._kept.cache_path, functools.partial(_tell, self._function))
        # another process may have compiled it in the meantime
        kernel = self._kept.load_overload(signature, target_context)
        if kernel is not None:
            self._turn.give_back()
        return kernel

    def save_overload(self, signature: Any, kernel: Any) -> None:
        """Keep a kernel, for other processes too."""
        try:
            if self._kept is not None:
                self._kept.save_overload(signature, kernel)
        finally:
            self._turn.give_back()

    def flush(self) -> None:
        """Forget what is kept."""
        if self._kept is not None:
            self._kept.flush()
