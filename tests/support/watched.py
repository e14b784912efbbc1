"""Monitors beside simulated plants, which do not judge again what another one has judged.

Plants that break at different moments or in different ways are the same until then: a copy of the monitor
that has seen that part continues.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from twinmatch.dynamics import Parameters
from twinmatch.dynamics.store import Kernels
from twinmatch.dynamics.tracker import Tracker
from twinmatch.health import Health, HealthSettings, Monitor, Refusals
from twinmatch.health.changes import ChangeDetector
from twinmatch.health.earned import Record
from twinmatch.health.lagged_effect import ErrorModel
from twinmatch.signals import Sample


@dataclass
class Watched:
    """A monitor, what settles its samples, if anything does, and what it has said."""

    monitor: Monitor
    refusals: Refusals | None = None
    healths: list[Health] = field(default_factory=list)

    def push(self, sample: Sample) -> None:
        settled = sample if self.refusals is None else self.refusals.settle(sample)
        self.healths.append(self.monitor.push(settled))


_BLOCK = 150
"""A monitor is kept after each block of so many samples."""


@dataclass
class _Branch:
    """A monitor that has seen some samples and no more, and those that have seen one block more."""

    watched: Watched
    later: dict[tuple[Sample, ...], _Branch] = field(default_factory=dict)


_SEEN: dict[str, _Branch] = {}
"""Monitors of a kind that have seen nothing yet, and from there on all runs that were watched."""
_SHARED = (
    ErrorModel, Health, HealthSettings, Kernels, Parameters, Record, Sample, Tracker
)  # fmt: skip
"""Never change, and are shared by a monitor and its copies."""


def _without_courses(detector: ChangeDetector, memo: dict[int, Any]) -> ChangeDetector:
    """A copy that tracks each rival again: courses are functions with a state of their own, which `deepcopy`
    would share."""
    copy = object.__new__(ChangeDetector)
    memo[id(detector)] = copy
    copy.__dict__.update(
        {
            k: {} if k == "_courses" else deepcopy(v, memo)
            for k, v in vars(detector).items()
        }
    )
    return copy


@contextmanager
def _sharing() -> Iterator[None]:
    ways: dict[type, Any] = dict.fromkeys(_SHARED, lambda self, _memo: self)
    ways[ChangeDetector] = _without_courses
    for kind, way in ways.items():
        setattr(kind, "__deepcopy__", way)  # noqa: B010
    try:
        yield
    finally:
        for kind in ways:
            delattr(kind, "__deepcopy__")


def copied(watched: Any) -> Any:
    """A copy that shares what does not change."""
    with _sharing():
        return deepcopy(watched)


def watched(
    kind: str,
    begin: Callable[[], Watched],
    samples: Sequence[Sample],
    until: Callable[[Monitor], bool] = lambda _: False,
) -> Watched:
    """Watch samples, to the first after which something holds; `begin` gives the monitor of this kind."""
    samples = tuple(samples)
    if kind not in _SEEN:
        _SEEN[kind] = _Branch(begin())
    branch = _SEEN[kind]
    place = 0
    while samples[place : place + _BLOCK] in branch.later:
        branch = branch.later[samples[place : place + _BLOCK]]
        place += _BLOCK
    latest: Watched = copied(branch.watched)
    for count, sample in enumerate(samples[place:], place + 1):
        if until(latest.monitor):
            break
        latest.push(sample)
        if count % _BLOCK == 0:
            block = samples[count - _BLOCK : count]
            branch = branch.later.setdefault(block, _Branch(copied(latest)))
    return latest
