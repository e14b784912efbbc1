"""An overview of the numbers in a bag, for choosing which of them is which signal."""

from __future__ import annotations

from typing import Final

import numpy as np

from twinmatch.errors import TwinmatchError
from twinmatch.sessions.bags import Bag
from twinmatch.sessions.guesses import Column
from twinmatch.sessions.sampling import Channel
from twinmatch.sessions.sampling.usual_units import usual_unit

__all__ = ["look_into"]

_ENOUGH: Final = 2000
"""Messages read per topic."""
_FIELDS: Final = 20
"""Most numbers in a listed message; messages with more are images and point clouds."""


def look_into(bag: Bag) -> list[Column]:
    """An overview of the numbers of each topic, under the names a map uses."""
    columns = []
    for topic in bag.topics:
        if not topic.messages or len(topic.numbers) > _FIELDS:
            continue
        channels = [Channel(topic.name, path) for path in topic.numbers]
        try:
            found = bag.series(channels, _ENOUGH)
        except TwinmatchError:
            continue  # a topic that cannot be read is not proposed
        for channel, series in zip(channels, found, strict=True):
            values = series.values[np.isfinite(series.values)]
            if values.size:
                columns.append(_column(channel.text, usual_unit(series.kind, series.path), values))
    return columns


def _column(title: str, unit: str, values: np.ndarray) -> Column:
    different = int(np.unique(values).size)
    two = set(np.unique(values)) <= {0.0, 1.0}
    kind = "constant" if different == 1 else "on or off" if two else "numbers"
    return Column(title, unit, float(values.min()), float(values.max()), different, 0, kind)
