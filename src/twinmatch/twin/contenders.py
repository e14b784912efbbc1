"""Structures that compete in the family, each refitted regularly to the newest samples.

A match of three parameters needs one step of the set-point. The heat stored in a sink, or the temperature of
the room, shows only over many: such structures are fitted to the newest forty minutes, from the first excited
window on. The plant file's typical values count as one observation of each parameter, so that during the
first minutes the fit does not drift along the valley in which many parameters fit equally well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Model, PidGains
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Noise, StructureFit, fit_structure
from twinmatch.forecasting import time_scale
from twinmatch.signals import FloatArray, Window
from twinmatch.twin.history import History

__all__ = ["Contender", "Contenders"]

LONGEST_S: Final = 2400.0
"""Length of the newest stretch that is fitted, s; slow samples get more, as in forecasts."""
EVERY_S: Final = 600.0
"""Age after which a fit is repeated even without excitation, s."""


@dataclass(frozen=True, eq=False)
class Contender:
    """The latest fit of one structure."""

    candidate: Candidate
    fit: StructureFit
    last: int
    """Index of the newest sample of that fit."""

    def states_at(self, sample: int) -> FloatArray | None:
        """States of the twin at a sample of the fit; None outside."""
        states = self.fit.states[-1]
        place = sample - (self.last - len(states) + 1)
        return states[place] if 0 <= place < len(states) else None


class Contenders:
    """Keeps the history and the structures' latest fits; depends only on the windows."""

    def __init__(
        self, models: tuple[Model, ...], noise: Noise, gains: PidGains | None, period: float = 1.0
    ) -> None:
        """Begin without samples.

        Args:
            models: the plant in each structure that competes.
            noise: unit of the residuals.
            gains: those of the running controller; None if the loop is not known.
            period: sample time if the loop is not known, s; otherwise the controller's is used.
        """
        self._models, self._noise, self._gains = models, noise, gains
        period = gains.period if gains is not None else period
        pace = time_scale(period) / period
        self._history = History(max(round(LONGEST_S * pace), 1))
        self._every = round(EVERY_S * pace)
        self._held: dict[str, Contender] = {}

    @property
    def held(self) -> tuple[Contender, ...]:
        """The contenders that can still be run, best fit first."""
        able = (c for c in self._held.values() if not c.fit.model.lost)
        return tuple(sorted(able, key=lambda c: c.fit.charge))

    def push(self, window: Window, *, excited: bool) -> bool:
        """Take one window of a healthy plant; return whether there are new fits."""
        history = self._history.push(window)
        newest = max((c.last for c in self._held.values()), default=None)
        if newest is None and not excited:
            return False
        if newest is not None and not excited and 0 <= history.last - newest < self._every:
            return False
        fresh = [self._fitted(model, history) for model in self._models if not model.lost]
        found = {c.candidate.name: c for c in fresh if c is not None}
        self._held.update(found)
        return bool(found)

    def renew(self, first: int) -> None:
        """Forget the samples before `first`; fits stay until new ones replace them."""
        self._history.cut(first)

    def expel(self, first: int, last: int) -> tuple[str, ...]:
        """Forget fits and samples that overlap `first` to `last`; return the names of the removed fits."""
        held = self._history.window
        if held is not None and held.last >= first:
            self._history = History(self._history.longest)
        gone = tuple(
            name
            for name, c in self._held.items()
            if c.candidate.window is not None and c.last >= first and c.candidate.window.first <= last
        )
        for name in gone:
            del self._held[name]
        return gone

    def _fitted(self, model: Model, history: Window) -> Contender | None:
        before = self._held.get(model.structure_name)
        try:
            fit = fit_structure(
                [history],
                model,
                start=before.fit if before else None,
                noise=self._noise,
                gains=self._gains,
                thorough=False,
                informed=True,
            )
        except TwinmatchError:
            return None  # too few samples yet, or no fit: the previous one stays
        point = float(np.median(history.output if self._gains is None else history.reference))
        free = model.structure.free
        candidate = Candidate(model.structure_name, point, fit.parameters, history, free, fit.covariance)
        return Contender(candidate, fit, history.last)
