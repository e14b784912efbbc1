"""The functions of an FMU's library that are called at every sample, bound once for fast calls."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, Final

__all__ = ["Calls", "Group"]

_WARNING: Final = 1
"""Highest status that is not an error."""
_POINTER, _SIZE, _REAL = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double


class Calls:
    """Functions by name without `fmi2` or `fmi3`; an error status is raised as an exception."""

    def __init__(self, fmu: Any, major: int) -> None:
        """Bind an instance made by FMPy; `major` is the version of FMI."""
        self.fmu, self.major = fmu, major

    def bound(self, name: str, *types: Any) -> Callable[..., None]:
        """A function of the library, bound to the instance as its first argument."""
        function = self.fmu.dll[f"fmi{self.major}{name}"]
        function.restype, function.argtypes = ctypes.c_int, (_POINTER, *types)
        fmu = self.fmu

        def call(*arguments: Any) -> None:
            status = function(fmu.component, *arguments)
            if status > _WARNING:
                raise RuntimeError(f"its function {name} returned status {status}")

        return call

    def address(self, name: str) -> int:
        """Address of a function; 0 if it is missing."""
        return int(ctypes.cast(self.fmu.dll[f"fmi{self.major}{name}"], _POINTER).value or 0)

    def group(self, references: Sequence[int]) -> Group:
        """Variables that are set or read together."""
        return Group(self, references)


class Group:
    """Some variables of an FMU, with a buffer for their values."""

    def __init__(self, calls: Calls, references: Sequence[int]) -> None:
        n = len(references)
        self.values = (_REAL * n)()
        self._references = (ctypes.c_uint32 * n)(*references)
        self.address = ctypes.addressof(self._references)
        """Address of the references."""
        self._arguments: tuple[int, ...] = (
            ctypes.addressof(self._references), n, ctypes.addressof(self.values), n,
        )[: 3 if calls.major == 2 else 4]  # fmt: skip
        types = (_POINTER, _SIZE, _POINTER, _SIZE)[: len(self._arguments)]
        kind = "Real" if calls.major == 2 else "Float64"
        self._get, self._set = (calls.bound(f"{verb}{kind}", *types) for verb in ("Get", "Set"))

    def write(self, values: Sequence[float]) -> None:
        """Set the variables."""
        if values:
            self.values[:] = list(values)
            self._set(*self._arguments)

    def read(self) -> list[float]:
        """Read the variables."""
        if len(self.values):
            self._get(*self._arguments)
        return self.values[:]
