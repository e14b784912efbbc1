"""A Temperature Control Lab live, from its serial line to a session that verifies, and its wire breaking."""

from __future__ import annotations

import json
import math
import os
import re
import signal
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)
pytest.importorskip("tclab", reason="pip install 'twinmatch[tclab]'")

from tests.support.places import LAUNCH_SCRIPTS, PROJECT
from tests.support.processes import Processes, run_twinmatch
from tests.support.waiting import PATIENCE
from twinmatch.comparing import ADMITTED, REFUSED
from twinmatch.emulation.faults import tell
from twinmatch.launching.plan import LivePlan, VirtualPlan
from twinmatch.nodes.step import VARIABLE
from twinmatch.offline.verification import verify_session
from twinmatch.sessions import read_session
from twinmatch.sessions.cdr import decoded

LIVE = LAUNCH_SCRIPTS / "live.py"


@pytest.mark.long("drives a kit for three minutes, and verifies its session")
def test_a_heater_that_is_lost_is_reported_and_the_session_verifies(
    processes: Processes, tmp_path: Path
) -> None:
    config = tmp_path / "kit.yaml"
    config.write_text(
        "controller:\n  ros__parameters:\n"
        "    profile.levels: [35.0, 50.0, 42.0]\n    profile.holds: [15.0, 155.0, 10.0]\n"
        "    profile.repeat: false\n    exit_at_end: true\n"
        "    command_period: 0.5\n"  # the kit waits at each
    )
    twin = tmp_path / "twin.yaml"
    session = tmp_path / "run"
    schedule = "{span: 100, min_span: 60, lead: 10}"
    twin.write_text(
        f"/**:\n  ros__parameters:\n    plant: tclab\n    schedule: {schedule}\n"
    )
    words = (
        "--plant",
        "tclab",
        "--virtual",
        "--speed",
        "max",
        "--config",
        config,
        "--twin-config",
        twin,
    )
    words += ("--session", session, "--fault", "drive-lost@117")
    process = processes.python(LIVE, *words)
    assert process.wait(6 * PATIENCE) == 0, process.text
    verification = verify_session(session)
    assert verification.identical, verification.difference
    samples = read_session(session).samples
    topics = {message.topic.name for message in read_session(session).messages()}
    assert {"/plant/reading", "/plant/command", "/plant/applied"} <= topics
    assert not any("pwm" in topic for topic in topics)
    begun = re.search(r"drive-lost begins at (\S+) s", process.text)
    assert begun, process.text
    assert [sample.index for sample in samples] == list(range(180))
    assert "matched on samples" in process.text
    assert "drive-lost: the drive should have moved" in process.text
    assert samples[0].disturbances == (0.0,)


def test_both_heaters_are_driven_and_recorded_and_go_to_zero(
    processes: Processes, tmp_path: Path
) -> None:
    overrides = {"repeat": "false", "holds": "[15.0, 10.0, 10.0, 10.0]"}
    plan = LivePlan(
        config=PROJECT / "config" / "tclab_both.yaml",
        virtual=VirtualPlan(math.inf, plant="tclab-both"),
        overrides={
            f"controller:profile.{name}": value for name, value in overrides.items()
        }
        | {"controller:exit_at_end": "true", "controller:command_period": "0.5"},
        plant="tclab-both",
    )
    assert plan.virtual is not None
    kit = processes.python(
        "-m", "twinmatch.cli", "virtual-rig", *plan.virtual.arguments
    )
    kit.said("^ready$")
    addresses = dict(line.split(": ", 1) for line in kit.lines if ": " in line)
    in_step = {"environment": {**os.environ, VARIABLE: addresses["clock"]}}
    nodes = ("-m", "twinmatch.nodes")
    processes.python(*nodes, "plant_clock", *plan.clock_arguments(addresses))
    recorder = processes.python(
        *nodes, "recorder", *plan.recorder_arguments(tmp_path / "run"), **in_step
    )
    words = (*plan.rig_arguments(addresses), *plan.wait_for("recorder"))
    rig = processes.python(*nodes, plan.wiring.program, *words, **in_step)
    assert rig.wait() == 0, rig.text
    state = json.loads(tell(addresses["control"], "state"))
    assert (state["power"], state["second"]) == (0.0, 0.0)
    assert state["second_heater"] > state["second_sensor"] > 21.0  # °C
    assert recorder.end(signal.SIGINT) == 0, recorder.text
    session = read_session(tmp_path / "run")
    assert session.plant == "tclab-both"
    assert {sample.shape for sample in session.samples} == {(2, 2, 2, 0)}
    assert [sample.index for sample in session.samples] == list(range(45))
    assert [session.samples[k].references for k in (0, 15, 25, 35)] == [
        (35, 35),
        (50, 35),
        (50, 45),
        (40, 45),
    ]
    # A step of the sensor, 0.32 °C, takes 2 % off the command; the integral is above that after ten seconds.
    assert all(
        sample.inputs[0] > 0 and sample.inputs[1] > 0 for sample in session.samples[15:]
    )


