"""The plant as it is now: the richest structure that is watched, fitted to the newest samples."""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.dynamics import Model, Parameters, PidGains
from twinmatch.errors import TwinmatchError
from twinmatch.matching import Noise, StructureFit, fit_structure
from twinmatch.signals import Window

__all__ = ["Present"]


class Present:
    """What the candidates are compared with, fitted anew for every window that moved.

    Each fit begins where the one before ended, so that what the newest samples leave open stays as it was.
    """

    def __init__(self, models: Sequence[Model], noise: Noise, gains: PidGains | None) -> None:
        """Of these structures of a plant, simpler ones first, the richest is fitted: the last with the most
        parameters. One from elsewhere may fail, so it measures the others only if there is no other."""
        own = [model for model in models if not model.is_elsewhere] or models
        self._model = max(reversed(own), key=lambda model: model.structure.n_parameters())
        self._noise, self._gains = noise, gains
        self._fit: StructureFit | None = None

    def forget(self) -> None:
        """Begin anew: samples that were fitted turned out to show a fault."""
        self._fit = None

    def look(self, history: Window | None) -> Parameters | None:
        """The plant as the newest samples show it; None where they are too few."""
        try:
            windows = [] if history is None else [history]
            self._fit = fit_structure(
                windows, self._model, start=self._fit, noise=self._noise, gains=self._gains, thorough=False
            )
        except TwinmatchError:
            return None
        return self._fit.parameters
