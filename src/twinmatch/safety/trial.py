"""A law on trial: in the shadow of the one that runs, driving within its bands, kept or taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Annotated, Final

import numpy as np

from twinmatch.dynamics import PidGains
from twinmatch.errors import TwinmatchError
from twinmatch.requirements import FINITE
from twinmatch.signals import FloatArray

GAINS: Final = (
    "proportional",
    "integral",
    "derivative",
    "back_calculation",
    "on_measurement",
)
"""What a law on trial may change of a PID."""


class TrialError(TwinmatchError):
    """A law cannot be put on trial like this."""


class TrialPhase(Enum):
    """How far a trial is."""

    ANSWERED = "answered"
    """Its law was tried on the twins; nothing drives."""
    REFUSED = "refused"
    SHADOW = "shadow"
    """The law is computed, and another one drives."""
    DRIVING = "driving"
    KEPT = "kept"
    """It drives, and its predictions have ended."""
    BACK = "back"
    """The law before drives again."""


@dataclass(frozen=True)
class LawReport:
    """A law on trial at a sample: what the twin answers about it, or what the controller does with it."""

    sample: int
    """Index of the newest sample."""
    phase: TrialPhase
    first: int = 0
    """The first sample at which it drove."""
    decision: str = ""
    """What was answered: safe, fails or undecided; empty: nothing yet."""
    family: str = ""
    """Stands for the twins and the law that were asked."""
    although: bool = False
    """Whether it drives although it was not found safe."""
    proportional: Annotated[tuple[float, ...], FINITE] = ()
    integral: Annotated[tuple[float, ...], FINITE] = ()
    derivative: Annotated[tuple[float, ...], FINITE] = ()
    reason: str = ""
    """The answer in a sentence; why it is refused, or was taken back."""
    request: str = ""
    """The word of the request that it belongs to."""

    def of(self, gains: Sequence[PidGains]) -> LawReport:
        """This report, about the law of these PIDs."""
        return replace(
            self,
            proportional=tuple(pid.proportional for pid in gains),
            integral=tuple(pid.integral for pid in gains),
            derivative=tuple(pid.derivative for pid in gains),
        )


@dataclass(frozen=True, eq=False)
class TrialBands:
    """Where the outputs are to be while a law drives.

    Raises:
        TrialError: a value is not finite, ends are not in order, or times are not positive.
    """

    low: FloatArray
    """Lower ends of the outputs at every sample, shape (N, o)."""
    high: FloatArray
    shadow: int = 0
    """Samples in the shadow first."""
    patience: int = 10
    """Samples outside, less those inside since, after which the law is taken back."""

    def __post_init__(self) -> None:
        whole = (
            self.low.ndim == 2
            and self.low.shape == self.high.shape
            and self.low.size > 0
        )
        if not (
            whole
            and np.isfinite([self.low, self.high]).all()
            and (self.low < self.high).all()
        ):
            raise TrialError(
                "trial: the bands are not pairs of finite ends in increasing order"
            )
        if self.shadow < 0 or not 1 <= self.patience <= len(self.low):
            raise TrialError(
                f"trial: {self.shadow} samples in the shadow and a patience of {self.patience}; give at "
                f"least 0, and 1 to {len(self.low)}"
            )


class LawTrial:
    """Watches one law, sample by sample; depends on nothing but these.

    shadow ──its time──▶ driving ──its bands end──▶ kept
       └──operator, guard──▶ back ◀──missed, operator, guard──┘
    """

    def __init__(self, bands: TrialBands) -> None:
        """Begin in the shadow, or driving."""
        self._bands = bands
        self.phase = TrialPhase.SHADOW if bands.shadow else TrialPhase.DRIVING
        self.reason = ""
        """Why it was taken back; empty before."""
        self._done = 0
        self._missed = 0

    @property
    def drives(self) -> bool:
        """Whether its law drives the plant."""
        return self.phase in {TrialPhase.DRIVING, TrialPhase.KEPT}

    @property
    def ended(self) -> bool:
        """Whether nothing is left to watch."""
        return self.phase in {TrialPhase.KEPT, TrialPhase.BACK}

    def take_back(self, reason: str) -> None:
        """The law before drives again."""
        if self.phase is not TrialPhase.BACK:
            self.phase = TrialPhase.BACK
            self.reason = reason

    def push(self, outputs: Sequence[float]) -> TrialPhase:
        """Take the readings of a sample; they count while the law drives within its bands."""
        self._done += 1
        if self.phase is TrialPhase.SHADOW and self._done >= self._bands.shadow:
            self.phase = TrialPhase.DRIVING
            self._done = 0
        elif self.phase is TrialPhase.DRIVING:
            self._judge(np.array(outputs, dtype=np.float64))
        return self.phase

    def _judge(self, outputs: FloatArray) -> None:
        k = self._done - 1
        bands = self._bands
        inside = (bands.low[k] <= outputs) & (outputs <= bands.high[k])
        self._missed = max(self._missed + (-1 if inside.all() else 1), 0)
        if self._missed >= bands.patience:
            j = int(np.argmin(inside))
            ends = f"{bands.low[k, j]:.4g} to {bands.high[k, j]:.4g}"
            self.take_back(
                f"output {j + 1} is {outputs[j]:.4g}, not {ends}, for {self._missed} samples"
            )
        elif self._done == len(bands.low):
            self.phase = TrialPhase.KEPT
