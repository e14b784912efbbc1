"""Ending what belongs together, in an order in which nothing is used after its end."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

__all__ = ["end_in_order"]


def end_in_order(*endings: Callable[[], object]) -> bool:
    """Call all of these one after the other, also if one of them fails: what follows has to end as well.

    Args:
        endings: each ends a part; it returns False if the part has not ended, such as a thread that computes.

    Returns:
        Whether all parts have ended.

    Raises:
        Exception: what the last that failed has raised; those before it are its context.
    """
    ended: list[bool] = []

    def end(ending: Callable[[], object]) -> None:
        ended.append(ending() is not False)

    with ExitStack() as calls:  # which begins with the last, and goes on if a call fails
        for ending in reversed(endings):
            calls.callback(end, ending)
    return all(ended)
