"""How colours differ to a reader, and whether there are any."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np


def linear(colour: str) -> np.ndarray:
    """Red, green and blue of `#rrggbb`, linear in light."""
    value = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def contrast(first: str, second: str) -> float:
    """Ratio of luminances, as the WCAG compute it."""
    low, high = sorted(
        float(linear(colour) @ [0.2126, 0.7152, 0.0722]) for colour in (first, second)
    )
    return (high + 0.05) / (low + 0.05)


def drawn(picture: Path) -> float:
    """The share of a PNG's pixels that are not of its background."""
    pixels = matplotlib.image.imread(picture)
    return float(np.any(pixels != pixels[0, 0], axis=-1).mean())
