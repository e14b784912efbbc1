"""A twin on trial: tracked beside the followed one until it has predicted the plant far better."""

from __future__ import annotations

from typing import Final

from twinmatch.health.changes import ChangeDetector
from twinmatch.health.settings import HealthSettings
from twinmatch.health.tracking import REACH
from twinmatch.signals import Sample

_FAR: Final = 40.0
"""Nats by which it has to save code length: far more than two good twins differ by, so that nothing jumps."""
_LONGEST: Final = 3 * REACH
"""Blocks after which a trial without a winner ends."""


class TwinOnTrial:
    """Compares a twin with the followed one, on readings that neither was fitted to.

    A twin that wins has followed the plant for as long as a change has to be seen, so that a fault is found
    at once.
    """

    def __init__(
        self, settings: HealthSettings, against: ChangeDetector, *, steps: bool
    ) -> None:
        """Begin with the settings' twin, where a block begins; `steps` as in `hypotheses`."""
        self.settings = settings
        self.detector = ChangeDetector(settings.followed, settings.period, steps=steps)
        self._other = against.tracked
        self._until = against.tracked.count + _LONGEST
        self._lead_before = 0.0  # nats that it was ahead before it could compare causes
        self._lead = 0.0  # nats by which it has been better since

    def push(self, sample: Sample) -> None:
        """Take a sample that the other has taken."""
        self.detector.push(sample)
        lead = self._other.spent - self.detector.tracked.spent
        if not self.detector.compares:
            self._lead_before = lead
        self._lead = lead - self._lead_before

    @property
    def won(self) -> bool:
        """Whether it has proven to be far better, and is known well enough to say what it suspects."""
        return (
            self._lead > _FAR
            and self.detector.compares
            and self.detector.track_record.earned
        )

    @property
    def lost(self) -> bool:
        """Whether nothing is to be expected of it."""
        return self._lead < -_FAR or self._other.count > self._until
