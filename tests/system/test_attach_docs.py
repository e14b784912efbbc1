"""What docs/attach.md tells people to write works as it stands there, one command after the other."""

from __future__ import annotations

import re
import shlex
import signal
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)
pytest.importorskip(
    "rosbags", reason="rosbags is not installed; it is in the extra 'bags'"
)

from tests.support.places import LAUNCH_SCRIPTS, PROJECT
from tests.support.processes import VERDICT_LINE, Process, Processes, run_twinmatch
from twinmatch.sessions import read_session

PAGE = (PROJECT / "docs" / "attach.md").read_text(encoding="utf-8")
PROGRAMS = dict(
    re.findall(r"^```python (\w+\.py)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
)
COMMANDS = [
    line
    for block in re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    for line in block.splitlines()
]


def forked(processes: Processes, folder: Path, line: str) -> Process:
    """Run a line of the page in a folder; that a launch script starts by itself is shown elsewhere."""
    program, script, *arguments = shlex.split(line)
    assert program == "python"
    path = LAUNCH_SCRIPTS / script.removeprefix("launch_scripts/")
    return processes.python(path, *arguments, folder=folder)


@pytest.mark.long("follows a whole page, from a rig to a verdict")
def test_the_page_leads_from_a_rig_to_a_verdict_and_through_a_bag(
    processes: Processes, tmp_path: Path
) -> None:
    for name, text in PROGRAMS.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert "python oven_rig.py" in PAGE
    rig = processes.python("oven_rig.py", folder=tmp_path)
    attach, verify, list_topics, take, judge = COMMANDS
    run = forked(processes, tmp_path, attach)
    run.said(VERDICT_LINE)
    assert run.end(signal.SIGINT) == 0
    assert rig.running
    assert re.search(
        r"ended: stopped by the operator; \d+ samples, [1-9]\d* verdicts", run.text
    )
    recorded = len(read_session(tmp_path / "first").samples)
    # half of those before the first verdict: a busy machine loses some of a live rig
    assert recorded >= 30
    for command, words in (
        (verify, "identical"),
        (list_topics, "/oven/temperature"),
        (take, "of oven, from first"),
        (judge, "the set-point did not move"),
    ):
        program, *arguments = shlex.split(command)
        assert program == "twinmatch"
        completed = run_twinmatch(*arguments, folder=tmp_path)
        assert completed.returncode == 0, completed.stderr
        assert words in completed.stdout, completed.stdout
    assert len(read_session(tmp_path / "from_bag").samples) >= recorded