@pytest.mark.long("drives both heaters of a kit for nine minutes, and plays that")
def test_verify_and_play_admit_what_live_admitted_before_a_sensor_was_off(
    processes: Processes, tmp_path: Path
) -> None:
    """Sensor 1 is off from 400 s on, and might be read through if the twin were trusted; the window of the step
    after that is matched by nobody. Of the windows of two steps before, one may show too little."""
    kit = tmp_path / "kit.yaml"
    kit.write_text(
        "controller:\n  ros__parameters:\n"
        "    profile.levels: [35.0, 35.0, 50.0, 35.0, 50.0, 45.0, 40.0, 45.0]\n"
        "    profile.holds: [130.0, 130.0, 160.0, 130.0]\n"
        "    profile.repeat: false\n    exit_at_end: true\n"
        "    command_period: 0.5\n"
        "tclab_bridge:\n  ros__parameters:\n    read_through: T1\n"
    )
    twin = tmp_path / "twin.yaml"
    twin.write_text(
        "/**:\n  ros__parameters:\n    plant: tclab-both\n    read_through: T1\n"
        "    schedule: {span: 100, min_span: 60, lead: 10}\n"
    )
    run = tmp_path / "run"
    words = ("--plant", "tclab-both", "--virtual", "--speed", "max", "--config", kit)
    words += ("--twin-config", twin, "--session", run)
    words += ("--fault", "sensor-offset.1@400")
    live = processes.python(LIVE, *words)
    assert live.wait(12 * PATIENCE) == 0, live.text
    session = read_session(run)
    recorded = list(map(decoded, session.messages(["/twin/model_score"])))
    admitted = [verdict for verdict in recorded if verdict.match == ADMITTED]
    refused = [
        verdict.reason
        for verdict in recorded
        if verdict.match == REFUSED and verdict.sample > 400
    ]
    assert admitted, live.text
    assert all(verdict.sample < 400 for verdict in admitted), live.text
    assert refused, live.text
    # Which names the offset gets later depends on the noise, and so on how often the kit was asked.
    assert all(reason.startswith("not matched: ") for reason in refused), refused
    verification = verify_session(run)
    assert verification.identical, verification.difference
    played = processes.python(
        "-m", "twinmatch.cli", "play", run, "--rate", 0, "--config", twin
    )
    assert played.wait(6 * PATIENCE) == 0, played.text
    matched = re.findall(r"candidate .* matched on samples \d+ to \d+", played.text)
    assert matched == [verdict.reason for verdict in admitted]


def test_what_a_process_of_the_run_refuses_is_one_line_and_exit_code_two(
    processes: Processes,
) -> None:
    process = processes.python(
        LIVE, "--plant", "tclab", "--no-record", "--port", "/dev/null"
    )
    assert process.wait() == 2, process.text
    assert "kit at /dev/null: the port cannot be opened" in process.text
    assert "Traceback" not in process.text


def test_a_fault_that_a_kit_cannot_have_is_refused() -> None:
    completed = run_twinmatch(
        "virtual-rig", "--plant", "tclab", "--fault", "fan-failed@3"
    )
    assert completed.returncode == 2
    assert "fault 'fan-failed': not available for this plant" in completed.stderr
