"""Experiments by service: the controller follows a course, and stays where the set-point was before."""

from __future__ import annotations

import re
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python

from tests.support.processes import Start
from tests.support.ros import Inside, Listener
from tests.support.signed import SECRET
from twinmatch.nodes.signature import VARIABLE
from twinmatch.nodes.topics import EVERYTHING, LATCHED
from twinmatch.showing.asking import ExperimentAsking, ProfileAsking
from twinmatch.signals import Sample
from twinmatch_msgs import msg as messages
from twinmatch_msgs.msg import ModelScore
from twinmatch_msgs.srv import Experiment, TryLaw

pytestmark = pytest.mark.ros

LEVELS = [21.0, 33.0]


@pytest.fixture(autouse=True)
def _secret(monkeypatch: pytest.MonkeyPatch) -> None:
    """All nodes are of one run."""
    monkeypatch.setenv(VARIABLE, SECRET)


class Desk:
    """Asks for experiments, and for the controller's profile."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._asked = listener.node.create_client(Experiment, "twin/experiment")
        self._tried = listener.node.create_client(TryLaw, "twin/try_law")
        self._read = listener.node.create_client(
            GetParameters, "controller/get_parameters"
        )

    def ask(self, **fields: Any) -> Experiment.Response:
        return self._call(self._asked, Experiment.Request(**fields))

    def read(self, *names: str) -> list[Any]:
        """Values of the controller's parameters."""
        values = self._call(self._read, GetParameters.Request(names=list(names))).values
        return [parameter_value_to_python(value) for value in values]

    def profile(self) -> list[Any]:
        return self.read("profile.levels", "profile.holds", "profile.repeat")

    def course(self) -> list[Any]:
        return self.read("course.levels", "course.holds", "course.followed")

    def begin(self, reports: list[Any], before: float) -> None:
        """Begin one, which the controller follows and which ends at the set-point before it."""
        count_before = len(reports)
        answer = self.ask(goal="parameters", run=True, request="mine")
        assert answer.success, answer.message
        for asked in ({"run": True}, {}):
            assert self.ask(**asked).message.startswith(
                "an experiment runs, or is being sought"
            )
        assert self.law().message.startswith("an experiment runs, or is being sought")

        def running() -> list[Any]:
            return [r for r in reports[count_before:] if r.phase_name == "running"]

        self._listener.spin_until(running, "its start")
        report = running()[0]
        course = [list(report.levels), list(report.holds), True]
        self._listener.spin_until(lambda: self.course() == course, "the controller")
        assert report.levels[-1] == before
        assert report.request == "mine"

    def law(self) -> TryLaw.Response:
        """What is answered to a law that is to be run."""
        return self._call(self._tried, TryLaw.Request(law="{}", run=True))

    def _call(self, client: Any, request: Any) -> Any:
        self._listener.spin_until(client.service_is_ready, "a service")
        answer = client.call_async(request)
        self._listener.spin_until(answer.done, "an answer")
        return answer.result()


def test_the_controller_follows_a_course_and_returns_to_the_set_point_before(
    start: Start,
    start_process: Start,
    listener: Listener,
    steps: list[Sample],
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Asked before there is a candidate, without a controller, and in earnest; stopped by the operator. The
    twin of a second one is killed while it runs: its course ends where the set-point was, without it, and the
    command says so; the profile waits until it is continued."""
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
    start(
        "controller",
        "-p",
        f"profile.levels:={LEVELS}",
        "-p",
        "profile.holds:=[100.0, 200.0]",
    )
    own_profile = desk.profile()
    listener.wait_for_nodes("twin/match", "twin/match_request")
    listener.send(steps)
    listener.spin_until(
        lambda: verdicts and verdicts[-1].sample > steps[-1].index - 60,
        "the last verdict",
    )
    before = steps[-1].reference
    desk.begin(reports, before)
    assert desk.ask(stop=True).success
    listener.spin_until(lambda: reports[-1].phase_name == "ended", "its end")
    assert "stopped by the operator" in reports[-1].reason
    assert desk.course() == [[before], [1.0], True], (
        "the set-point is where it was, and stays there"
    )
    assert desk.profile() == own_profile
    count_before = len(reports)
    asking = Inside(
        "experiment",
        "-p",
        "goal:=parameters",
        "-p",
        "run:=true",
        kinds=[ExperimentAsking],
    )
    listener.spin_until(
        lambda: [r for r in reports[count_before:] if r.phase_name == "running"],
        "its start",
    )
    report = reports[-1]
    listener.spin_until(
        lambda: desk.course()[0] == list(report.levels), "the controller"
    )
    assert report.levels[-1] == before
    twin.kill()
    # knows of no experiment, and must not be taken for the one before
    start_process("discriminator")
    assert asking.wait() == 1
    lost = r"the twin has (ended|said nothing for 5 s); the controller follows the course to its end"
    assert re.search(f"^experiment: {lost}", capfd.readouterr().err, re.MULTILINE)
    assert desk.read("course.followed") == [True]
    assert Inside("experiment", kinds=[ProfileAsking]).wait() == 0
    assert desk.read("course.followed") == [False]
    assert desk.profile() == own_profile
