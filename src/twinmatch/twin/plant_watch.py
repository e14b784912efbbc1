"""The plant's health at every sample, judged by a monitor that may have to start over."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from twinmatch.comparing import Candidate
from twinmatch.dynamics import Parameters
from twinmatch.health import Alarm, Health, Monitor
from twinmatch.signals import Sample
from twinmatch.twin.settings import TwinSettings

if TYPE_CHECKING:
    from twinmatch.health.channels import ChannelMonitor

__all__ = ["PlantWatch"]


class PlantWatch:
    """Watches the plant's health; a fault that is on outlasts the monitor that found it."""

    def __init__(self, settings: TwinSettings) -> None:
        """Begin without samples."""
        self._settings = settings
        self.monitor = _monitor(settings)
        self.health: Health | None = None
        """The plant's health at the newest sample; None before the first."""
        self._fault_before: Health | None = None
        """The fault that was on when the monitor had to start over; it counts until another one is seen."""
        self._steps_recurred = False
        """Whether steps that were refused had recurred by the newest sample."""

    @property
    def news(self) -> Alarm | None:
        """An alarm that has begun or ended at the newest sample."""
        return self.health.news if self.health is not None else None

    @property
    def fault_in_words(self) -> str:
        """The fault that is on, in words; empty without one."""
        health = self.health
        if health is None or health.confirmed_fault is None:
            return ""
        fault = health.confirmed_fault.value
        return f"the plant has shown {fault} since sample {health.since}"

    def start_over(self) -> None:
        """Watch without a past, after a defect; a fault that is on stays on."""
        if self.health is not None and self.health.confirmed_fault is not None:
            self._fault_before = self.health
        self.monitor = _monitor(self._settings)

    def begin_session(self) -> None:
        """Watch another session, to which the indices of the alarms so far do not belong."""
        self._fault_before = None
        self.monitor = _monitor(self._settings)

    def push(
        self, sample: Sample, nominal: Candidate | None, *, steps_recur: bool
    ) -> None:
        """Judge the plant at a sample.

        `nominal` is the nominal candidate. `steps_recur`: whether steps that were refused have recurred, so
        that they are the plant's; once they do, the fault of impossible readings is taken back.
        """
        parameters = self._sound_parameters(nominal)
        has_begun_to_recur = steps_recur and not self._steps_recurred
        if has_begun_to_recur and isinstance(self.monitor, Monitor):
            self.monitor.withdraw()
        self._steps_recurred = steps_recur
        health = self.monitor.push(sample, parameters)
        if health.confirmed_fault is not None:
            self._fault_before = None
        self.health = (
            health
            if self._fault_before is None
            else replace(self._fault_before, news=health.news)
        )

    def _sound_parameters(self, nominal: Candidate | None) -> Parameters | None:
        """The nominal candidate's parameters; None if it was fitted to samples of a plant at fault."""
        if nominal is None:
            return None
        fault = self.monitor.fault_between(*nominal.samples, slow=True)
        return nominal.parameters if fault is None else None

    def is_at_fault(self, first: int, last: int) -> bool:
        """Whether the plant was at fault between two samples, or a sensor lied, as far as that is known now."""
        return (
            self.monitor.fault_between(first, last) is not None
            or self.monitor.lie_between(first, last) is not None
        )

    @property
    def first_after_fault(self) -> int:
        """The first sample behind the newest fault that altered the plant; 0 without one, or while it is on."""
        alarms = [alarm for alarm in self.monitor.alarms if alarm.alters]
        last = alarms[-1].last if alarms else None
        return 0 if last is None else last + 1


def _monitor(settings: TwinSettings) -> Monitor | ChannelMonitor:
    """Watches a plant with one loop as a whole, any other channel by channel."""
    health = replace(settings.health, period=settings.period)
    if settings.plant.single:
        return Monitor(health)
    from twinmatch.health.channels import ChannelMonitor  # noqa: PLC0415

    return ChannelMonitor(health.followed, health.period)
