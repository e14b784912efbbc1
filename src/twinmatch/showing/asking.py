"""What an operator asks of a running twin in a terminal: an experiment, or a law to be put on trial."""

from __future__ import annotations

import secrets
import sys
import time
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Final

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

from twinmatch.description import UNDESCRIBED
from twinmatch.nodes.messages import record_of
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.nodes.topics import LATCHED, RELIABLE
from twinmatch.parameters.declared import Setting
from twinmatch.safety import LawReport, TrialPhase
from twinmatch.showing.experiments import report_words
from twinmatch.twin.experiment import GOALS, LEAST, ExperimentPhase, ExperimentReport
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import ApplyLaw, Experiment, TryLaw

PATIENCE: Final = 5.0
"""Time after which a node that says nothing is missing, wall s; each reports once a second."""
TWIN: Final = "discriminator"
CONTROLLER: Final = "controller"
NAMES: Final[Mapping[str, str]] = {TWIN: "the twin", CONTROLLER: "the controller"}
"""The nodes that are needed, in words."""
TOPICS: Final[Mapping[str, str]] = {TWIN: "twin/law", CONTROLLER: "plant/law"}
"""A topic that each of them publishes: its publisher tells a node from the one that replaces it."""
NOTHING_DRIVES: Final = (
    "nothing drives: without its commands the bridge puts the output at zero"
)
ENDS: Final = {
    ExperimentPhase.DECIDED: 0,
    ExperimentPhase.ENDED: 3,
    ExperimentPhase.REFUSED: 1,
}
"""Exit codes of experiments."""
DECISIONS: Final = {"safe": 0, "fails": 1, "undecided": 3}
"""Exit codes of answers about a law."""


class Asking(TwinmatchNode):
    """Asks a service of the running twin, and prints what comes of it."""

    SERVICE: ClassVar[tuple[Any, str]]
    """Type and name of the service."""
    SERVER: ClassVar[str] = TWIN
    """The node that serves."""

    def open(self) -> None:
        """Find the service."""
        self._asked = False
        self._since = time.monotonic()
        """Since when an answer is awaited, wall s."""
        self._reported: dict[str, float] = {}
        """When each node reported last, wall s."""
        self._publishers: dict[str, frozenset[bytes]] = {}
        """The publishers of each node's topic when that node was first needed."""
        self.word = secrets.token_hex(8)
        """The word that every report on this request carries."""
        self._service = self.create_client(*self.SERVICE)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_health, 10)
        self.wall_timer(0.25, self._look)

    @property
    @abstractmethod
    def request(self) -> Any:
        """The first request to the service."""

    @property
    def needed(self) -> str:
        """The node without which nothing comes of the request now."""
        return self.SERVER

    def lost(self, node: str) -> str:  # noqa: ARG002
        """What drives the plant now that a node is lost, in words."""
        return "what drives is as it was"

    def ask(self, request: Any) -> None:
        """Send a request; why it is refused ends this."""
        self._since = time.monotonic()
        self._service.call_async(request).add_done_callback(self._on_answer)

    def end(self, code: int, words: str) -> None:
        """Print the result, and end with this exit code."""
        print(words, file=sys.stderr if code == 1 else sys.stdout, flush=True)
        self.exit_code = code

    def answered(self, message: str) -> None:
        """Take what a service that did not refuse says."""

    def _look(self) -> None:
        """Ask once the service is there; then end if the node that is needed says nothing any longer."""
        node = self.needed
        if self.exit_code is not None:
            return
        if self._asked:
            silent = time.monotonic() - max(self._since, self._reported.get(node, 0.0))
            if silent > PATIENCE:
                words = f"{NAMES[node]} has said nothing for {PATIENCE:g} s; {self.lost(node)}"
                self.end(1, f"{self.NAME}: {words}")
            elif self._ended(node):
                self.end(1, f"{self.NAME}: {NAMES[node]} has ended; {self.lost(node)}")
        elif self._service.service_is_ready():
            self._asked = True
            self.ask(self.request)
        elif time.monotonic() - self._since > PATIENCE:
            server = NAMES[self.SERVER].removeprefix("the ")
            service = self._service.srv_name
            self.end(
                1,
                f"{self.NAME}: no {server} runs here (no service {service}); start live",
            )

    def _ended(self, node: str) -> bool:
        """Whether a node has ended; another in its place would know of no request."""
        infos = self.get_publishers_info_by_topic(TOPICS[node])
        publishers = frozenset(
            bytes(info.endpoint_gid) for info in infos if info.node_name == node
        )
        before = self._publishers.get(node, frozenset())
        if not before:
            self._publishers[node] = publishers
        return bool(before) and not publishers & before

    def _on_health(self, message: DiagnosticArray) -> None:
        """Note who reports; of several graphs on this machine only this namespace counts."""
        space = self.get_namespace().strip("/")
        for status in message.status:
            name = status.name.split(":")[0]
            node = name.removeprefix(f"{space}/") if space else name
            self._reported[node] = time.monotonic()

    def _on_answer(self, future: Any) -> None:
        answer = future.result()
        if answer.success:
            self.answered(answer.message)
        else:
            self.end(1, f"{self.NAME}: {answer.message}")


