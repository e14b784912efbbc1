"""A Temperature Control Lab live, from its serial line to a session that verifies, and its wire breaking."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")
pytest.importorskip("tclab", reason="pip install 'twinmatch[tclab]'")

from tests.support.places import LAUNCH_SCRIPTS
from tests.support.processes import Processes, run_twinmatch
from tests.support.waiting import PATIENCE
from twinmatch.offline.verification import verify_session
from twinmatch.sessions import read_session

LIVE = LAUNCH_SCRIPTS / "live.py"


@pytest.mark.slow
def test_a_heater_that_is_lost_is_reported_and_the_session_verifies(
    processes: Processes, tmp_path: Path
) -> None:
    config = tmp_path / "kit.yaml"
    config.write_text(
        "controller:\n  ros__parameters:\n"
        "    profile.levels: [35.0, 50.0, 42.0]\n    profile.holds: [20.0, 140.0, 40.0]\n"
        "    profile.repeat: false\n    exit_at_end: true\n"
    )
    twin, session = tmp_path / "twin.yaml", tmp_path / "run"
    schedule = "{span: 120, min_span: 60, lead: 10}"
    twin.write_text(f"/**:\n  ros__parameters:\n    plant: tclab\n    schedule: {schedule}\n")
    words = ("--plant", "tclab", "--virtual", "--speed", "max", "--config", config, "--twin-config", twin)
    words += ("--session", session, "--fault", "drive-lost@140")
    process = processes.python(LIVE, *words)
    assert process.wait(6 * PATIENCE) == 0, process.text
    found = verify_session(session)
    assert found.identical, found.difference
    samples = read_session(session).samples
    topics = {message.topic.name for message in read_session(session).messages()}
    assert {"/plant/reading", "/plant/command", "/plant/applied"} <= topics
    assert not any("pwm" in topic for topic in topics)
    begun = re.search(r"drive-lost begins at (\S+) s", process.text)
    assert begun, process.text
    assert [sample.index for sample in samples] == list(range(200))
    assert "matched on samples" in process.text
    assert "drive-lost: the drive should have moved" in process.text
    assert samples[0].disturbances == (0.0,)


def test_what_a_process_of_the_run_refuses_is_one_line_and_exit_code_two(processes: Processes) -> None:
    process = processes.python(LIVE, "--plant", "tclab", "--no-record", "--port", "/dev/null")
    assert process.wait() == 2, process.text
    assert "kit at /dev/null: the port cannot be opened" in process.text
    assert "Traceback" not in process.text


def test_a_fault_that_a_kit_cannot_have_is_refused() -> None:
    done = run_twinmatch("virtual-rig", "--plant", "tclab", "--fault", "fan-failed@3")
    assert done.returncode == 2
    assert "fault 'fan-failed': not available for this plant" in done.stderr
