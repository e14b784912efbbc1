"""What a run has come to so far: its settled samples and its verdicts, and the summary of both."""

from __future__ import annotations

from collections.abc import Iterable

from twinmatch.comparing import Verdict
from twinmatch.offline.summary import SessionSummary, Tally, conclude
from twinmatch.sessions.spool import SampleSpool
from twinmatch.showing.summary import closing_lines
from twinmatch.signals import Sample, Window
from twinmatch.twin import TwinSettings


class RunResults:
    """The results of a run, which may last for weeks: its samples are kept on disk."""

    def __init__(self) -> None:
        """Start without samples and verdicts."""
        self.samples = SampleSpool()
        """The usable samples, with stand-ins for lost and refused ones."""
        self.tally = Tally()

    def close(self) -> None:
        """Drop the samples."""
        self.samples.close()

    def restart_samples(self) -> None:
        """Drop the samples, since the samples to come do not continue them."""
        self.samples.close()
        self.samples = SampleSpool()

    def take_settled(self, settled: Iterable[Sample]) -> None:
        """Keep those of the settled samples that are usable."""
        for sample in settled:
            if sample.usable:
                self.samples.push(sample)

    def take_verdict(self, verdict: Verdict) -> None:
        """Count the next verdict."""
        self.tally.push(verdict)

    def longest(self, period: float) -> tuple[Window, int]:
        """The longest stretch between gaps that are too long to be filled, for a sample time (s); the number
        of stretches."""
        return self.samples.longest(period), self.samples.stretches

    def summary(self, settings: TwinSettings) -> SessionSummary | None:
        """Summarise the run of a twin with these settings; None if there was no usable sample."""
        if not len(self.samples):
            return None
        period = settings.period
        return conclude(
            self.tally, lambda: self.longest(period), settings.law, period=period
        )

    def closing_lines(self, summary: SessionSummary) -> list[str]:
        """The lines with which the run ends."""
        return closing_lines(summary, self.tally.last)
