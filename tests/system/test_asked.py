"""What is asked of a running graph: one thing moves it at a time, and only by the signature of its twin."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter

from tests.nodes.test_apply import Operator
from tests.support.processes import Processes
from tests.support.rig import GAINS
from tests.support.ros import Listener, listening
from tests.support.signed import SECRET, signed
from tests.system.test_live import LiveRun, live_run  # noqa: F401
from twinmatch.nodes.topics import EVERYTHING, LATCHED
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import ApplyLaw, Experiment, TryLaw

pytestmark = [pytest.mark.ros]

LAW = json.dumps({
    "kind": "pid",
    "proportional": 0.8 * GAINS.proportional,
    "integral": 0.8 * GAINS.integral,
    "derivative": 0.8 * GAINS.derivative,
    "back_calculation": GAINS.back_calculation,
})  # fmt: skip


class Graph:
    """A live graph as its operator sees it."""

    def __init__(self, listener: Listener) -> None:
        self.listener = listener
        self.samples: list[Any] = listener.hear(
            messages.LoopSample, "plant/sample", EVERYTHING
        )
        self.twin = listener.hear(messages.LawReport, "twin/law", EVERYTHING)
        self.laws = listener.hear(messages.LawReport, "plant/law", LATCHED)
        self.courses = listener.hear(
            messages.ExperimentReport, "twin/experiment", EVERYTHING
        )
        self.apply = Operator(listener, ApplyLaw, "plant/apply_law")
        self.ask_law = Operator(listener, TryLaw, "twin/try_law")
        self.experiment = Operator(listener, Experiment, "twin/experiment")
        self._set = Operator(
            listener, SetParametersAtomically, "controller/set_parameters_atomically"
        )

    def hold(self, level: float) -> None:
        """Have the controller hold a set-point."""
        course = {
            "course.levels": [level],
            "course.holds": [1.0],
            "course.followed": True,
        }
        parameters = [
            Parameter(name, value=value).to_parameter_msg()
            for name, value in course.items()
        ]
        assert self._set(parameters=parameters).result.successful

    def pass_samples(self, count: int) -> list[float]:
        """Wait for so many samples; returns their set-points."""
        count_before = len(self.samples)
        self.listener.spin_until(
            lambda: len(self.samples) >= count_before + count, f"{count} samples"
        )
        return [sample.reference[0] for sample in self.samples[count_before:]]

    def answered(self, word: str) -> str:
        """Ask whether the law may be run, until the twin has a candidate and the plant rests."""

        def phase() -> str:
            count_before = len(self.twin)
            if self.ask_law(law=LAW, request=word).success:
                self.listener.spin_until(
                    lambda: len(self.twin) > count_before, "a report"
                )
            return self.twin[-1].phase_name if len(self.twin) > count_before else ""

        self.listener.spin_until(
            lambda: phase() == "answered", lambda: f"an answer: {self.twin[-1:]}"
        )
        return str(self.twin[-1].decision)


@pytest.mark.long(
    "a run that has to learn a twin before experiments and laws are answered, three times"
)
def test_one_thing_moves_the_plant_at_a_time_and_returns_to_where_it_was(
    live_run: Callable[..., LiveRun],  # noqa: F811
    processes: Processes,
    tmp_path: Path,
) -> None:
    """On one graph: an experiment and a law at the same moment, a forged law, a bad document beside a law on
    trial, and a rig that says nothing any longer."""
    run = live_run("--no-record", ends=False)
    run.wait_until_driven()
    with listening() as listener:
        graph = Graph(listener)
        graph.pass_samples(260)  # set-points have moved, and a match is due
        graph.hold(40.0)
        graph.answered("first")
        returns_from_an_experiment(graph)
        refuses_what_is_forged(graph)
        follows_its_own_law(graph, run, processes, tmp_path)
    run.process.end()


def returns_from_an_experiment(graph: Graph) -> None:
    """It has its turn from the request on; once it is stopped, the set-point stays where it was before."""
    assert graph.experiment(goal="parameters", run=True, request="course").success
    assert (
        "an experiment runs, or is being sought"
        in graph.ask_law(law=LAW, run=True).message
    )

    def running() -> list[Any]:
        return [r for r in graph.courses if r.phase_name in {"running", "refused"}]

    graph.listener.spin_until(running, "its start")
    assert running()[0].phase_name == "running", running()[0].reason
    assert graph.experiment(stop=True).success
    graph.listener.spin_until(
        lambda: graph.courses[-1].phase_name == "ended", "its end"
    )
    assert graph.courses[-1].request == "course"
    assert set(graph.pass_samples(100)[5:]) == {40.0}


def refuses_what_is_forged(graph: Graph) -> None:
    """Gains of the wrong sign, said to be safe by somebody who has not the secret of this run."""
    fields: dict[str, Any] = {
        "proportional": [-50.0],
        "integral": [-5.0],
        "derivative": [0.0],
        "back_calculation": [1.0],
        "on_measurement": [False],
        "low": [0.0] * 500,
        "high": [100.0] * 500,
        "patience": 100,
        "decision": "safe",
        "although": True,
        "sample": graph.samples[-1].index,
    }
    for forged in (fields, signed(SECRET, **fields)):
        assert "lacks the signature" in graph.apply(**forged).message
    assert not graph.laws, "the law of the configuration drives"


def follows_its_own_law(
    graph: Graph, run: LiveRun, processes: Processes, folder: Path
) -> None:
    """Beside a law on trial nothing else is taken on, and its command knows whose reports are whose."""
    law = folder / "law.json"
    law.write_text(LAW)
    graph.answered("again")
    command = processes.python(
        "-m", "twinmatch.cli", "apply", law, "--yes", "--although", "--shadow", "5000"
    )  # longer than this test, however fast its plant is
    command.said("shadow")
    graph.listener.spin_until(
        lambda: graph.ask_law(law="{", request="bad").success, "its turn"
    )
    bad = lambda: [r for r in graph.twin if r.request == "bad"]  # noqa: E731
    graph.listener.spin_until(bad, "its refusal")
    assert "a law is being tried, or is on trial" in graph.experiment(run=True).message
    assert (
        "a law is being tried, or is on trial"
        in graph.ask_law(law=LAW, run=True).message
    )
    graph.pass_samples(5)
    assert command.running
    rig = run.child("rig")
    assert rig is not None
    os.kill(rig, signal.SIGSTOP)
    try:
        assert command.wait() == 1
    finally:
        os.kill(rig, signal.SIGCONT)
    assert (
        "apply: the controller has said nothing for 5 s; nothing drives" in command.text
    )
