"""Experiments on a running plant: courses that are kept, judged again, and end."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.control import Loop, Profile
from twinmatch.controllers import ControllerError
from twinmatch.dynamics import advance, begin, readings
from twinmatch.plants import Peltier
from twinmatch.signals import Sample
from twinmatch.twin import Snapshot, Twin, TwinSettings
from twinmatch.twin.experiment import (
    ExperimentError,
    ExperimentPhase,
    ExperimentReport,
    Wish,
)
from twinmatch.twin.live_experiment import LiveExperiment

TAUGHT = 600
HIGHEST = 70.0
"""Samples before an experiment, and the controller's highest set-point, °C."""
SETTINGS = TwinSettings.of(Peltier)


class Rig:
    """A simulated rig in its loop, followed by its twin."""

    def __init__(self) -> None:
        self.truth = Peltier.model("sink with mass, free ambient").parameters()
        self.twin = Twin(SETTINGS)
        self.loop = Loop(Peltier)
        self.random = np.random.default_rng(1)
        self.states = begin(self.truth, [23.0])
        self.k = 0
        self.verdict: Verdict | None = None

    def sample(self, level: Callable[[float], float], begun: float = 0.0) -> Sample:
        noisy = readings(self.truth, self.states) + 0.1 * self.random.standard_normal(1)
        self.loop.measure(tuple(noisy.tolist()), self.k * 10**9)
        sample = self.loop.tick(self.k * 10**9, lambda at: level(at - begun))
        assert sample is not None
        self.states = advance(self.truth, self.states, np.array(sample.inputs), 1.0)
        self.k += 1
        verdicts = self.twin.push(sample).verdicts
        self.verdict = verdicts[-1] if verdicts else None
        return sample

    @property
    def snapshot(self) -> Snapshot:
        return self.twin.discriminator.forecaster.snapshot()


@pytest.fixture(scope="module")
def run() -> tuple[list[ExperimentReport], list[Sample], Snapshot, Rig]:
    """An experiment on parameters from beginning to end: its reports, its samples, where it began."""
    rig = Rig()
    for _ in range(TAUGHT):
        rig.sample(lambda at: 30.0 if at < 300.0 else 45.0)
    before = rig.snapshot
    live = LiveExperiment(
        SETTINGS, Wish("parameters", 4.0, ranges=((20.0, HIGHEST),)), before
    )
    reports = [live.report, live.run()]
    samples = []
    while reports[-1].phase is ExperimentPhase.RUNNING:
        newest_report = reports[-1]
        course = Profile(
            newest_report.levels,
            newest_report.holds,
            lowest=0.0,
            highest=90.0,
            unit="°C",
        )
        begun = rig.loop.time
        while True:
            samples.append(rig.sample(course.reference, begun))
            live.push(samples[-1])
            if rig.verdict is not None:
                break
        reports.append(live.judged(rig.verdict, rig.snapshot))
    return reports, samples, before, rig


Run = tuple[list[ExperimentReport], list[Sample], Snapshot, Rig]


def test_it_is_proposed_runs_and_ends(run: Run) -> None:
    """With as much as was expected, or when its time is over; and by itself where it began."""
    reports, samples, *_ = run
    assert [r.phase for r in reports[:2]] == [
        ExperimentPhase.PROPOSED,
        ExperimentPhase.RUNNING,
    ]
    assert reports[-1].phase in {ExperimentPhase.DECIDED, ExperimentPhase.ENDED}
    assert all(
        r.levels[-1] == 45.0 and len(r.levels) == len(r.holds) for r in reports[:-1]
    )
    assert all(20.0 <= level <= HIGHEST for r in reports for level in r.levels)
    assert len(samples) <= 240 + 60  # its time, and the wait for a verdict
    assert reports[-1].reason.endswith(f"{reports[-1].expected:.3g} were expected")
    assert max(s.output for s in samples) < Peltier.output.safe[1]


def test_what_it_brings_grows_and_is_about_what_was_expected(run: Run) -> None:
    """Commands hardly depend on what was unknown, so that the information predicted is what comes; the loop
    itself changes on the way, which half allows for."""
    reports, *_ = run
    brought = [r.brought for r in reports[1:]]
    assert brought == sorted(brought)
    assert brought[-1] == pytest.approx(reports[0].expected, rel=0.5)


def test_a_course_is_kept_unless_another_is_better(run: Run) -> None:
    """Of two reports in a row the second has the rest of the first, or brings a character more."""
    reports, *_ = run
    keeps_course = [set(b.levels) <= set(a.levels) for a, b in pairwise(reports[1:-1])]
    assert keeps_course
    assert sum(keeps_course) >= len(keeps_course) / 2


def test_it_ends_with_a_fault_and_with_lost_samples(run: Run) -> None:
    *_, before, rig = run
    assert rig.verdict is not None
    sick = replace(
        rig.verdict, level=TrustLevel.FAULT, level_reason="the plant shows drive-lost"
    )
    live = LiveExperiment(SETTINGS, Wish("parameters", 2.0), before)
    live.run()
    assert live.judged(sick, before).reason.startswith(
        "stopped: the plant shows drive-lost; it brought 0 "
    )
    live = LiveExperiment(SETTINGS, Wish("parameters", 2.0), before)
    live.run()
    for k in (0, 1, 3):
        live.push(Sample(TAUGHT + k, 0, 45.0, 45.0, 100.0))
    healthy = replace(rig.verdict, level=TrustLevel.TRUSTED)
    ended = live.judged(healthy, before)
    assert ended.phase is ExperimentPhase.ENDED
    assert ended.reason.startswith("stopped: samples are missing")


def test_structures_of_the_family_are_told_apart(run: Run) -> None:
    """The simulated truth is one of them: its own readings decide for it, or for one that can be it."""
    *_, before, _ = run
    live = LiveExperiment(SETTINGS, Wish("structure"), before)
    assert live.goal.pairs
    assert live.report.expected > 1.0


def test_what_cannot_be_run_is_said(run: Run) -> None:
    *_, before, _ = run
    open_loop = replace(SETTINGS, law=None)
    for settings, wish, words in (
        (open_loop, Wish("parameters"), "the law of the loop is not known"),
        (
            SETTINGS,
            Wish("parameters", 0.1),
            "6 samples of 1 s; give 30 to 20000 of them",
        ),
        (SETTINGS, Wish("parameters", within=(150.0, 160.0)), "give LOW below HIGH"),
        (SETTINGS, Wish("fault"), "is not confused with it"),
    ):
        with pytest.raises(ControllerError, match=words):
            LiveExperiment(settings, wish, before)
    with pytest.raises(ExperimentError, match="the lower one first"):
        Wish("parameters", within=(50.0, 40.0))
    assert math.isnan(ExperimentReport(0, ExperimentPhase.REFUSED, "", 0).expected)
