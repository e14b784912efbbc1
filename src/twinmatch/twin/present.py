"""The plant as it is now: the richest watched structure, fitted to the newest samples."""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.dynamics import Model, Parameters, PidGains
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Noise, StructureFit, fit_structure
from twinmatch.signals import Window

__all__ = ["Present"]


class Present:
    """The plant that candidates are compared with, refitted for every window with excitation.

    Each fit starts from the previous one, so that undetermined parameters keep their values.
    """

    def __init__(self, models: Sequence[Model], noise: Noise, gains: PidGains | None) -> None:
        """`models`: structures of the plant, simple ones first; the last of those with the most parameters is
        fitted. Structures that run elsewhere may fail, so they are used only if there are no others."""
        own = [model for model in models if not model.is_elsewhere] or models
        self._model = max(reversed(own), key=lambda model: model.structure.n_parameters())
        self._noise, self._gains = noise, gains
        self._fit: StructureFit | None = None

    def forget(self) -> None:
        """Start over: some of the fitted samples turned out to show a fault."""
        self._fit = None

    def fitted(self, history: Window | None) -> Parameters | None:
        """Fit the plant to the newest samples; None if they are too few."""
        try:
            windows = [] if history is None else [history]
            self._fit = fit_structure(
                windows, self._model, start=self._fit, noise=self._noise, gains=self._gains, thorough=False
            )
        except TwinmatchError:
            return None
        return self._fit.parameters
