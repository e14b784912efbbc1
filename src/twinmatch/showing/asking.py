"""What an operator asks of a running twin in a terminal: an experiment, or a law to be put on trial."""

from __future__ import annotations

import sys
import time
from abc import abstractmethod
from typing import Any, ClassVar, Final

from twinmatch.description import UNDESCRIBED
from twinmatch.nodes.messages import description_from
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.topics import LATCHED, RELIABLE
from twinmatch.parameters.declared import Setting
from twinmatch.safety import LawReport, TrialPhase
from twinmatch.showing.experiments import report_words
from twinmatch.twin.experiment import GOALS, LEAST, ExperimentPhase, ExperimentReport
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import ApplyLaw, Experiment, TryLaw

PATIENCE: Final = 5.0
"""Time after which a twin that does not answer is missing, s."""
ENDS: Final = {ExperimentPhase.DECIDED: 0, ExperimentPhase.ENDED: 3, ExperimentPhase.REFUSED: 1}
"""Exit codes of experiments …"""
DECISIONS: Final = {"safe": 0, "fails": 1, "undecided": 3}
"""… and of answers about a law."""


class Asking(TwinmatchNode):
    """Asks a service of the running twin, and prints what comes of it."""

    SERVICE: ClassVar[tuple[Any, str]]
    """Type and name."""

    def open(self) -> None:
        """Find the service."""
        self._until, self._asked = time.monotonic() + PATIENCE, False
        self._service = self.create_client(*self.SERVICE)
        self.wall_timer(0.1, self._find)

    @property
    @abstractmethod
    def request(self) -> Any:
        """What is asked first."""

    def ask(self, request: Any) -> None:
        """Send a request; why it is refused ends this."""
        self._service.call_async(request).add_done_callback(self._on_answer)

    def end(self, code: int, words: str) -> None:
        """Print the result, and end with this exit code."""
        print(words, file=sys.stderr if code == 1 else sys.stdout, flush=True)
        self.exit_code = code

    def answered(self, message: str) -> None:
        """Take what a service that did not refuse says."""

    def _find(self) -> None:
        if self._asked:
            return
        if self._service.service_is_ready():
            self._asked = True
            self.ask(self.request)
        elif time.monotonic() > self._until:
            self.end(1, f"{self.NAME}: no twin runs here (no service {self._service.srv_name}); start live")

    def _on_answer(self, said: Any) -> None:
        answer = said.result()
        if answer.success:
            self.answered(answer.message)
        else:
            self.end(1, f"{self.NAME}: {answer.message}")


class ExperimentAsking(Asking):
    """Asks for an experiment, and follows one that runs."""

    NAME = "experiment"
    SERVICE = (Experiment, "twin/experiment")
    PARAMETERS = (
        Setting("goal", "", "What is to be known; empty: the first that is undecided.", choices=("", *GOALS)),
        Setting("minutes", 0.0, "Longest course; 0: in proportion to the plant.", "min", 0.0, 1e4),
        Setting("within", "", "Lowest and highest value of every output, with a space between."),
        Setting("run", False, "Whether the controller is to follow it."),
    )

    def open(self) -> None:
        """Find the twin, and subscribe to its reports."""
        self._described, self._follows = UNDESCRIBED, False
        self.create_subscription(messages.PlantDescription, "plant/description", self._on_plant, LATCHED)
        self.create_subscription(messages.ExperimentReport, "twin/experiment", self._on_report, RELIABLE)
        super().open()

    @property
    def request(self) -> Experiment.Request:
        """The experiment of the parameters."""
        values = self.values
        within = [float(each) for each in values["within"].split()]
        return Experiment.Request(
            goal=values["goal"], minutes=values["minutes"], within=within, run=values["run"]
        )

    def close(self) -> bool:
        """Stop an experiment that is followed, since the one who asked has gone."""
        if self._follows:
            self._service.call_async(Experiment.Request(stop=True))
            time.sleep(0.3)  # the request leaves this process
        return super().close()

    def _on_plant(self, message: messages.PlantDescription) -> None:
        self._described = description_from(message)

    def _on_report(self, report: ExperimentReport) -> None:
        self._follows = report.phase is ExperimentPhase.RUNNING
        words, proposed = report_words(report, self._described), report.phase is ExperimentPhase.PROPOSED
        if proposed and not self.values["run"]:
            self.end(0 if report.expected >= LEAST else 3, words)
        elif report.phase in ENDS:
            self.end(ENDS[report.phase], words)
        elif not proposed:
            print(f"{report.sample}: {words}", flush=True)


class LawAsking(Asking):
    """Asks whether a law may be run now and, by the operator's word, has the controller try it."""

    NAME = "apply"
    SERVICE = (TryLaw, "twin/try_law")
    PARAMETERS = (
        Setting("law", "", "The law: a JSON document of kind pid."),
        Setting("although", False, "Run it although it is not safe."),
        Setting("shadow", 0.0, "Time beside the law that runs before it drives.", "s", 0.0, 1e5),
        Setting("yes", False, "Do not ask again."),
    )

    def open(self) -> None:
        """Find the twin, and subscribe to its reports and the controller's."""
        self._runs = False
        self.create_subscription(messages.LawReport, "twin/law", self._on_twin, RELIABLE)
        self.create_subscription(messages.LawReport, "plant/law", self._on_controller, RELIABLE)
        super().open()

    @property
    def request(self) -> TryLaw.Request:
        """The question alone."""
        return TryLaw.Request(law=self.values["law"])

    def _on_twin(self, report: LawReport) -> None:
        if report.phase is TrialPhase.REFUSED:
            self.end(1, f"apply: {report.reason}")
        elif not self._runs:
            print(report.reason, flush=True)
            allowed = report.decision == "safe" or self.values["although"]
            if not (allowed and (self.values["yes"] or _agreed())):
                self.end(DECISIONS[report.decision] if not allowed else 1, "not run")
                return
            self._runs = True
            values = self.values
            self.ask(
                TryLaw.Request(
                    law=values["law"],
                    run=True,
                    although=values["although"],
                    family=report.family,
                    shadow=values["shadow"],
                )
            )

    def _on_controller(self, report: LawReport) -> None:
        if not self._runs:
            return
        words = f"{report.sample}: {report.phase.value} {report.reason}".rstrip()
        if report.phase is TrialPhase.KEPT:
            self.end(0, f"{words}: it keeps driving; write its gains into the configuration")
        elif report.phase is TrialPhase.BACK:
            self.end(1, f"{words}: the law before drives")
        else:
            print(words, flush=True)


class LawBack(Asking):
    """Has the controller give the law before back."""

    NAME = "apply"
    SERVICE = (ApplyLaw, "plant/apply_law")

    @property
    def request(self) -> ApplyLaw.Request:
        """The law before."""
        return ApplyLaw.Request(back=True)

    def answered(self, message: str) -> None:  # noqa: ARG002
        """Done."""
        self.end(0, "the law before drives")


def _agreed() -> bool:
    """Whether the operator says yes, in a terminal."""
    return sys.stdin.isatty() and input("run it, watched within its bands? [y/N] ").strip().lower() == "y"
