"""The twin in a thread of its own, so that a match delays no sample."""

from __future__ import annotations

from collections.abc import Sequence
from queue import Empty, SimpleQueue
from typing import Final, NamedTuple

import numpy as np

from twinmatch.comparing import Candidate
from twinmatch.defects import without_what_fails
from twinmatch.forecasting import Forecast
from twinmatch.links import Background
from twinmatch.signals import Sample
from twinmatch.twin import Mirror, MirrorState, Outcome, Snapshot, Twin, TwinSettings


class Judged(NamedTuple):
    """A sample and what the twin made of it."""

    sample: Sample
    outcome: Outcome
    stamps: dict[int, int]
    """Stamps of the samples behind the match and the verdicts, ns, by index."""
    mirror: MirrorState | None
    """None: a defect prevented it."""
    forecast: Forecast | None


class Judging(Background):
    """A twin that takes samples in a thread."""

    _WAIT: Final = 0.2
    """Longest wait for a sample, s."""
    LEAVE: Final = 5.0
    """Longest time to judge at the end what has been sampled, s."""

    def __init__(
        self, settings: TwinSettings, candidates: Sequence[Candidate], *, shown: bool
    ) -> None:
        """Start. `shown`: whether forecasts are wanted too."""
        self.judged: SimpleQueue[Judged] = SimpleQueue()
        self.snapshot = Snapshot()
        """The newest, from which questions are answered; only where forecasts are wanted."""
        self._samples: SimpleQueue[Sample] = SimpleQueue()
        self._twin = Twin(settings, candidates)
        self._shown = shown
        self._mirror = Mirror(
            settings.start,
            settings.law,
            period=settings.period,
            scale=settings.forecasts.scale,
        )
        super().__init__("twin", self._run, self.LEAVE)
        self.start()

    def push(self, sample: Sample) -> None:
        """Take a sample; what the twin makes of it comes into `judged`."""
        self._samples.put(sample)

    def _run(self) -> None:
        while not self.ending.is_set():
            try:
                sample = self._samples.get(timeout=self._WAIT)
            except Empty:
                continue
            self.judged.put(self._judge(sample))

    def _judge(self, sample: Sample) -> Judged:
        outcome = self._twin.push(sample)
        stamp_of = self._twin.discriminator.stamps
        judged_samples = {verdict.sample for verdict in outcome.verdicts}
        judged_samples |= {outcome.match.sample} if outcome.match is not None else set()
        stamps = {index: stamp_of.get(index, 0) for index in judged_samples}
        mirror = None
        forecast = None
        with without_what_fails(
            "a sample could not be shown", self._twin.discriminator.defects
        ):
            for settled in outcome.settled:
                mirror = self._mirror.push(settled)
            forecast = self._forecast()
        return Judged(sample, outcome, stamps, mirror, forecast)

    def _forecast(self) -> Forecast | None:
        """The leader's forecast, where it is wanted; the mirror takes its parameters."""
        forecaster = self._twin.discriminator.forecaster
        leading = forecaster.standings.leading
        if leading is not None and leading.parameters is not self._mirror.parameters:
            self._mirror.parameters = leading.parameters
        if leading is None or not self._shown:
            return None
        self.snapshot = forecaster.snapshot()
        outlook = self.snapshot.outlook()
        return outlook.forecast(
            np.tile(outlook.standing, (max(forecaster.horizons), 1))
        )
