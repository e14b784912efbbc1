"""The twin beside a rig that is not ours: from its topics to verdicts, whatever becomes of the rig."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from tests.support.oven import HOLD, MAP, PERIOD, RIG, oven_file
from tests.support.places import LAUNCH_SCRIPTS
from tests.support.processes import Process, Processes, run_twinmatch
from tests.support.ros import listening
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.offline.verification import verify_session
from twinmatch.sessions import read_session
from twinmatch.sessions.metadata import parameters_of
from twinmatch_msgs.msg import Forecast, LoopSample, Match, MatchRequest, ModelScore

ATTACH = LAUNCH_SCRIPTS / "attach.py"
ENTRIES = [f"{name}={text}" for name, text in MAP.items()]


@pytest.fixture
def attach(processes: Processes, tmp_path: Path) -> Callable[..., Process]:
    """Start attach.py for the oven; it records into `run`."""

    def start(*options: object) -> Process:
        plant = oven_file(tmp_path)
        twin = tmp_path / "twin.yaml"
        twin.write_text(
            f"/**:\n  ros__parameters:\n    schedule: {{span: {HOLD}, min_span: 30, lead: 10}}\n"
        )
        words = [
            "--plant",
            plant,
            "--twin-config",
            twin,
            "--period",
            PERIOD,
            "--session",
            tmp_path / "run",
        ]
        return processes.python(ATTACH, *words, *options)

    return start


def missed(samples: list[LoopSample]) -> list[int]:
    """The index behind each gap."""
    return [b.index for a, b in pairwise(samples) if b.index != a.index + 1]


@pytest.mark.long("judges a foreign rig live until it has a twin, and verifies that")
def test_from_the_topics_of_a_foreign_rig_to_verdicts_that_verify(
    processes: Processes, attach: Callable[..., Process], tmp_path: Path
) -> None:
    """Killed and started again on the way: windows start over there, and the twin continues."""
    rig = processes.python(RIG, "--period", PERIOD, "--hold", HOLD, "--stamped")
    entries = [
        e if not e.startswith("output") else "temperature=/oven/temperature:temperature"
        for e in ENTRIES
    ]
    run = attach("--map", *entries)
    with listening() as listener:
        verdicts = listener.hear(ModelScore, "twin/model_score", 10)
        matches = listener.hear(Match, "twin/match", 10)
        forecasts = listener.hear(Forecast, "twin/forecast", 10)
        requests = listener.hear(MatchRequest, "twin/match_request", 10)
        samples = listener.hear(LoopSample, "plant/sample", EVERYTHING)
        listener.spin_until(
            lambda: verdicts and matches and forecasts, lambda: run.text
        )
        commanding = listener.node.get_publishers_info_by_topic("/oven/heater")
        assert [info.node_name for info in commanding] == ["oven_rig"]
        rig.kill()
        run.said(r"sampler: health: .*/oven/heater no longer has a publisher")
        rig = processes.python(RIG, "--period", PERIOD, "--hold", HOLD, "--stamped")
        listener.spin_until(lambda: missed(samples), lambda: run.text)
        behind = missed(samples)[0]
        listener.spin_until(lambda: verdicts[-1].sample > behind, lambda: run.text)
        rig.kill()  # what is asked for then is answered before the end
        run.said(
            r"twin_simulator: health: no sample for|sampler: health: .*no longer has"
        )
        listener.spin_until(
            lambda: {r.sample for r in requests} <= {m.sample for m in matches},
            lambda: run.text,
        )
    assert run.end(signal.SIGINT) == 0
    assert re.search(
        r"ended: stopped by the operator; \d+ samples, \d+ verdicts", run.text
    )
    session = read_session(tmp_path / "run")
    assert any("samples are missing there" in note for note in session.notes)
    assert parameters_of(session.records, "/sampler")
    assert session.has_reference
    found_again = verify_session(tmp_path / "run", plant=str(tmp_path / "oven.py"))
    assert found_again.identical, found_again.difference


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "map topics to signals with"),
        (
            ("--map", "output=/t"),
            "attach: map.input is missing; give its topic and field",
        ),
        (("--map", "outptu=/t"), "has no signal 'outptu'; it has time, output"),
        (("--map", "output=/t", "input=/u", "--plant", "nowhere.py"), "nowhere.py"),
        (("--map", "output=/t", "input=/u", "--session", "."), "exists already"),
        (("--config", "nowhere.yaml"), "nowhere.yaml: cannot be read"),
        (("--map", "output=/t; gain=2", "input=/u"), "gain: is not a known key"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    options: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    completed = run_twinmatch("attach", *options, folder=tmp_path)
    assert completed.returncode == 2
    assert words in completed.stderr
    assert "Traceback" not in completed.stderr
