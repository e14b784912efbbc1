"""Experiments on the running plant in words, and the node that asks for one in a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import Any, Final

from twinmatch.description import UNDESCRIBED, Description
from twinmatch.nodes.messages import description_from
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.topics import LATCHED, RELIABLE
from twinmatch.parameters.declared import Setting
from twinmatch.twin.experiment import GOALS, LEAST, ExperimentPhase, ExperimentReport
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import Experiment

PATIENCE: Final = 5.0
"""Time after which a twin that does not answer is missing, s."""
ENDS: Final = {ExperimentPhase.DECIDED: 0, ExperimentPhase.ENDED: 3, ExperimentPhase.REFUSED: 1}
"""Exit codes."""


def course_words(
    levels: Sequence[float], holds: Sequence[float], described: Description = UNDESCRIBED
) -> str:
    """Set-points and how long each is held, without the last, at which the plant rests afterwards."""
    of = described.references
    rows = list(zip(*[iter(levels)] * len(of), strict=True))
    return ", then ".join(
        f"{' and '.join(f'{v:.4g} {q.unit}'.rstrip() for v, q in zip(row, of, strict=True))} for {hold:.4g} s"
        for row, hold in zip(rows[:-1], holds, strict=False)
    )


def report_words(report: ExperimentReport, described: Description = UNDESCRIBED) -> str:
    """What an experiment has come to, in a sentence."""
    if not report.levels:
        return f"{report.phase.value}: {report.reason}"
    plan = course_words(report.levels, report.holds, described)
    so_far = f"{report.brought:.3g} of {report.expected:.3g} characters"
    brought = so_far if report.phase is ExperimentPhase.RUNNING else f"{report.expected:.3g} characters"
    return f"{report.phase.value}, for {report.goal}: {brought}; hold {plan} ({report.reason})"


class Asking(TwinmatchNode):
    """Asks a running twin for an experiment, prints what comes of it, and follows one that runs."""

    NAME = "experiment"
    PARAMETERS = (
        Setting("goal", "", "What is to be known; empty: the first that is undecided.", choices=("", *GOALS)),
        Setting("minutes", 0.0, "Longest course; 0: in proportion to the plant.", "min", 0.0, 1e4),
        Setting("within", "", "Lowest and highest value of every output, with a space between."),
        Setting("run", False, "Whether the controller is to follow it."),
    )

    def open(self) -> None:
        """Find the twin."""
        self._described, self._until, self._asked = UNDESCRIBED, time.monotonic() + PATIENCE, False
        self._follows = False
        self._service = self.create_client(Experiment, "twin/experiment")
        self.create_subscription(messages.PlantDescription, "plant/description", self._on_plant, LATCHED)
        self.create_subscription(messages.ExperimentReport, "twin/experiment", self._on_report, RELIABLE)
        self.wall_timer(0.1, self._ask)

    def close(self) -> bool:
        """Stop an experiment that is followed, since the one who asked has gone."""
        if self._follows:
            self._service.call_async(Experiment.Request(stop=True))
            time.sleep(0.3)  # the request leaves this process
        return super().close()

    def _ask(self) -> None:
        if self._asked:
            return
        if self._service.service_is_ready() and self.count_publishers("twin/experiment"):
            values, self._asked = self.values, True
            within = [float(each) for each in values["within"].split()]
            request = Experiment.Request(
                goal=values["goal"], minutes=values["minutes"], within=within, run=values["run"]
            )
            self._service.call_async(request).add_done_callback(self._on_answer)
        elif time.monotonic() > self._until:
            self._end(1, f"experiment: no twin runs here (no service {self._service.srv_name}); start one")

    def _on_answer(self, said: Any) -> None:
        answer = said.result()
        if not answer.success:
            self._end(1, f"experiment: {answer.message}")

    def _on_plant(self, message: messages.PlantDescription) -> None:
        self._described = description_from(message)

    def _on_report(self, report: ExperimentReport) -> None:
        self._follows = report.phase is ExperimentPhase.RUNNING
        proposed = report.phase is ExperimentPhase.PROPOSED
        if proposed and not self.values["run"]:
            self._end(0 if report.expected >= LEAST else 3, report_words(report, self._described))
        elif report.phase in ENDS:
            self._end(ENDS[report.phase], report_words(report, self._described))
        elif not proposed:
            print(f"{report.sample}: {report_words(report, self._described)}", flush=True)

    def _end(self, code: int, words: str) -> None:
        self._follows = False
        print(words, file=sys.stderr if code == 1 else sys.stdout, flush=True)
        self.exit_code = code
