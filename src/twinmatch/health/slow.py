"""Slow changes of a plant from the first doubt to their end: told by name, or as what is left."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from twinmatch.health.changes import Changes
from twinmatch.health.finding import Finding, Words, signed
from twinmatch.health.hypotheses import Change, Hypothesis, Kind
from twinmatch.health.record import Fault
from twinmatch.health.settings import HealthSettings
from twinmatch.signals import Sample

__all__ = ["Slow"]

_NAMES: Final = {
    Kind.LOSSES: Fault.LOSSES_CHANGED,
    Kind.ROOM: Fault.ROOM_CHANGED,
    Kind.DRIVE: Fault.DRIVE_WEAK,
    Kind.SENSOR: Fault.SENSOR_DRIFT,
    Kind.OTHER: Fault.DRIFT,
}
_ASKED: Final = {
    Kind.LOSSES: "its losses",
    Kind.ROOM: "the room",
    Kind.DRIVE: "its drive",
    Kind.SENSOR: "the reading",
    Kind.OTHER: "something that has no name",
}
_RUNNING: Final = 2
"""Comparisons in a row that have to come to the same."""
_UNNAMED: Final = 2.0
"""A change that cannot be named has to explain the readings so much better than one that can."""
_STILL_UNNAMED: Final = 60.0
"""Time for which a name is waited for, s."""
_ACCEPT: Final = 600.0
"""Time after which a change that was told counts as how the plant is now, s."""
_BACK: Final = 0.4
"""Share of a change that may be left of it when it is over."""


@dataclass
class _Told:
    fault: Fault
    hypothesis: Hypothesis
    before: float
    at: int


class Slow:
    """What `Changes` finds, made into findings of a monitor."""

    def __init__(self, settings: HealthSettings, words: Words) -> None:
        """Begin with nothing seen."""
        self._settings, self._words = settings, words
        self._changes = Changes(settings.followed, settings.period)
        self._change: Change | None = None
        self._told: _Told | None = None
        self._over = False
        self.finding: Finding | None = None
        """What there is to say now."""
        self._running = 0
        self._unnamed_since: int | None = None

    @property
    def told(self) -> Fault | None:
        """The fault that was told last and is not over."""
        return self._told.fault if self._told is not None else None

    @property
    def doubted(self) -> bool:
        """Whether something seems to have changed."""
        return self.finding is not None

    @property
    def rate(self) -> float:
        """Movement of the output that nothing explains, in its unit per second."""
        return self._changes.push_rate

    def restart(self, *, offset: bool = False) -> None:
        """Begin anew behind a gap or a fault; `offset`: the reading may be off from now on."""
        self._changes.restart(offset=offset)
        self._told = None
        self._forget_doubt()

    def forget(self) -> None:
        """Begin with a plant that was never seen."""
        self._changes = Changes(self._settings.followed, self._settings.period)
        self._told = None
        self._forget_doubt()

    def tell(self, index: int) -> None:
        """The finding is told now; from now on the plant is what it is since."""
        change = self._change
        assert change is not None and self.finding is not None  # noqa: S101, PT018 — it is what was found
        self._told = _Told(self.finding.fault, change.hypothesis, change.before, index)
        self._over = False
        if self.finding.fault is not Fault.DRIFT or change.hypothesis.kind is Kind.OTHER:
            self._changes.adopt()
            self._forget_doubt()

    def over(self, index: int) -> bool:
        """Whether what was told is over: undone, or how the plant is now."""
        if self._told is None:
            return True
        known = (index - self._told.at) * self._settings.period >= _ACCEPT
        if known or self._over:
            self._told = None
        return known or self._over

    def push(self, sample: Sample) -> None:
        """Take a sample."""
        change = self._changes.push(sample)
        if change is None:
            if not self._changes.suspected:
                self._over = self._told is not None and self._unnamed_now
                self._forget_doubt()
            return
        kind = change.hypothesis.kind
        self._running = self._running + 1 if self._change and self._change.hypothesis.kind is kind else 1
        self._change = change
        if not self._settled(change):
            self.finding = self._said(change, sample.index)

    def _forget_doubt(self) -> None:
        self.finding, self._change, self._running = None, None, 0
        self._unnamed_since = None

    @property
    def _unnamed_now(self) -> bool:
        return self._told is not None and self._told.fault is Fault.DRIFT

    def _settled(self, change: Change) -> bool:
        """Whether the change is none to be told: known all along, or the end or more of one that was told."""
        if change.gain < self._settings.change or self._running < _RUNNING:
            return False
        if not change.begun:
            self._changes.adopt()
            self._forget_doubt()
            return True
        told, h = self._told, change.hypothesis
        same = told is not None and told.hypothesis.index == h.index
        if not same and h.parameter:
            return False
        usual = told.before if told is not None and same else 0.0
        left = change.value - usual
        if abs(left) <= max(_BACK * max(abs(change.shift), abs(change.before - usual)), h.least):
            self._over = self._over or same
        elif not same or change.lead < self._settings.lead:
            return False
        self._changes.adopt()
        self._forget_doubt()
        return True

    def _said(self, change: Change, index: int) -> Finding:
        """The finding that a change amounts to."""
        h, settings = change.hypothesis, self._settings
        enough = self._running >= _RUNNING and change.gain >= settings.change and change.begun
        material = abs(change.shift) >= h.least
        named = change.lead >= settings.lead and h.kind is not Kind.OTHER
        if h.kind is Kind.DRIVE and not settings.lost - 1.0 <= change.shift < 0.0:
            named = False  # a lost drive is told otherwise, and one that does more has no name
        if h.kind is Kind.SENSOR and not any(rival in (Kind.ROOM, Kind.LOSSES) for rival in change.rivals):
            named = False  # where nothing says what other surroundings do, they do what the sensor would
        if named:
            reason = f"{self._described(change)}: look at {self._where(h.kind)}"
            return Finding(_NAMES[h.kind], enough and material, change.first, reason, slow=True)
        if enough and self._unnamed_since is None:
            self._unnamed_since = index
        waited = self._unnamed_since is not None and (
            (index - self._unnamed_since) * settings.period >= _STILL_UNNAMED
        )
        sure = enough and material and waited and change.gain >= _UNNAMED * settings.change
        return Finding(Fault.DRIFT, sure, change.first, self._either(change), slow=True)

    def _either(self, change: Change) -> str:
        """A sentence for a change that the samples do not name."""
        gains = zip(change.rivals, change.gains, strict=True)
        near = [_ASKED[kind] for kind, gain in gains if gain > change.gain - self._settings.lead]
        names = [_ASKED[change.hypothesis.kind], *near]
        listed = " or ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} or {names[-1]}"
        return (
            f"the plant does something else than before; {listed} may have changed, which these readings "
            f"do not tell apart: {self._words.surroundings}"
        )

    def _where(self, kind: Kind) -> str:
        if kind is Kind.DRIVE:
            return "drive, wires and supply"
        if kind is Kind.SENSOR:
            return self._words.sensor.removeprefix("look at ")
        return self._words.surroundings.removeprefix("look at ")

    def _described(self, change: Change) -> str:
        """What has changed, and by how much."""
        h, words = change.hypothesis, self._words
        if h.kind is Kind.DRIVE:
            return f"the drive does {1.0 + change.value:.0%} of what it should to {words.output}"
        if h.kind is Kind.SENSOR:
            return (
                f"the readings of {words.output} are {signed(change.shift)}{words.unit} from what they were"
            )
        declared = self._settings.followed.model.declared[h.parameter]
        if h.kind is Kind.LOSSES:
            factor = math.exp(change.shift)
            return f"the losses are {factor:.2g} times what they were ({declared.text})"
        unit = f" {declared.unit}".rstrip()
        return f"the {declared.text} is {signed(change.shift)}{unit} from what it was"
