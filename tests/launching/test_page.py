"""The live page beside the launch scripts."""

from __future__ import annotations

import argparse
import io
import os
import re
import signal
import subprocess
import sys
import tracemalloc
import urllib.request
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.support import faulty_rig, untaught
from twinmatch.comparing import Verdict
from twinmatch.health import Monitor
from twinmatch.importing import open_any
from twinmatch.launching.live import Live
from twinmatch.launching.plan import LivePlan
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.offline.summary import Tally, conclude, summarise
from twinmatch.sessions import Recording, read_session
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE
from twinmatch.showing.console import Console
from twinmatch.showing.terminal import MAX_EVENTS, Screen
from twinmatch.showing.verdicts import events
from twinmatch.signals import Sample
from twinmatch.twin import Door, TwinSettings, filled_stretches

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)
pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from tests.support.places import LAUNCH_SCRIPTS
from tests.support.processes import Process, run_twinmatch
from tests.support.ros import listening
from tests.support.waiting import wait_for
from twinmatch.launching.live import LiveRun
from twinmatch.launching.plan import VirtualPlan
from twinmatch.launching.processes import (
    LaunchError,
    Page,
    Processes,
    add_page_options,
    page_of,
)
from twinmatch.launching.watch import Watch
from twinmatch.sessions import write_session
from twinmatch.sessions.files import EXIT_DISK
from twinmatch.showing.lines import Lines


def children() -> int:
    """Pages that this process started."""
    command = ["ps", "-o", "comm=", "--ppid", str(os.getpid())]
    commands = subprocess.run(
        command, capture_output=True, text=True, check=True
    ).stdout
    return commands.split().count("dashboard")


def test_it_is_there_within_and_gone_after(ros_domain: int) -> None:  # noqa: ARG001
    lines: list[str] = []
    with Page(0, control=True, show=lines.append):
        page = re.compile(r"page: http://127.0.0.1:\d+/$")
        wait_for(lambda: any(page.search(line) for line in lines), "the page's address")
        assert children() == 1
    assert children() == 0


def test_without_the_option_there_is_none() -> None:
    with Page(None) as page:
        page.stay()  # returns at once


def parsed(*words: str) -> Page:
    parser = argparse.ArgumentParser()
    add_page_options(parser, control=True)
    return page_of(parser.parse_args(words), parser)


@pytest.mark.parametrize(
    "words",
    [
        ("--control",),
        ("--tell", "mqtt://127.0.0.1"),
        ("--dashboard", "70000"),
        ("--dashboard", "-1"),
        ("--dashboard", "x"),
    ],
)
def test_options_that_contradict_each_other_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as raised:
        parsed(*words)
    assert raised.value.code == 2


@pytest.mark.parametrize("command", ["live", "play", "attach", "demo"])
def test_every_command_that_starts_nodes_has_it(command: str) -> None:
    help_text = run_twinmatch(command, "--help").stdout
    assert "--dashboard" in help_text
    assert "--tell" in help_text
    assert ("--control" in help_text) == (command == "live")


def test_the_page_is_given_the_broker_it_tells(ros_domain: int) -> None:  # noqa: ARG001
    lines: list[str] = []
    with Page(0, tell="mqtt://127.0.0.1:1", show=lines.append):
        wait_for(
            lambda: any("no MQTT broker at 127.0.0.1:1" in line for line in lines),
            "what it has tried",
        )


def test_after_a_replay_it_stays_until_ctrl_c(ros_domain: int, tmp_path: Path) -> None:  # noqa: ARG001
    samples = [Sample(k, 10**18 + k * 10**9, 50.0, 49.0, 20.0) for k in range(30)]
    session = write_session(tmp_path / "short", samples)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "ROS_LOG_DIR": str(tmp_path)}
    command = [
        sys.executable,
        LAUNCH_SCRIPTS / "replay.py",
        session,
        "--rate",
        "0",
        "--dashboard",
        "0",
    ]
    replay = Process(
        *command, output=tmp_path / "output.txt", environment=environment, forked=True
    )
    try:
        replay.said("the page stays open until Ctrl-C")
        address = replay.said(r"page: (\S+)")[1]
        with urllib.request.urlopen(address) as answer:
            assert b"twinmatch" in answer.read()
        assert replay.end(signal.SIGINT) == 0, replay.text
        with pytest.raises(OSError, match="refused"):
            urllib.request.urlopen(address)
    finally:
        replay.kill()


