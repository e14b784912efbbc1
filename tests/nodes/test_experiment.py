"""Experiments by service: the controller follows a course, and its own profile again."""

from __future__ import annotations

from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python

from tests.support.processes import Start
from tests.support.ros import Listener
from twinmatch.nodes.topics import EVERYTHING, LATCHED
from twinmatch.signals import Sample
from twinmatch_msgs import msg as messages
from twinmatch_msgs.msg import ModelScore
from twinmatch_msgs.srv import Experiment

pytestmark = pytest.mark.ros

LEVELS = [21.0, 33.0]


class Desk:
    """Asks for experiments, and for the controller's profile."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._asked = listener.node.create_client(Experiment, "twin/experiment")
        self._read = listener.node.create_client(GetParameters, "controller/get_parameters")

    def ask(self, **fields: Any) -> Experiment.Response:
        return self._call(self._asked, Experiment.Request(**fields))

    def profile(self) -> list[Any]:
        names = ["profile.levels", "profile.holds", "profile.repeat"]
        return [
            parameter_value_to_python(v)
            for v in self._call(self._read, GetParameters.Request(names=names)).values
        ]

    def begin(self, reports: list[Any], before: float) -> None:
        """Begin one, which the controller follows and which ends at the set-point before it."""
        seen = len(reports)
        said = self.ask(goal="parameters", run=True)
        assert said.success, said.message
        running = lambda: [r for r in reports[seen:] if r.phase_name == "running"]  # noqa: E731
        self._listener.spin_until(running, "its start")
        report = running()[0]
        course = [list(report.levels), list(report.holds), False]
        self._listener.spin_until(lambda: self.profile() == course, "the controller")
        assert report.levels[-1] == before

    def _call(self, client: Any, request: Any) -> Any:
        self._listener.spin_until(client.service_is_ready, "a service")
        answer = client.call_async(request)
        self._listener.spin_until(answer.done, "an answer")
        return answer.result()


def test_the_controller_follows_a_course_and_gets_its_profile_back(
    start: Start, start_process: Start, listener: Listener, steps: list[Sample]
) -> None:
    """Asked before there is a candidate, without a controller, and in earnest; stopped by the operator. The
    twin of a second one is killed while it runs: its course ends where the set-point was, without it."""
    reports = listener.hear(messages.ExperimentReport, "twin/experiment", LATCHED)
    verdicts = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    start_process("matcher")
    twin = start_process("discriminator")
    desk = Desk(listener)
    assert desk.ask().success
    listener.spin_until(lambda: reports, "a report")
    assert reports[-1].phase_name == "refused"
    assert "there is no candidate yet" in reports[-1].reason
    assert "no controller is here" in desk.ask(run=True).message
    assert desk.ask(within=[1.0]).message.startswith("within has 1 values")
    assert desk.ask(stop=True).message == "no experiment runs"
    start("controller", "-p", f"profile.levels:={LEVELS}", "-p", "profile.holds:=[100.0, 200.0]")
    own = desk.profile()
    listener.wait_for_nodes("twin/match", "twin/match_request")
    listener.send(steps)
    listener.spin_until(lambda: verdicts and verdicts[-1].sample > steps[-1].index - 60, "the last verdict")
    desk.begin(reports, steps[-1].reference)
    assert desk.ask(run=True).message.startswith("an experiment runs")
    assert desk.ask(stop=True).success
    listener.spin_until(lambda: reports[-1].phase_name == "ended", "its end")
    assert "stopped by the operator" in reports[-1].reason
    listener.spin_until(lambda: desk.profile() == own, "the profile")
    desk.begin(reports, steps[-1].reference)
    twin.kill()
