"""One thread for linear algebra, so that sums have one order.

A BLAS that shares a product among threads adds its parts in another order than one thread does, and the
last bits differ. Verdicts are compared bit for bit, and the matrices here gain nothing from threads.
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
    """Within this context the BLAS of the process uses one thread."""
    limits: AbstractContextManager[object] = _controller().limit(limits=1, user_api="blas")
    return limits