# What a live run does about a process that ends: restart it, end the run, and with which exit code.


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


def ending(name: str, code: int) -> tuple[Live, LiveRun, Ending]:
    plan = LivePlan(
        Path("rig.yaml"), session=Path("run"), virtual=VirtualPlan(speed=20.0)
    )
    live = Live(plan)
    live.results.samples.close()
    run = LiveRun(live, Lines())
    run.show("[virtual_rig] clock: localhost:9")
    run.processes = processes = Ending(name, code)
    return live, run, processes


@pytest.mark.ros
@pytest.mark.usefixtures("ros")
def test_a_graph_beside_one_that_runs_is_refused_before_anything_is_started() -> None:
    """Both would drive the plate."""
    with listening() as rig, listening() as beside:
        assert rig.samples
        live = Live(LivePlan(Path("rig.yaml")))
        live.results.samples.close()
        run = LiveRun(live, Lines())
        run.processes = processes = Ending("rig", 0)
        with pytest.raises(LaunchError, match="/plant/sample already has a publisher"):
            run.start(beside.node)  # type: ignore[arg-type]  # a node is all it takes
        assert not processes.started


@pytest.mark.parametrize(
    ("speed", "has_own_clock"), [(1.0, False), (0.5, True), (20.0, True)]
)
def test_only_a_plant_that_is_not_at_real_time_has_its_own_clock(
    speed: float, has_own_clock: bool
) -> None:
    plan = LivePlan(Path("rig.yaml"), virtual=VirtualPlan(speed=speed))
    for arguments in (
        plan.twin_arguments(),
        plan.recorder_arguments(Path("run")),
        plan.rig_arguments({}),
    ):
        assert ("use_sim_time:=true" in arguments) is has_own_clock


@pytest.mark.parametrize(
    ("name", "code", "exit_code", "reason"),
    [
        ("rig", 0, 0, "the profile has ended"),
        ("virtual_rig", 0, 0, "the virtual rig has ended"),
        ("rig", 1, 3, "rig was lost (code 1); the output is off"),
        ("virtual_rig", -9, 3, "virtual_rig was lost (code -9); the output is off"),
        (
            "recorder",
            EXIT_DISK,
            1,
            "recorder can no longer write the session; see its message above",
        ),
        (
            "twin",
            2,
            2,
            "twin rejected its configuration or input; see its message above",
        ),
    ],
)
def test_the_run_ends_with_what_it_cannot_do_without(
    name: str, code: int, exit_code: int, reason: str
) -> None:
    live, run, processes = ending(name, code)
    assert run.check(Watch) == exit_code  # type: ignore[arg-type]
    assert live.ending == reason
    assert not processes.started


