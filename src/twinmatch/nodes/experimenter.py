"""Experiments on the running plant: a service that seeks courses and has the controller follow them."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python

from twinmatch.comparing import Verdict
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.messages import message_of
from twinmatch.nodes.node import Worker
from twinmatch.nodes.samples import TwinNode
from twinmatch.nodes.topics import LATCHED
from twinmatch.signals import Sample
from twinmatch.twin import Snapshot
from twinmatch.twin.experiment import ExperimentError, ExperimentPhase, ExperimentReport, Wish
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import Experiment

if TYPE_CHECKING:
    from twinmatch.twin.live_experiment import LiveExperiment

Newest = Callable[[], Snapshot]
StampOf = Callable[[int], int]

_PROFILE: Final = ("profile.levels", "profile.holds", "profile.repeat", "profile.ramp")
"""Parameters of the controller that an experiment sets, and gives back."""
_ASKED: Final = (*_PROFILE, "profile.lowest", "profile.highest", "reference_source")


class Desk:
    """Does what a service is asked for in a thread of its own, one job after the other."""

    def __init__(self, node: TwinNode, newest: Newest, stamp_of: StampOf) -> None:
        """Create the thread.

        `newest` returns the newest snapshot of all candidates, `stamp_of` the stamp of a sample, ns.
        """
        self._node, self._newest, self._stamp_of = node, newest, stamp_of
        self.busy: Callable[[], str] = str
        """Why nothing can be run now, since something else moves the plant; empty if it can."""
        self._jobs: deque[None] = deque()  # a mark for each that is not done
        self._worker: Worker[Callable[[], None]] = Worker(self._do, node.health)
        node.beside.append(self._worker)
        if node.step is not None:
            node.step.wait_for(lambda: bool(self._jobs))

    @abstractmethod
    def refuse(self, reason: str) -> None:
        """Report that nothing comes of a request."""

    def _put(self, work: Callable[..., None], *given: Any) -> None:
        self._jobs.append(None)
        self._worker.put(partial(work, *given))

    def _do(self, job: Callable[[], None]) -> None:
        try:
            job()
        except TwinmatchError as error:
            self.refuse(str(error))
        finally:
            self._jobs.pop()


class Experimenter(Desk):
    """Serves `twin/experiment`, and publishes there what comes of it.

    Courses are sought in a thread of their own, so that no verdict waits for them. A course that runs ends
    where the set-point was before, so that nobody has to live to end it. The guard acts as ever.
    """

    def __init__(self, node: TwinNode, newest: Newest, stamp_of: StampOf) -> None:
        """Create service and topic; as for a `Desk`."""
        super().__init__(node, newest, stamp_of)
        self._live: LiveExperiment | None = None
        self._running = False
        self._usual: Mapping[str, Any] = {}
        self._reports = node.create_publisher(messages.ExperimentReport, "twin/experiment", LATCHED)
        self._get = node.create_client(GetParameters, "controller/get_parameters")
        self._set = node.create_client(SetParametersAtomically, "controller/set_parameters_atomically")
        node.create_service(Experiment, "twin/experiment", self._on_request)

    @property
    def runs(self) -> str:
        """That an experiment runs, in words; empty if none does."""
        return "an experiment runs; stop it first" if self._running else ""

    def take(self, samples: Sequence[Sample], verdicts: Sequence[Verdict]) -> None:
        """Pass on what the twin has settled and judged."""
        if self._running or self._jobs:
            for sample in samples:
                self._put(self._push, sample)
            for verdict in verdicts:
                self._put(self._judge, verdict, self._newest())

    def _on_request(self, request: Experiment.Request, _: Experiment.Response) -> Experiment.Response:
        if why := self._against(request):
            return Experiment.Response(success=False, message=why)
        if request.stop:
            self._put(self._end, "stopped by the operator")
            return Experiment.Response(success=True, message="the set-point returns to where it was")
        low_high = (request.within[0], request.within[1]) if request.within else None
        wish = Wish(request.goal or None, request.minutes or None, low_high)
        if self._get.service_is_ready():
            asked = self._get.call_async(GetParameters.Request(names=list(_ASKED)))
            asked.add_done_callback(lambda said: self._put(self._seek, wish, request.run, said))
        else:
            self._put(self._seek, wish, False)
        return Experiment.Response(success=True, message="seeking; twin/experiment has what comes of it")

    def _against(self, request: Experiment.Request) -> str:
        """Why a request is refused; empty if it is not."""
        if request.stop:
            return "" if self._running else "no experiment runs"
        if self._running or self._jobs:
            return "an experiment runs, or is being sought; stop it first, or wait"
        if request.run and not self._set.service_is_ready():
            return f"no controller is here (no service {self._set.srv_name}): give these set-points yourself"
        if len(request.within) not in (0, 2):
            return f"within has {len(request.within)} values; give the lowest and the highest, or none"
        return self.busy() if request.run else ""

    def refuse(self, reason: str) -> None:
        """Report that nothing comes of a request."""
        self._publish(ExperimentReport(0, ExperimentPhase.REFUSED, "", 0, reason=reason))

    def _seek(self, wish: Wish, run: bool, said: Any = None) -> None:
        """Find the course for a wish, given the controller's answer."""
        newest = self._newest()
        usual = [parameter_value_to_python(value) for value in said.result().values] if said else []
        if usual:
            each = [one if isinstance(one, Sequence) else [one] for one in usual[-3:-1]]
            wish = replace(wish, ranges=tuple(zip(*each, strict=True)))
        self._live = None
        if run and usual[-1:] != ["profile"]:
            raise ExperimentError(
                "experiment: the controller takes its set-points from a topic; give these levels there, or "
                "start it with reference_source: profile"
            )
        from twinmatch.twin.live_experiment import LiveExperiment  # noqa: PLC0415 — slow, and seldom needed

        self._live = LiveExperiment(self._node.settings, wish, newest)
        self._publish(self._live.report)
        if run:
            self._usual = dict(zip(_PROFILE, usual, strict=False))
            self._running = True
            self._follow(self._live.run())

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
        """Publish a report, and have the controller follow its course, or its own profile again."""
        self._running = report.phase is ExperimentPhase.RUNNING
        ramp = [0.0] * len(self._node.settings.plant.outputs)
        course = (list(report.levels), list(report.holds), False, ramp if ramp[1:] else 0.0)
        values = dict(zip(_PROFILE, course, strict=True)) if self._running else self._usual
        given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        setting = self._set.call_async(SetParametersAtomically.Request(parameters=given))
        if self._running:
            setting.add_done_callback(lambda said: self._put(self._obeyed, said))
        self._publish(report)

    def _obeyed(self, said: Any) -> None:
        """End an experiment that the controller does not follow."""
        if not said.result().result.successful:
            self._end(f"the controller refuses: {said.result().result.reason}")

    def _publish(self, report: ExperimentReport) -> None:
        self._node.health.set("experiment", f"{report.phase.value}: {report.reason}")
        self._node.publish(self._reports, message_of(report, self._stamp_of(report.sample)))
