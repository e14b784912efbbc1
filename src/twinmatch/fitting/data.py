"""Input checks shared by all public functions of this package."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twinmatch.fitting.errors import IdentificationError
from twinmatch.signals import FloatArray

__all__ = ["checked_pair", "checked_signal"]


def checked_signal(values: ArrayLike, name: str) -> FloatArray:
    """One signal as a float array of shape (N,).

    Raises:
        IdentificationError: not one-dimensional, empty, or not finite.
    """
    signal = np.array(values, dtype=np.float64, order="C")  # a copy: kernels are compiled for writable arrays
    if signal.ndim != 1 or signal.size == 0:
        msg = f"{name}: has shape {signal.shape}; give one value per sample"
        raise IdentificationError(msg)
    bad = np.flatnonzero(~np.isfinite(signal))
    if bad.size:
        msg = f"{name}: {signal[bad[0]]} at sample {bad[0]}; only finite values can be used"
        raise IdentificationError(msg)
    return signal


def checked_pair(u: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Input and output as float arrays of one length.

    Raises:
        IdentificationError: as `checked_signal`, or the lengths differ.
    """
    input_, output = checked_signal(u, "input u"), checked_signal(y, "output y")
    if input_.size != output.size:
        msg = f"input u has {input_.size} samples and output y {output.size}; give equally many"
        raise IdentificationError(msg)
    return input_, output
