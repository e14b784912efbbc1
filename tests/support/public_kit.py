"""A kit by the public package's model, whose equations are not ours."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest

from twinmatch.dynamics import Controller, law_of
from twinmatch.plants import TCLabBoth
from twinmatch.signals import NANOSECONDS, Sample

Pair = tuple[float, float]
"""Values of heater 1 and heater 2, or of their sensors."""


def public_kit(seed: int) -> Any:
    """The package's model of a kit with both heaters, at rest, on a clock of its own that begins at 0 s."""
    tclab = pytest.importorskip("tclab", reason="the kit's package is not installed")
    random.seed(seed)  # the model draws its noise there
    kit = tclab.TCLabModel(synced=False)
    kit.tlast = 0.0
    return kit


class KitSample(NamedTuple):
    """A second of a kit."""

    sample: Sample
    temperatures: Pair
    """What sensors without a fault read, °C."""


def held(levels: Sequence[Pair], hold: int, size: int) -> list[Pair]:
    """Set-points for each of `size` seconds: levels that are held for so many seconds each, the last to the end."""
    return [levels[min(k // hold, len(levels) - 1)] for k in range(size)]


def as_they_are(_second: int, temperatures: Pair, _room: float) -> Pair:
    """The readings of sensors without a fault."""
    return temperatures


def kit_under_its_loop(
    seed: int,
    references: Sequence[Pair],
    *,
    readings: Callable[[int, Pair, float], Pair] = as_they_are,
    heat: Callable[[int], Pair] = lambda _: (1.0, 1.0),
) -> Iterator[KitSample]:
    """A kit under its usual loop.

    Args:
        seed: of the noise.
        references: set-points, °C, for each second.
        readings: what the sensors read, given the second, the kit's temperatures and the room's, °C.
        heat: the share of each heater's heat that stays in the kit in a second.
    """
    kit = public_kit(seed)
    controller = Controller(law_of(TCLabBoth, 1.0))
    for k, reference in enumerate(references):
        temperatures = (float(kit.T1), float(kit.T2))
        measured = readings(k, temperatures, float(kit.Ta))
        command = controller.step(np.array(reference), np.array(measured))
        drives = (float(command[0]), float(command[1]))
        sample = Sample(k, k * NANOSECONDS, reference, measured, drives)
        yield KitSample(sample, temperatures)
        share = heat(k)
        kit.Q1(share[0] * drives[0])
        kit.Q2(share[1] * drives[1])
        kit.update(float(k + 1))