class ExperimentAsking(Asking):
    """Asks for an experiment, and follows one that runs."""

    NAME = "experiment"
    SERVICE = (Experiment, "twin/experiment")
    PARAMETERS = (
        Setting(
            "goal",
            "",
            "What is to be known; empty: the first that is undecided.",
            choices=("", *GOALS),
        ),
        Setting(
            "minutes",
            0.0,
            "Longest course; 0: in proportion to the plant.",
            "min",
            0.0,
            1e4,
        ),
        Setting(
            "within",
            "",
            "Lowest and highest value of every output, with a space between.",
        ),
        Setting("run", False, "Whether the controller is to follow it."),
    )

    def open(self) -> None:
        """Find the twin, and subscribe to its reports."""
        self._described = UNDESCRIBED
        self._follows = False
        self.create_subscription(
            messages.PlantDescription, "plant/description", self._on_plant, LATCHED
        )
        self.create_subscription(
            messages.ExperimentReport, "twin/experiment", self._on_report, RELIABLE
        )
        super().open()

    @property
    def request(self) -> Experiment.Request:
        """The experiment of the parameters."""
        values = self.values
        within = [float(limit) for limit in values["within"].split()]
        return Experiment.Request(
            goal=values["goal"],
            minutes=values["minutes"],
            within=within,
            run=values["run"],
            request=self.word,
        )

    @property
    def needed(self) -> str:
        """The twin; once the controller is silent that follows the course, the controller.

        Without its samples the twin says nothing of the experiment.
        """
        silent = time.monotonic() - self._reported.get(CONTROLLER, self._since)
        return CONTROLLER if self._follows and silent > PATIENCE else TWIN

    def lost(self, node: str) -> str:
        """What drives the plant now that a node is lost, in words."""
        if node == CONTROLLER:
            return NOTHING_DRIVES
        if self._follows:
            return "the controller follows the course to its end, the set-point before it, and stays there"
        return "the controller has not been asked for a course"

    def close(self) -> bool:
        """Stop an experiment that is sought or followed, since the one who asked has gone."""
        if (
            self._asked and self.values["run"] and self.exit_code is None
        ) or self._follows:
            self._service.call_async(Experiment.Request(stop=True))
            time.sleep(0.3)  # the request leaves this process
        return super().close()

    def _on_plant(self, message: messages.PlantDescription) -> None:
        self._described = record_of(message)

    def _on_report(self, report: ExperimentReport) -> None:
        if report.request != self.word:
            return
        self._follows = report.phase is ExperimentPhase.RUNNING
        words = report_words(report, self._described)
        proposed = report.phase is ExperimentPhase.PROPOSED
        if proposed and not self.values["run"]:
            self.end(0 if report.expected >= LEAST else 3, words)
        elif report.phase in ENDS:
            self.end(ENDS[report.phase], words)
        elif not proposed:
            print(f"{report.sample}: {words}", flush=True)