@pytest.mark.parametrize("name", ["twin", "recorder", "plant_clock"])
def test_others_are_restarted_but_not_for_ever(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    live, run, processes = ending(name, -9)
    for _ in range(LiveRun.RESTARTS):
        assert run.check(Watch) is None  # type: ignore[arg-type]
    assert f"{name} ended with code -9; restarting it" in capsys.readouterr().out
    assert len(processes.started) == LiveRun.RESTARTS
    assert processes.started[0].startswith(f"{name}: twinmatch.nodes {name} --ros-args")
    assert run.check(Watch) == 3  # type: ignore[arg-type]
    assert "after 12 restarts in 600 s" in live.ending


# A run may last for weeks: what sees every sample and every verdict keeps no more for it.


SESSION = Path(__file__).resolve().parents[2] / "bags" / "four_setpoints"


def growth(step: Callable[[int], object], warm: int, count: int) -> int:
    """Bytes that are held after `count` more steps, and were not before them."""
    tracemalloc.start()
    try:
        for k in range(warm):
            step(k)
        before = tracemalloc.get_traced_memory()[0]
        for k in range(warm, warm + count):
            step(k)
        return tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def judged(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[list[Sample], list[Verdict]]:
    """A session with two matches."""
    folder = tmp_path_factory.mktemp("judged") / "beginning"
    session = open_any(write_session(folder, read_session(SESSION).samples[:660]))
    judgement = judge(session, terms_from_files(session))
    return list(judgement.samples), list(judgement.verdicts)


def test_the_launcher_keeps_no_samples_in_memory() -> None:
    """A reference to each of them would take eight bytes."""
    live = Live(LivePlan(Path("rig.yaml")))
    assert (
        growth(lambda k: live.take_sample(Sample(k, k, 1.0, 2.0, 3.0)), 1000, 4000)
        < 4 * 4000
    )
    assert len(live.results.samples) == 5000
    live.results.samples.close()


def test_the_monitor_keeps_no_samples() -> None:
    samples, _ = faulty_rig.run(np.tile(np.repeat([40.0, 60.0], 400), 4), None, seed=2)
    monitor = Monitor()
    assert growth(lambda k: monitor.push(samples[k]), 2400, 800) < 33_000


def test_a_recording_keeps_nothing_of_what_it_has_written(tmp_path: Path) -> None:
    """Brought to the disk every 0.4 s, it has 200,000 chunks a day; finishing it writes the index of all."""
    recording = Recording(tmp_path / "long")
    recording.add_topic(SAMPLE)

    def step(k: int) -> None:
        recording.write(
            SAMPLE.name, encode_sample(Sample(k, k * 10**9, 1.0, 2.0, 3.0)), k * 10**9
        )
        recording.flush()

    assert growth(step, 100, 400) < 20_000
    recording.close()
    with (tmp_path / "long" / "long_0.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert [
        index.message_start_time // 10**9 for index in summary.chunk_indexes
    ] == list(range(500))
    assert len(read_session(tmp_path / "long").samples) == 500


def test_the_view_keeps_what_it_shows(
    judged: tuple[list[Sample], list[Verdict]],
) -> None:
    _, verdicts = judged
    console = Console(file=io.StringIO(), width=200, height=200)
    screen = Screen(console, "live")
    many = [
        replace(v, sample=v.sample + 10_000 * k) for k in range(20) for v in verdicts
    ]
    assert (
        growth(lambda k: screen.take_verdict(many[k]), len(many) // 2, len(many) // 2)
        < 20_000
    )
    console.print(screen)
    lines = console.file.getvalue().rpartition("\n\n")[2].splitlines()
    newest = events(many)[-MAX_EVENTS:]
    for line, event in zip(lines, newest, strict=True):
        assert line.startswith(f"{event.sample:>6} s "), event
        assert event.title in line


def test_a_live_run_settles_its_samples_as_the_discriminator_did() -> None:
    """Samples wait until all verdicts before them have come, which may be late."""
    judgement = untaught.judged()
    samples = untaught.spiked()
    verdicts = list(untaught.judged().verdicts)
    live = Live(LivePlan(Path("rig.yaml")))
    live.door = Door(untaught.settings())
    for sample in samples:
        live.take_sample(sample)
        if sample.index % 70 == 0:  # and then all at once
            while verdicts and verdicts[0].sample <= sample.index - 40:
                live.take_verdict(verdicts.pop(0))
            live.settle(lambda before, now=sample.index - 40: before <= now)
    assert not live.door.waiting, "the twin is known"
    window, stretches = live.results.longest(1.0)
    assert (stretches, live.received) == (1, len(samples))
    assert window.lost == judgement.stretches[0].lost
    assert np.array_equal(window.output, judgement.stretches[0].output)
    live.results.samples.close()


def test_the_figures_of_the_end_are_those_of_all_samples_and_verdicts(
    judged: tuple[list[Sample], list[Verdict]],
) -> None:
    samples, verdicts = judged
    holed = [s for s in samples if s.index not in {300, 301, *range(500, 506)}]
    settings = TwinSettings()
    law = None
    for received in (samples, holed):
        live = Live(LivePlan(Path("rig.yaml")))
        live.door = Door(settings)
        for sample in received:
            live.take_sample(sample)
        for verdict in verdicts:
            live.take_verdict(verdict)
        conclusion = conclude(
            live.results.tally, lambda live=live: live.results.longest(1.0), law
        )
        expected = summarise(filled_stretches(received, settings), verdicts, law)
        assert live.received == len(received)
        assert repr(conclusion) == repr(expected)  # which makes nan equal to nan
        live.results.samples.close()
    assert (
        conclude(
            Tally(), lambda: pytest.fail("nobody to hold it against"), law
        ).verdicts
        == 0
    )
