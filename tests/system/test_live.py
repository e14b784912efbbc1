"""The whole live graph on a virtual rig, and what happens when a process of it is killed."""

from __future__ import annotations

import copy
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from rclpy.serialization import deserialize_message
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from tests.support.disks import fill, small_disk
from tests.support.places import LAUNCH_SCRIPTS, PROJECT
from tests.support.processes import Process, Processes, run_twinmatch
from tests.support.recorded import wait_for_recorded, wait_for_settings
from tests.support.ros import Listener, listening
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.emulation.faults import tell
from twinmatch.nodes.topics import EVERYTHING, RELIABLE
from twinmatch.offline.verification import verify_session
from twinmatch.sessions import read_session
from twinmatch.sessions.recording import repair_session
from twinmatch_msgs.msg import Forecast, LoopSample, PwmApplied

LIVE = LAUNCH_SCRIPTS / "live.py"
CHILDREN = ("rig", "twin", "recorder", "plant_clock", "virtual_rig")


class LiveRun:
    """live.py in a process of its own."""

    def __init__(
        self,
        processes: Processes,
        folder: Path,
        *options: str,
        ends: bool = True,
        board: str = "python",
        disk: Path | None = None,
    ) -> None:
        """With a stand-in of the board and few messages, which halves the work; or all as it is, `auto`."""
        self.folder = folder
        self.session = (disk or folder) / "run"
        config = folder / "rig.yaml"
        config.write_text(
            "controller:\n  ros__parameters:\n"
            "    profile.levels: [30.0, 45.0, 30.0]\n    profile.holds: [40.0, 90.0, 40.0]\n"
            f"    profile.repeat: {str(not ends).lower()}\n    exit_at_end: {str(ends).lower()}\n"
            "recorder:\n  ros__parameters:\n    min_free_mb: 1.0\n"
        )
        if board == "python":
            text = config.read_text().replace(
                "    exit", "    command_period: 0.5\n    exit"
            )
            config.write_text(
                f"{text}camera_bridge:\n  ros__parameters:\n    temperature_rate: 5.0\n"
            )
        words = ("--virtual", "--speed", "max", "--board", board, "--config", config)
        words += ("--session", self.session) if "--session" not in options else ()
        self.process = processes.python(LIVE, *words, *options)

    @property
    def text(self) -> str:
        return self.process.text

    @property
    def control(self) -> str:
        matched = re.search(r"control: (\S+)", self.text)
        assert matched, self.text
        return matched[1]

    def state(self) -> dict[str, float]:
        return dict(json.loads(tell(self.control, "state")))

    def wait_until(self, condition: Callable[[], object], what: str) -> None:
        self.process.wait_until(condition, what)

    def wait_until_driving(self) -> None:
        self.process.said("recording into")
        self.wait_until_driven()

    def wait_until_driven(self) -> None:
        self.process.said("ready")
        self.wait_until(lambda: abs(self.state()["pwm"]) > 5, "a driven plate")

    def child(self, name: str) -> int | None:
        """Process id of a child."""
        for child in self.process.children:
            # One that ends in this moment has no name left.
            with suppress(FileNotFoundError, ProcessLookupError):
                title = Path(f"/proc/{child}/comm").read_text().strip()
                if title.replace("-", "_") == name:
                    return child
        return None

    def shoot(self, name: str) -> int:
        victim = self.child(name)
        assert victim is not None, self.text
        os.kill(victim, signal.SIGKILL)
        return victim

    def restarts(self, name: str) -> None:
        """Kill a process and wait for the one that replaces it."""
        victim = self.shoot(name)
        self.process.said(f"{name} ended with code -9; restarting it")
        self.wait_until(
            lambda: self.child(name) not in (None, victim), f"another {name}"
        )