class ProfileAsking(Asking):
    """Has the controller continue its profile, which has waited since an experiment."""

    NAME = "experiment"
    SERVICE = (SetParametersAtomically, "controller/set_parameters_atomically")
    SERVER = CONTROLLER

    @property
    def request(self) -> SetParametersAtomically.Request:
        """The request that the controller follows no course."""
        not_followed = Parameter("course.followed", value=False).to_parameter_msg()
        return SetParametersAtomically.Request(parameters=[not_followed])

    def _on_answer(self, future: Any) -> None:
        result = future.result().result
        if result.successful:
            self.end(0, "the controller's profile continues where it was")
        else:
            self.end(1, f"{self.NAME}: {result.reason}")


class LawAsking(Asking):
    """Asks whether a law may be run now and, by the operator's word, has the controller try it."""

    NAME = "apply"
    SERVICE = (TryLaw, "twin/try_law")
    PARAMETERS = (
        Setting("law", "", "The law: a JSON document of kind pid."),
        Setting("although", False, "Run it although it is not safe."),
        Setting(
            "shadow",
            0.0,
            "Time beside the law that runs before it drives.",
            "s",
            0.0,
            1e5,
        ),
        Setting("yes", False, "Do not ask again."),
    )

    def open(self) -> None:
        """Find the twin, and subscribe to its reports and the controller's."""
        self._runs = False
        self._drives: TrialPhase | None = None
        """What the controller has said last of a law on trial, also of one that others asked for."""
        self._begun = False
        """Whether the controller has reported on the law of this request."""
        self.create_subscription(
            messages.LawReport, "twin/law", self._on_twin, RELIABLE
        )
        self.create_subscription(
            messages.LawReport, "plant/law", self._on_controller, LATCHED
        )
        super().open()

    @property
    def request(self) -> TryLaw.Request:
        """The question whether the law may be run, without running it."""
        return TryLaw.Request(law=self.values["law"], request=self.word)

    @property
    def needed(self) -> str:
        """The twin until the trial begins, from then on the controller alone."""
        return CONTROLLER if self._begun else TWIN

    def lost(self, node: str) -> str:
        """What drives the plant now that a node is lost, in words."""
        if node == CONTROLLER:
            return NOTHING_DRIVES
        if self._drives is TrialPhase.DRIVING:
            return "a law on trial drives, and the controller watches it"
        if self._drives is TrialPhase.KEPT:
            return "nothing was run, and the law that was kept before drives"
        return "nothing was run, and the law before drives"

    def _on_twin(self, report: LawReport) -> None:
        if report.request != self.word:
            return
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
                    request=self.word,
                )
            )

    def _on_controller(self, report: LawReport) -> None:
        self._drives = report.phase
        if report.request != self.word:
            return
        self._begun = True
        self._since = time.monotonic()
        words = f"{report.sample}: {report.phase.value} {report.reason}".rstrip()
        if report.phase is TrialPhase.KEPT:
            self.end(
                0, f"{words}: it keeps driving; write its gains into the configuration"
            )
        elif report.phase is TrialPhase.BACK:
            self.end(1, f"{words}: the law before drives")
        else:
            print(words, flush=True)


class LawBack(Asking):
    """Has the controller give the law before back."""

    NAME = "apply"
    SERVICE = (ApplyLaw, "plant/apply_law")
    SERVER = CONTROLLER

    @property
    def request(self) -> ApplyLaw.Request:
        """The request for the law before the one on trial."""
        return ApplyLaw.Request(back=True)

    def answered(self, message: str) -> None:  # noqa: ARG002
        """End with success."""
        self.end(0, "the law before drives")


def _agreed() -> bool:
    """Whether the operator says yes, in a terminal."""
    return (
        sys.stdin.isatty()
        and input("run it, watched within its bands? [y/N] ").strip().lower() == "y"
    )
