"""An experiment on the running plant: its course, what it brings, and when it ends."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.controllers import (
    ControllerError,
    ExperimentTerms,
    Holding,
    LearningGoal,
    NextExperiment,
    bits_by,
    goal_named,
    next_experiment,
)
from twinmatch.controllers.courses import MIN_COURSE
from twinmatch.controllers.learning_goals import LEAD
from twinmatch.controllers.next_experiment import LEAST, NEARLY
from twinmatch.errors import TwinmatchError
from twinmatch.signals import FloatArray, Sample
from twinmatch.twin.experiment import ExperimentPhase, ExperimentReport, Wish
from twinmatch.twin.forecaster import Snapshot
from twinmatch.twin.matcher import one_thread
from twinmatch.twin.settings import TwinSettings
from twinmatch.twin.tried import tried_twins


class LiveExperiment:
    """A course of set-points for a plant that is followed by its twins, judged again with every verdict.

    What it brings is what its readings say: of contenders that are to be told apart, how much better the best
    predicted them than the next; of parameters, how much narrower they are.
    """

    def __init__(self, settings: TwinSettings, wish: Wish, snapshot: Snapshot) -> None:
        """Find the course that begins after the snapshot's sample.

        Raises:
            ControllerError: there is nothing to decide, or no course keeps to the range.
            ForecastError: there is no candidate yet.
        """
        self._settings = settings
        self._wish = wish
        newest = snapshot.outlook().sample
        self._first = newest.index + 1
        self.before = newest.references
        """The set-points until then, to which it returns."""
        self._samples: list[Sample] = []
        self._samples_planned_on = 0
        """How many samples there were when the newest course was found."""
        size = (
            None
            if wish.minutes is None
            else round(60.0 * wish.minutes / settings.period)
        )
        self._first_plan = self._newest_plan = self._planned(snapshot, size)
        self._expected = self._first_plan.course.bits
        self.report = self._reported(newest.index, ExperimentPhase.PROPOSED, 0.0)
        """The newest."""

    def push(self, sample: Sample) -> None:
        """Take a sample."""
        if sample.index >= self._first and sample.usable:
            self._samples.append(sample)

    def run(self) -> ExperimentReport:
        """The report of its start: the controller follows it from now on."""
        self.report = self._reported(self.report.sample, ExperimentPhase.RUNNING, 0.0)
        return self.report

    def ended(
        self, reason: str, phase: ExperimentPhase = ExperimentPhase.ENDED
    ) -> ExperimentReport:
        """The report of its end: the set-point returns to where it was."""
        last = self._samples[-1].index if self._samples else self.report.sample
        brought = self.brought
        sentence = f"{reason}; it brought {brought:.3g} bits, {self._expected:.3g} were expected"
        self.report = ExperimentReport(
            last,
            phase,
            self.goal.name,
            self._first,
            self._expected,
            brought,
            reason=sentence,
        )
        return self.report

    @property
    def goal(self) -> LearningGoal:
        """What is to be known."""
        return self._first_plan.goal

    @property
    def brought(self) -> float:
        """Bits that the samples so far have brought."""
        return self._lead[1]

    def judged(self, verdict: Verdict, snapshot: Snapshot) -> ExperimentReport:
        """What to do after a verdict: another course for the rest of its time, or the end."""
        best, brought = self._lead
        if brought >= self._enough:
            return self.ended(
                best or "as much is known as was expected", ExperimentPhase.DECIDED
            )
        if reason := self._replanned_unless_over(verdict, snapshot, brought):
            return self.ended(reason)
        self.report = self._reported(verdict.sample, ExperimentPhase.RUNNING, brought)
        return self.report

    def _replanned_unless_over(
        self, verdict: Verdict, snapshot: Snapshot, brought: float
    ) -> str:
        """Why it ends undecided; otherwise empty, and the best course for the rest is taken."""
        remaining = len(self._rest)
        indices = [s.index for s in self._samples]
        if verdict.level is TrustLevel.FAULT:
            return f"stopped: {verdict.level_reason}"
        if indices != list(range(self._first, self._first + len(indices))):
            return "stopped: samples are missing"
        if not remaining:
            return "its time is over"
        # as its contenders do, so that it is planned only once
        begins_at_rest = self.goal.name == "fault"
        if remaining < MIN_COURSE or begins_at_rest:
            return ""
        try:
            plan = self._planned(snapshot, remaining, self._rest)
        except TwinmatchError as error:
            return f"stopped: {error}"
        self._newest_plan = plan
        self._samples_planned_on = len(self._samples)
        self._expected = brought + plan.course.bits
        return "" if plan.course.bits >= LEAST else "its rest would tell nothing more"

    @property
    def _rest(self) -> FloatArray:
        """Set-points still to come, shape (N, r)."""
        return self._newest_plan.course.rows[
            len(self._samples) - self._samples_planned_on :
        ]

    @property
    def _enough(self) -> float:
        """Bits with which it is decided."""
        return (
            LEAD / math.log(2.0)
            if self.goal.pairs
            else NEARLY * self._first_plan.course.bits
        )

    @property
    def _lead(self) -> tuple[str, float]:
        """The best of contenders that are to be told apart, and the bits that samples have brought."""
        if not self._samples:
            return "", 0.0
        outputs = np.array([sample.outputs for sample in self._samples])
        inputs = np.array([sample.inputs for sample in self._samples])
        with one_thread():
            bits = bits_by(self._first_plan, outputs, inputs)
        if not self.goal.pairs:
            return "", float(bits.mean())
        second_best, best = np.sort(bits)[-2:]
        return self.goal.label(int(bits.argmax())), float(best - second_best)

    def _planned(
        self, snapshot: Snapshot, size: int | None, rest: FloatArray | None = None
    ) -> NextExperiment:
        settings = self._settings
        members = tried_twins(snapshot)
        if settings.law is None:
            raise ControllerError(
                "experiment: the law of the loop is not known, so its set-points are not either"
            )
        holding = Holding(settings.law, settings.period, settings.schedule.span)
        terms = ExperimentTerms.of(
            settings.plant,
            holding,
            np.array(self.before),
            size=size,
            within=self._wish.within,
            ranges=self._wish.ranges,
        )
        with one_thread():
            goal = goal_named(self._wish.goal, members, terms)
            return next_experiment(members, goal, terms, running=rest)

    def _reported(
        self, sample: int, phase: ExperimentPhase, brought: float
    ) -> ExperimentReport:
        levels: list[float] = []
        holds = []
        for level, run in groupby(map(tuple, self._rest.tolist())):
            levels += level
            holds.append(len(list(run)) * self._settings.period)
        # If no program is left at its end, the set-point still returns.
        levels += self.before
        holds.append(self._settings.period)
        return ExperimentReport(
            sample,
            phase,
            self.goal.name,
            self._first,
            self._expected,
            brought,
            tuple(levels),
            tuple(holds),
            reason=_beside(self._newest_plan),
        )


def _beside(found: NextExperiment) -> str:
    """What a course brings, and what others of its length would, in words."""
    in_words = ", ".join(f"{course.name} {course.bits:.3g}" for course in found.others)
    return f"{found.course.bits:.3g} bits; in the same time {in_words}"
