"""Experiments on the running plant: a service that seeks courses and has the controller follow them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python

from twinmatch.comparing import Verdict
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.desk import Desk, Newest, StampOf
from twinmatch.nodes.messages import message_of
from twinmatch.nodes.samples import TwinNode
from twinmatch.nodes.topics import LATCHED
from twinmatch.safety import Mover, Turn
from twinmatch.signals import Sample
from twinmatch.twin import Snapshot
from twinmatch.twin.experiment import (
    ExperimentError,
    ExperimentPhase,
    ExperimentReport,
    Wish,
)
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import Experiment

if TYPE_CHECKING:
    from twinmatch.twin.live_experiment import LiveExperiment

_PARAMETERS: Final = ("profile.lowest", "profile.highest", "reference_source")
"""Parameters of the controller that an experiment needs to know."""


def _by_output(value: Any) -> Sequence[float]:
    """The value of a parameter of the controller for each output; with one output it is a number."""
    return value if isinstance(value, Sequence) else [value]


class Experimenter(Desk):
    """Serves `twin/experiment`, and publishes there what comes of it.

    Courses are sought in a thread of their own, so that no verdict waits for them. A course that runs ends
    where the set-point was before, so that nobody has to live to end it, and the set-point stays there: the
    controller's profile waits for the operator. The guard acts as ever.
    """

    def __init__(
        self, node: TwinNode, newest: Newest, stamp_of: StampOf, turn: Turn
    ) -> None:
        """Create service and topic; as for a `Desk`."""
        super().__init__(node, newest, stamp_of, turn)
        self._live: LiveExperiment | None = None
        self._running = False
        self._is_seeking = False
        """Whether a request has not been answered yet."""
        self._request = ""
        """The word by which the newest request that was not refused at once is known to its sender."""
        self._reports = node.create_publisher(
            messages.ExperimentReport, "twin/experiment", LATCHED
        )
        self._get = node.create_client(GetParameters, "controller/get_parameters")
        self._set = node.create_client(
            SetParametersAtomically, "controller/set_parameters_atomically"
        )
        node.create_service(Experiment, "twin/experiment", self._on_request)

    def take(self, samples: Sequence[Sample], verdicts: Sequence[Verdict]) -> None:
        """Pass on what the twin has settled and judged."""
        if self._running or self._is_seeking:
            for sample in samples:
                self.put(partial(self._push, sample))
            for verdict in verdicts:
                self.put(partial(self._judge, verdict, self._newest()))

    def _on_request(
        self, request: Experiment.Request, _: Experiment.Response
    ) -> Experiment.Response:
        try:
            message = self._stop() if request.stop else self._begin(request)
        except TwinmatchError as error:
            return Experiment.Response(success=False, message=str(error))
        return Experiment.Response(success=True, message=message)

    def _stop(self) -> str:
        """End the experiment that runs; returns what happens now.

        Raises:
            ExperimentError: there is none.
        """
        if not (self._running or self._is_seeking):
            raise ExperimentError("no experiment runs")
        self.put(partial(self._end, "stopped by the operator"))
        return "the set-point returns to where it was, and stays there"

    def _begin(self, request: Experiment.Request) -> str:
        """Seek the course for a request; returns what happens now.

        Raises:
            ExperimentError: it is refused.
        """
        if self._running or self._is_seeking:
            raise ExperimentError(Mover.EXPERIMENT.value)
        if request.run and not self._set.service_is_ready():
            raise ExperimentError(
                f"no controller is here (no service {self._set.srv_name}): give these set-points yourself"
            )
        wish = Wish(
            request.goal or None, request.minutes or None, tuple(request.within) or None
        )
        if request.run and (why := self._turn.take(Mover.EXPERIMENT)):
            raise ExperimentError(why)
        self._is_seeking = True
        self._request = request.request
        self.put(partial(self._seek, wish, run=request.run))
        return "seeking; twin/experiment has what comes of it"

    def refuse(self, reason: str) -> None:
        """Report that nothing comes of a request, or that the experiment that runs has ended with this."""
        if self._running and self._live is not None:
            self._finish(self._live.ended(reason))
        else:
            self._is_seeking = False
            self._turn.give_back(Mover.EXPERIMENT)
            self._publish(
                ExperimentReport(0, ExperimentPhase.REFUSED, "", 0, reason=reason)
            )

    def _seek(self, wish: Wish, *, run: bool) -> None:
        """Find the course for a wish and, if it is to run, have the controller follow it."""
        newest = self._newest()
        of_controller = (
            self._parameters_of_controller()
            if run or self._get.service_is_ready()
            else {}
        )
        if (
            len(of_controller) == len(_PARAMETERS)
            and None not in of_controller.values()
        ):
            lowest = _by_output(of_controller["profile.lowest"])
            highest = _by_output(of_controller["profile.highest"])
            wish = replace(wish, ranges=tuple(zip(lowest, highest, strict=True)))
        if run and of_controller.get("reference_source") != "profile":
            raise ExperimentError(
                "experiment: the controller takes its set-points from a topic; give these levels there, or "
                "start it with reference_source: profile"
            )
        from twinmatch.twin.live_experiment import LiveExperiment  # noqa: PLC0415

        self._live = LiveExperiment(self._node.settings, wish, newest)
        self._running = run
        self._is_seeking = False  # the reader of the proposal may ask at once
        self._publish(self._live.report)
        if run:
            self._follow(self._live.run())

    def _parameters_of_controller(self) -> dict[str, Any]:
        """The values of `_PARAMETERS`, by name; None for one that the controller lacks.

        Raises:
            DeskError: it does not answer.
        """
        answer = self.answer_of(
            self._get, GetParameters.Request(names=list(_PARAMETERS))
        )
        values = [parameter_value_to_python(value) for value in answer.values]
        return dict(zip(_PARAMETERS, values, strict=False))

    def _judge(self, verdict: Verdict, snapshot: Snapshot) -> None:
        if self._running and self._live is not None:
            self._follow(self._live.judged(verdict, snapshot))

    def _push(self, sample: Sample) -> None:
        if self._live is not None:
            self._live.push(sample)

    def _end(self, reason: str) -> None:
        if self._running and self._live is not None:
            self._follow(self._live.ended(reason))

    def _follow(self, report: ExperimentReport) -> None:
        """Publish a report, and have the controller follow its course, or return to where it was."""
        if report.phase is ExperimentPhase.RUNNING:
            self._publish(report)
            self._command(list(report.levels), list(report.holds))
        else:
            self._finish(report)

    def _finish(self, report: ExperimentReport) -> None:
        """End the experiment that runs: the set-point returns to where it was, and stays there."""
        self._running = self._is_seeking = False
        try:
            if self._live is not None:
                self._command(list(self._live.before), [self._node.settings.period])
        except TwinmatchError as error:
            report = replace(
                report, reason=f"{report.reason}; the set-point is not back: {error}"
            )
        finally:
            self._turn.give_back(Mover.EXPERIMENT)
        self._publish(report)

    def _command(self, levels: list[float], holds: list[float]) -> None:
        """Have the controller follow a course of set-points, the last of which stays.

        Raises:
            ExperimentError: it refuses, or does not answer.
        """
        course = {
            "course.levels": levels,
            "course.holds": holds,
            "course.followed": True,
        }
        parameters = [
            Parameter(name, value=value).to_parameter_msg()
            for name, value in course.items()
        ]
        answer = self.answer_of(
            self._set, SetParametersAtomically.Request(parameters=parameters)
        )
        if not answer.result.successful:
            raise ExperimentError(f"the controller refuses: {answer.result.reason}")

    def _publish(self, report: ExperimentReport) -> None:
        self._newest_report = replace(report, request=self._request)
        self._node.health.set("experiment", f"{report.phase.value}: {report.reason}")
        self._node.publish(
            self._reports,
            message_of(self._newest_report, self._stamp_of(report.sample)),
        )
