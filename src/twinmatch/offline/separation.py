"""What a recording cannot tell apart: parameters that it shows only together, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import StructureFit, fit_session
from twinmatch.signals import FloatArray, Window

_OPEN: Final = 0.1
"""Standard deviation from which a parameter is open, in units of its scale."""
_TOGETHER: Final = 0.95
"""Size of the correlation from which two open parameters show only together."""
_STOOD: Final = 0.9
"""Share of the samples at one level from which an input counts as held."""


@dataclass(frozen=True)
class Inseparable:
    """Parameters that a recording does not tell apart."""

    names: tuple[str, ...]
    why: str
    """What the input did, in words; empty if that does not explain it."""

    @property
    def sentence(self) -> str:
        """What is open, in one sentence."""
        listed = " and ".join([", ".join(self.names[:-1]), self.names[-1]])
        return f"{listed} cannot be told apart{': ' if self.why else ''}{self.why}"


def inseparable_in(windows: Sequence[Window], plant: type[Plant]) -> Inseparable | None:
    """The parameters of the plant's first structure that stretches of a recording do not tell apart; None if
    there are none, or the structure cannot be fitted."""
    try:
        fitted = fit_session(plant.model(), windows, informed=False)
    except TwinmatchError:
        return None
    names = _inseparable_names(fitted)
    return Inseparable(names, _held_words(windows, plant)) if names else None


def _inseparable_names(fitted: StructureFit) -> tuple[str, ...]:
    """Names of the open parameters that are correlated with another one so closely that only one combination
    of them shows."""
    model = fitted.model
    free = model.structure.free
    scales = np.array([model.declared[name].scale for name in free])
    covariance = fitted.covariance / np.outer(scales, scales)
    deviations = np.sqrt(np.diag(covariance))
    names = set()
    for i, j in combinations(range(len(free)), 2):
        are_open = deviations[i] > _OPEN and deviations[j] > _OPEN
        if (
            are_open
            and abs(covariance[i, j]) > _TOGETHER * deviations[i] * deviations[j]
        ):
            names |= {free[i], free[j]}
    return tuple(name for name in free if name in names)


def _held_words(windows: Sequence[Window], plant: type[Plant]) -> str:
    """Which drive stood at one level, and for how long; empty if every drive moved."""
    period = windows[0].period
    columns: FloatArray = np.concatenate([window.inputs for window in windows])
    words = []
    for (name, drive), values in zip(plant.drives.items(), columns.T, strict=True):
        levels, counts = np.unique(values, return_counts=True)
        most = int(np.argmax(counts))
        if counts[most] >= _STOOD * len(values):
            lasted = f"{counts[most] * period:.4g} of {len(values) * period:.4g} s"
            words.append(
                f"{name} stood at {levels[most]:g} {drive.unit}".rstrip()
                + f" for {lasted}"
            )
    return " and ".join(words)
