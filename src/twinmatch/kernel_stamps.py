"""A stamp of everything that a kernel is made from: the same stamp, the same machine code.

A kernel contains the code of all kernels that it calls and the values of all constants that it uses, from any
file. The stamp covers all that a kernel can reach: the code of the functions it names, recursively, fields of named
tuples, and the values of constants. It is made from what this process has imported, not from the files: these
may have been edited since.
"""

from __future__ import annotations

import functools
import hashlib
import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

from numba import types

OPTIONS: Final = "compiled_with"
"""Attribute of a kernel's function: how it is compiled, which its code does not say."""


def fields_of(kind: Any) -> Iterator[tuple[str, ...]]:
    """Fields of all named tuples in a signature or a type."""
    if isinstance(kind, types.BaseNamedTuple):
        yield tuple(kind.fields)
    members = (
        kind
        if isinstance(kind, (tuple, types.BaseTuple))
        else getattr(kind, "args", ())
    )
    for member in members:
        yield from fields_of(member)


def stamp_of(function: FunctionType, compiler: bytes) -> str:
    """One hash of all code and constants that a kernel is made from, and of what compiles it."""
    ingredients = {_OWN_SOURCE, compiler}
    visited: set[int] = set()
    waiting = [function]
    while waiting:
        current = waiting.pop()
        if id(current) in visited:
            continue
        visited.add(id(current))
        ingredients.add(_hash_of_function(current))
        for name, value in _named(current):
            named_function = _function_of(value)
            if named_function is not None:
                waiting.append(named_function)
            elif isinstance(value, type):
                ingredients.add(_hash_of_class(value))
            else:
                ingredients.add(_hash(name.encode() + b"=" + _bytes_of(value)))
    return hashlib.sha256(b"".join(sorted(ingredients))).hexdigest()


def _function_of(value: Any) -> FunctionType | None:
    """The function itself, or that of a kernel or an intrinsic; None if it is something else."""
    for function in (
        value,
        getattr(value, "py_func", None),
        getattr(value, "__wrapped__", None),
    ):
        if isinstance(function, FunctionType):
            return function
    return None


@functools.cache
def _hash_of_function(function: FunctionType) -> bytes:
    """Hash of a function as it was imported: its code, defaults and options, but no line numbers."""
    defaults = function.__defaults__, function.__kwdefaults__
    text = repr(
        (
            function.__qualname__,
            vars(function).get(OPTIONS),
            _contents(function.__code__),
        )
    )
    return _hash(text.encode() + _bytes_of(defaults))


def _contents(code: CodeType) -> tuple[Any, ...]:
    """What a function does, as values whose `repr` is the same in every process."""
    constants: list[Any] = []
    for constant in code.co_consts:
        if isinstance(constant, CodeType):  # a comprehension or an inner function
            constants.append(_contents(constant))
        elif isinstance(constant, frozenset):
            constants.append(sorted(map(repr, constant)))
        else:
            constants.append(constant)
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    arguments = (
        code.co_argcount,
        code.co_posonlyargcount,
        code.co_kwonlyargcount,
        code.co_flags,
    )
    return code.co_code, code.co_exceptiontable, constants, names, arguments


@functools.cache
def _hash_of_class(kind: type) -> bytes:
    """Hash of a named tuple's fields, all that a kernel takes from it; of any other class, of its file."""
    name = f"{kind.__module__}.{kind.__qualname__}".encode()
    fields = getattr(kind, "_fields", None)
    if fields is None:
        return _hash(
            name
            + hash_of_file(getattr(sys.modules.get(kind.__module__), "__file__", None))
        )
    return _hash(name + _bytes_of((fields, getattr(kind, "_field_defaults", {}))))


def _named(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """The objects that a function's code may refer to by name, including members of modules."""
    names = set(_names(function.__code__))
    cells = function.__closure__ or ()
    scope = function.__globals__ | {
        n: c.cell_contents
        for n, c in zip(function.__code__.co_freevars, cells, strict=True)
    }
    for name in names | set(function.__code__.co_freevars):
        value = scope.get(name)
        if isinstance(value, ModuleType):
            # numpy's functions are implemented by numba, whose version numba checks.
            if value.__name__.partition(".")[0] not in {"numpy", "math", "numba"}:
                yield from ((n, getattr(value, n)) for n in names if hasattr(value, n))
        elif name in scope:
            yield name, value


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):  # a comprehension
            yield from _names(constant)


def _bytes_of(value: object) -> bytes:
    try:
        return pickle.dumps(value)
    except (pickle.PicklingError, TypeError, AttributeError):
        return repr(type(value)).encode()


def _hash(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def hash_of_file(path: str | None) -> bytes:
    """Hash of a file's content; nothing if it cannot be read."""
    if path is None:
        return b""
    try:
        return _hash(Path(path).read_bytes())
    except OSError:
        return b""


_OWN_SOURCE: Final = hash_of_file(__file__)
"""This module, as it was imported."""
