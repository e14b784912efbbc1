"""Ending what belongs together, in an order in which nothing is used after its end."""

from __future__ import annotations

from collections.abc import Callable

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
    if not endings:
        return True
    first, *later = endings
    try:
        first_ended = first() is not False
    finally:
        others_ended = end_in_order(*later)
    return first_ended and others_ended
