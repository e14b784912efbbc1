"""One thread for linear algebra, so that the order of summation is fixed.

A BLAS that splits a product among threads sums in a different order than one thread does, and the last bits
differ. Verdicts are compared bit for bit, and the matrices here are too small to gain from threads.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController

__all__ = ["one_thread"]


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Context within which the BLAS of the process uses one thread."""
    limits: AbstractContextManager[object] = _controller().limit(limits=1, user_api="blas")
    return limits
