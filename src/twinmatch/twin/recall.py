"""Whether the plant is the one that earlier sessions have shown."""

from __future__ import annotations

from typing import Final

import numpy as np

from twinmatch.fitting import Prior, StructureFit

_LEAST_LEARNED: Final = 0.2
"""Least share of the prior variance of a direction that the samples have removed, if it is to count."""
_CHANCE: Final = 1e-3
"""Probability with which a plant like the remembered ones is taken for another at a fit.

It is small enough although every fit of a session is tested: these are hardly independent, and leaving a
memory that was right costs only the quick start."""


def unlike(fit: StructureFit, prior: Prior) -> str:
    """How the plant differs from the remembered ones, in a sentence; empty while it may be one of them.

    With prior covariance Σ and that of the fit C, the fit of a plant like the remembered ones lies around the
    prior mean with covariance Σ − C. Only directions count in which the samples have narrowed the prior.
    """
    from scipy.special import chdtri  # noqa: PLC0415 — a quarter of a second, seldom needed

    parameters = fit.parameters
    free = fit.model.structure.free
    mean, deviation = np.array([prior[name] for name in free]).T
    distance = (np.array([parameters[name] for name in free]) - mean) / deviation
    open_share = fit.covariance / np.outer(deviation, deviation)
    learned_share, directions = np.linalg.eigh(np.eye(len(free)) - (open_share + open_share.T) / 2)
    is_learned = learned_share >= _LEAST_LEARNED
    along_directions = np.square(directions.T[is_learned] @ distance)
    surprise = float(np.sum(along_directions / learned_share[is_learned]))
    if not is_learned.any() or surprise <= chdtri(is_learned.sum(), _CHANCE):
        return ""
    farthest = int(np.argmax(np.abs(distance)))
    name = free[farthest]
    unit = fit.model.declared[name].unit
    is_ = f"{name} is {parameters[name]:.3g} {unit}".rstrip()
    was = f"{mean[farthest]:.3g} ± {deviation[farthest]:.1g}"
    return f"this is not the plant that the memory describes: {is_}, remembered {was}; the memory is left"
