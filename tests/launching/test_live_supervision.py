"""What a live run does about a process that ends: restart it, end the run, and with which exit code."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip("twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup")

from twinmatch.launching.live import RESTARTS, Live, _LiveRun
from twinmatch.launching.plan import LivePlan, VirtualPlan
from twinmatch.launching.processes import Processes
from twinmatch.launching.watch import Watch
from twinmatch.showing.lines import Lines


class Ending(Processes):
    """Processes one of which has ended."""

    def __init__(self, name: str, code: int) -> None:
        super().__init__()
        self.started: list[str] = []
        self.codes = {name: code}

    @property
    def ended(self) -> dict[str, int]:
        return self.codes

    def start_module(self, name: str, module: str, *arguments: str) -> None:  # type: ignore[override]
        self.started.append(f"{name}: {module} {' '.join(arguments)}")


def ending(name: str, code: int) -> tuple[_LiveRun, Ending]:
    plan = LivePlan(Path("rig.yaml"), session=Path("run"), virtual=VirtualPlan(speed=20.0))
    live = Live(plan)
    live.samples.close()
    run = _LiveRun(live, Lines())
    run.show("[virtual_rig] clock: localhost:9")
    run.processes = processes = Ending(name, code)
    return run, processes


@pytest.mark.parametrize(
    ("name", "code", "exit_code", "reason"),
    [
        ("rig", 0, 0, "the profile has ended"),
        ("virtual_rig", 0, 0, "the virtual rig has ended"),
        ("rig", 1, 3, "rig was lost (code 1); the output is off"),
        ("virtual_rig", -9, 3, "virtual_rig was lost (code -9); the output is off"),
        ("twin", 2, 2, "twin rejected its configuration or input; see its message above"),
    ],
)
def test_the_run_ends_with_what_it_cannot_do_without(
    name: str, code: int, exit_code: int, reason: str
) -> None:
    run, processes = ending(name, code)
    assert run.check(Watch) == exit_code  # type: ignore[arg-type]
    assert run._live.ending == reason
    assert not processes.started


@pytest.mark.parametrize("name", ["twin", "recorder", "plant_clock"])
def test_others_are_restarted_but_not_for_ever(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    run, processes = ending(name, -9)
    for _ in range(RESTARTS):
        assert run.check(Watch) is None  # type: ignore[arg-type]
    assert f"{name} ended with code -9; restarting it" in capsys.readouterr().out
    assert len(processes.started) == RESTARTS
    assert processes.started[0].startswith(f"{name}: twinmatch.nodes {name} --ros-args")
    assert run.check(Watch) == 3  # type: ignore[arg-type]
    assert "after 12 restarts in 600 s" in run._live.ending
