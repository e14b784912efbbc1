"""How this room compiles its numeric kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

__all__ = ["kernel"]

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(function: _Function) -> _Function:
    """Compile, keep the result on disk, release the interpreter lock; IEEE rounding as written."""
    return cast(_Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
