"""Gaps and margins that have no value: one error, raised where they are computed.

A matrix of a model or a law may be singular at a frequency, or its values may be so large or so small that
the eigenvalues of what is made of them are not found.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from twinmatch.comparing.polynomials import DiscriminationError


class UndefinedError(DiscriminationError):
    """A gap or a margin has no value; the message says which and why."""


@contextmanager
def having_value(what: str) -> Iterator[None]:
    """Compute a gap or a margin, which is named `what` in the message; also a decorator.

    Raises:
        UndefinedError: it has no value.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise UndefinedError(f"{what} has no value ({error})") from error