@pytest.fixture
def live_run(processes: Processes, tmp_path: Path) -> Callable[..., LiveRun]:
    return partial(LiveRun, processes, tmp_path)


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Programs beside the run that take all the time of a processor they can get."""
    started = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"])
        for _ in range(loops)
    ]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.mark.long("a run beside programs that take all the time there is")
def test_a_busy_machine_and_suspended_processes_cost_nothing_but_time(
    live_run: Callable[..., LiveRun],
) -> None:
    """The run goes to the end of its profile, verifies, and leaves nothing."""
    run = live_run(board="auto")
    run.wait_until_driving()
    control = Path(run.control)
    children = {name: run.child(name) for name in CHILDREN}
    camera = Process.children_of(children["virtual_rig"] or 0)
    before = run.state()["time"]
    with busy(2):
        run.wait_until(
            lambda: run.state()["time"] >= before + 2, "two seconds of plant time"
        )
    for victim in (*children.values(), *camera, run.process.id):
        assert victim is not None, children
        os.kill(victim, signal.SIGSTOP)
        time.sleep(
            11.0 if victim == children["rig"] else 2.0
        )  # the longest promised, where most depends on it
        os.kill(victim, signal.SIGCONT)
    assert run.process.wait(4 * PATIENCE) == 0, run.text
    assert "ended: the profile has ended" in run.text
    for word in ("ERROR", "stood still", "output is zero", "drive-lost"):
        assert word not in run.text
    session = read_session(run.session)
    indices = [sample.index for sample in session.samples]
    assert indices == list(range(170)), (
        "a plant in step misses no tick, however busy the machine"
    )
    verified = verify_session(run.session)
    assert verified.identical, verified.difference
    assert verified.verdicts >= 2
    sent = session.messages(["/twin/forecast"])
    forecast = [deserialize_message(message.data, Forecast).sample for message in sent]
    assert len(forecast) > 20  # from the first match on, 90 s after the step
    assert forecast == sorted(set(forecast))
    assert forecast == indices[forecast[0] :]
    assert not control.parent.exists()
    wait_for(
        lambda: (
            not any(
                Path(f"/proc/{process_id}").exists()
                for process_id in (*children.values(), *camera)
            )
        ),
        "their end",
    )


@pytest.mark.long("every process of a run is killed, one after the other")
def test_processes_are_restarted_and_without_the_rig_the_output_is_off(
    live_run: Callable[..., LiveRun], processes: Processes
) -> None:
    """All in one run, whose profile does not end; a second graph beside it is refused.

    At eight times real time: it runs on while processes start, and nobody needs those samples.
    """
    run = live_run("--speed", "8", ends=False, board="auto")
    run.wait_until_driving()
    second = processes.python(LIVE, "--virtual", "--no-record")
    assert second.wait() == 2
    assert "/plant/sample already has a publisher" in second.text
    assert run.state()["pwm"] != 0
    # A killed recorder takes with it what it has not asked the nodes yet.
    wait_for_settings(run.session, "/matcher", "/discriminator")
    for name in ("twin", "recorder", "plant_clock"):
        run.restarts(name)
    run.wait_until((run.folder / "run_2").is_dir, "another folder")
    wait_for_recorded(run.folder / "run_2", twin__model_score=1)
    run.wait_until(lambda: abs(run.state()["pwm"]) > 5, "a driven plate")
    run.shoot("rig")
    after = before = run.state()["time"]
    while after - before < 20:
        state = run.state()
        after = state["time"]
        if state["pwm"] == 0 or not state["enabled"]:
            break
        time.sleep(0.01)
    # The board's deadline, one command, and what it takes to ask: the plant runs at real time now.
    assert after - before <= 2.5, f"{after - before} s of plant time"
    assert run.process.wait() == 3, run.text
    assert "rig was lost" in run.text
    assert "the output is off" in run.text
    repair_session(run.session)
    indices = [sample.index for sample in read_session(run.session).samples]
    assert indices == list(range(len(indices))), (
        "the pieces of the run are one session, and it is whole"
    )
    assert len(indices) > 3
    assert verify_session(run.session).identical


@contextmanager
def forger(listener: Listener, seconds: float) -> Iterator[None]:
    """Somebody who publishes a /clock of his own beside that of the run."""
    published = listener.node.create_publisher(Clock, "/clock", 10)
    ended = threading.Event()

    def forge() -> None:
        for k in count():
            published.publish(
                Clock(clock=Time(nanoseconds=round((seconds + k / 50) * 1e9)).to_msg())
            )
            if ended.wait(0.02):
                return

    thread = threading.Thread(target=forge)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        listener.node.destroy_publisher(published)


def forge_samples(listener: Listener) -> int:
    """Publish a false sample ahead of each of twelve, and stop; the index of the last."""
    heard = listener.hear(LoopSample, "plant/sample", EVERYTHING)
    listener.spin_until(lambda: heard, "samples")
    assert listener.samples
    first = heard[-1].index
    while heard[-1].index < first + 12:
        forged = copy.deepcopy(heard[-1])
        forged.index += 1
        forged.header.stamp.sec += 60
        forged.output[0] += 0.1
        listener.samples.publish(forged)
        before = len(heard)
        listener.spin_until(
            lambda before=before: len(heard) > before + 1, "the next one"
        )
    listener.node.destroy_publisher(listener.samples)
    return int(heard[-1].index)


@pytest.mark.long("a run beside programs that forge its messages")
def test_a_forged_clock_costs_the_drive_until_its_fault_is_cleared_and_forged_samples_are_doubted(
    live_run: Callable[..., LiveRun],
) -> None:
    """Nothing once the run has a clock; a forger who was there before keeps the output off until he goes.

    At eight times real time: what the test waits for needs no samples, and each costs processor time.
    """
    with listening() as listener:
        clearing = listener.node.create_client(Trigger, "plant/clear_fault")
        applied = listener.hear(PwmApplied, "plant/pwm_applied", RELIABLE)

        def driven() -> bool:
            """A fault is cleared once it is reported: what clears at every look keeps the gate closed."""
            if applied and applied[-1].fault:
                answer = clearing.call_async(Trigger.Request())
                listener.spin_until(answer.done, "an answer")
                applied.clear()
            return run.state()["pwm"] != 0.0

        with forger(listener, 2e9):
            run = live_run("--speed", "8", ends=False)
            run.process.said("/clock is published by listener and plant_clock")
            run.process.said("refused: /clock: ")
            listener.spin_until(clearing.service_is_ready, "the bridge")
        listener.spin_until(
            driven,
            lambda: (
                f"a driven plate: {run.state()}, {applied[-1:]}, {run.text[-2000:]}"
            ),
        )
        for seconds in (2e9, 0.0):
            before = run.state()["time"]
            with forger(listener, seconds):
                run.wait_until(
                    lambda before=before: run.state()["time"] > before + 5.0,
                    "plant time",
                )
        run.wait_until(lambda: abs(run.state()["pwm"]) > 5, "a driven plate")
        last = forge_samples(listener)
        wait_for_recorded(run.session, twin__model_score=1)
        assert run.process.end(signal.SIGINT) == 0, run.text
    assert "Traceback" not in run.text
    # Of two samples of one index the twin may take one and the recorder the other.
    doubted = [
        note for note in verify_session(run.session).notes if "are doubted" in note
    ]
    spans = [
        re.match(r"samples (\d+) to (\d+) are doubted: /plant/sample", note)
        for note in doubted
    ]
    assert any(m and int(m[1]) < last and int(m[2]) >= last - 1 for m in spans), doubted
    assert "controller and listener" in " ".join(doubted)


def test_an_operator_may_drive_without_a_session_and_without_the_virtual_rig_the_run_ends(
    live_run: Callable[..., LiveRun], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("here")
    run = live_run("--session", tmp_path / "file" / "run", "--keep-driving", ends=False)
    run.process.said(f"{tmp_path / 'file'} cannot be written .Not a directory.")
    run.wait_until_driven()
    run.shoot("virtual_rig")
    assert run.process.wait() == 3, run.text
    assert "virtual_rig was lost" in run.text
    assert "recorded: " not in run.text


def test_a_folder_that_cannot_be_written_is_said_before_anything_is_driven(
    live_run: Callable[..., LiveRun], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("here")
    run = live_run("--session", tmp_path / "file" / "run")
    assert run.process.wait() == 1, run.text
    assert f"{tmp_path / 'file'} cannot be written (Not a directory)" in run.text
    assert "; 0 samples" in run.text
    assert "recorded: " not in run.text


def fill_up(run: LiveRun, disk: Path) -> None:
    """Leave no room on its disk once the run has written something; its profile does not end before."""
    wait_for_recorded(run.session, plant__sample=10)
    fill(disk)
    run.process.said(f"no space left in {disk}")


def whole(session: Path) -> int:
    """How many samples a session kept, all up to where it ends."""
    indices = [sample.index for sample in read_session(session).samples]
    assert indices == list(range(len(indices)))
    return len(indices)


@pytest.mark.long(
    "a whole graph beside a disk that fills up; its parts are tested at the recorder and the launcher"
)
def test_a_disk_that_fills_up_ends_the_run(
    live_run: Callable[..., LiveRun], tmp_path: Path
) -> None:
    with small_disk(tmp_path / "disk", 64_000) as disk:
        run = live_run(disk=disk, ends=False)
        fill_up(run, disk)
        assert run.process.wait() == 1, run.text
        assert whole(run.session) >= 10
    assert "rejected its configuration" not in run.text
    assert "restarting" not in run.text
    assert "ended: recorder can no longer write the session" in run.text


def test_without_a_disk_the_operator_may_drive_on_and_a_camera_whose_readings_fall_ends_the_heat(
    live_run: Callable[..., LiveRun], tmp_path: Path
) -> None:
    """By 0.8 °C/s, at a set-point of 45 °C: the controller asks for full drive, and nothing reads too hot."""
    hottest = 0.0

    def look() -> bool:
        nonlocal hottest
        hottest = max(hottest, run.state()["plate"])
        return "output is zero" in run.text

    with small_disk(tmp_path / "disk", 64_000) as disk:
        run = live_run(
            "--fault", "sensor-drifts@80", "--keep-driving", disk=disk, ends=False
        )
        fill_up(run, disk)
        run.process.said("nothing is recorded any longer; the plant is driven on")
        run.process.said("sensor-drifts begins")
        run.wait_until(look, "zero")
        assert re.search(r"output is zero: (disagrees|budget|twin): ", run.text)
        assert "camera does not see" in run.text
        driven = run.state()["time"]
        assert run.process.end(signal.SIGINT) == 0, run.text
        assert 10 <= whole(run.session) < driven
    assert "restarting" not in run.text
    assert 45.0 < hottest < 60.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--speed", "20"), "need --virtual"),
        (("--virtual", "--session", "."), "exists already"),
        (
            ("--plant", "tclab", "--port", "/nowhere/ttyACM0"),
            "kit at /nowhere/ttyACM0: No such file",
        ),
        (
            ("--plant", "tclab", "--virtual", "--port", "/dev/ttyACM0"),
            "--port is for a real plant",
        ),
        (
            ("--plant", "tclab", "--twin-config", "config/twin.yaml"),
            "is for plant peltier",
        ),
    ],
)
def test_options_that_do_not_fit_are_refused(
    options: tuple[str, ...], words: str
) -> None:
    unrecorded = () if "--session" in options else ("--no-record",)
    result = run_twinmatch("live", *options, *unrecorded, folder=PROJECT)
    assert result.returncode == 2
    assert words in result.stderr
