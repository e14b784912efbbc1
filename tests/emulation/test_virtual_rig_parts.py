"""The parts of the virtual rig, each for itself."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.waiting import PATIENCE, wait_for
from twinmatch import shipped
from twinmatch.dynamics import Controller, begin, simulate_driven
from twinmatch.emulation import arduino_virtual, virtual_camera
from twinmatch.emulation.arduino import ArduinoError, PinDrive
from twinmatch.emulation.arduino_virtual import make_board, virtual_tools
from twinmatch.emulation.clock import (
    ClockClient,
    ClockError,
    ClockServer,
    Stillness,
    parse_address,
)
from twinmatch.emulation.faults import (
    KINDS,
    ControlServer,
    FaultError,
    FaultSchedule,
    RigControlError,
    RigFault,
    parse_faults,
    parse_now,
    tell,
)
from twinmatch.emulation.kit import VirtualKit
from twinmatch.emulation.plant_time import RigPace, RigSettings, VirtualPlantTime
from twinmatch.emulation.virtual_camera import VirtualCamera, VirtualCameraError
from twinmatch.emulation.virtual_rig import (
    RICH_RIG,
    SerialNoise,
    VirtualPlant,
    VirtualRig,
)
from twinmatch.plants import Peltier

INFINITE = float("inf")
KELVIN = 273.15
HOT = begin(RICH_RIG, 340.0 - KELVIN, starts={"sink": 300.0})


def test_faults_are_read_with_their_begin_and_duration() -> None:
    assert parse_faults("drive-lost@300,camera-gone@300+30") == (
        RigFault("drive-lost", 300.0, INFINITE),
        RigFault("camera-gone", 300.0, 30.0),
    )
    assert parse_now("fan-failed+2.5", 7.0) == RigFault("fan-failed", 7.0, 2.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("drive-last@3", "'drive-last' does not exist; did you mean drive-lost"),
        ("xyz@3", "'xyz' does not exist; choose one of drive-lost, "),
        ("drive-lost.x@3", "'drive-lost.x' does not exist; did you mean drive-lost"),
        ("drive-lost", "no time; write drive-lost@SECONDS"),
        ("drive-lost@", "'' is not a time"),
        ("drive-lost@-1", "'-1' is not a time"),
        ("drive-lost@nan", "'nan' is not a time"),
        ("drive-lost@1+0", "'0' is not a time"),
        ("drive-lost@1+inf", "'inf' is not a time"),
    ],
)
def test_faults_that_cannot_be_are_refused(text: str, message: str) -> None:
    with pytest.raises(FaultError, match=message):
        parse_faults(text)


def test_a_fault_of_one_sensor_leaves_the_other_alone() -> None:
    schedule = FaultSchedule(
        parse_faults(
            "sensor-offset.2@0,sensor-drifts@10,sensor-drifts.2@5,drive-lost.2@0"
        )
    )
    schedule.due(20.0)
    assert [schedule.told(40.0, 20.0, 20.0, number) for number in (1, 2)] == [
        40.0 - 8.0,
        45.0 - 12.0,
    ]
    assert [schedule.acts("drive-lost", number) for number in (1, 2)] == [False, True]


def test_a_kit_loses_one_heater_and_a_plate_has_only_one() -> None:
    pytest.importorskip("tclab", reason="pip install 'twinmatch[tclab]'")
    with VirtualKit(
        RigSettings(faults=parse_faults("drive-lost.2@0,sensor-frozen.1@0"))
    ) as kit:
        kit.board.heaters = [60.0, 60.0]
        for _ in range(12_000):
            kit.step()
        state = kit.state()
        first, second = map(kit.reading, (1, 2))
    assert state["heater"] > 40.0  # °C; what heats the second is the first alone
    assert state["second_heater"] < 30.0
    assert first < 22.0 < second
    with pytest.raises(
        FaultError, match=r"'drive-lost\.2': not available for this plant"
    ):
        VirtualRig(RigSettings(faults=parse_faults("drive-lost.2@3")))


@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted(KINDS)),
            st.integers(0, 50),
            st.integers(1, 20) | st.just(INFINITE),
        ),
        max_size=12,
    )
)
def test_a_fault_is_on_exactly_while_one_of_its_kind_lasts(
    spans: list[tuple[str, int, float]],
) -> None:
    schedule = FaultSchedule(
        RigFault(kind, float(start), float(length)) for kind, start, length in spans
    )
    on: set[str] = set()
    for second in range(80):
        for change in schedule.due(float(second)):
            # no change without a difference
            assert (change.kind in on) is not change.begins
            (on.add if change.begins else on.remove)(change.kind)
        assert on == {
            kind for kind, start, length in spans if start <= second < start + length
        }
        assert on == set(schedule.active)


def test_ending_a_fault_ends_all_of_its_kind() -> None:
    schedule = FaultSchedule(
        parse_faults("fan-failed@0,fan-failed@1,fan-failed@9,drive-lost@0")
    )
    schedule.due(2.0)
    schedule.end("fan-failed", 3.0)
    assert [(change.kind, change.begins) for change in schedule.due(20.0)] == [
        ("fan-failed", False)
    ]
    assert schedule.active == ("drive-lost",)
    with pytest.raises(FaultError, match="did you mean"):
        schedule.end("fan-fail", 4.0)


def test_the_plant_is_that_of_the_plant_room() -> None:
    plant = VirtualPlant()
    for _ in range(500):
        plant.advance(PinDrive(0.0, 100.0, enabled=True), 0.02)
    exact = simulate_driven(
        RICH_RIG,
        [100.0, 0.0],
        states=begin(RICH_RIG, RICH_RIG["ambient"] - KELVIN),
        period=10.0,
    ).output[1]
    assert plant.plate == pytest.approx(exact, abs=1e-5)


def test_the_loop_settles_on_its_reference() -> None:
    """Once the heat sink has: its time constant is a minute or two."""
    plant = VirtualPlant()
    law = Controller(Peltier.loop)
    drive = PinDrive(0.0, 0.0, enabled=True)
    for _ in range(1500):
        plant.advance(drive, 1.0)
        drive = drive._replace(pwm=law.step(60.0, plant.seen)[0])
    assert plant.seen == pytest.approx(60.0, abs=1e-3)
    assert 0.0 < drive.pwm < 255.0


@pytest.mark.parametrize("broken", [False, True])
def test_an_open_circuit_carries_no_current(broken: bool) -> None:
    plant = VirtualPlant()
    plant.states = HOT.copy()
    plant.wire_broken = broken
    drive = PinDrive(0.0, 200.0 if broken else 0.0, enabled=broken)
    plant.advance(drive, 1.0)
    # Conduction alone, K·ΔT/C for a second; a shorted module would cool the plate by another degree and more.
    lost = RICH_RIG["conductance"] * 40.0 / RICH_RIG["heat_capacity"]
    assert 340.0 - KELVIN - plant.plate == pytest.approx(lost, rel=0.05)
    assert plant.feedback(drive) == 0


def test_feedback_shows_the_supply_side() -> None:
    plant = VirtualPlant()
    assert plant.feedback(PinDrive(0.0, 255.0, enabled=True)) == pytest.approx(12 / 3.4)
    assert plant.feedback(PinDrive(0.0, -127.5, enabled=True)) == pytest.approx(
        12 / 3.4 / 4
    )
    plant.states = HOT.copy()
    # braking does not pass the supply
    assert plant.feedback(PinDrive(0.0, 0.0, enabled=True)) == 0


def test_faults_of_the_surroundings_change_the_rig() -> None:
    plant = VirtualPlant()
    plant.fan_failed = plant.warm_room = True
    assert plant.parameters["sink_convection"] == pytest.approx(
        0.1 * RICH_RIG["sink_convection"]
    )
    assert plant.parameters["ambient"] == RICH_RIG["ambient"] + 10
    plant.fan_failed = plant.warm_room = False
    assert plant.parameters == RICH_RIG


class Wall:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(
            "twinmatch.emulation.plant_time.time.monotonic", lambda: self.now
        )


def test_plant_time_keeps_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = Wall(monkeypatch)
    pace = RigPace(20.0)
    for step in range(1, 2001):
        wall.now += pace.wait(step * 0.02)
    assert wall.now == pytest.approx(102.0)
    assert pace.achieved() == pytest.approx(20.0, rel=0.01)
    assert pace.overall(40.0) == pytest.approx((2.0, 20.0))


@pytest.mark.parametrize(("speed", "made_up"), [(10.0, 0.2), (1.0, 5.0)])
def test_time_lost_to_a_busy_machine(
    monkeypatch: pytest.MonkeyPatch, speed: float, made_up: float
) -> None:
    """It is made up for at the wall clock's own pace, and up to a fifth of a second when sped up."""
    wall = Wall(monkeypatch)
    pace = RigPace(speed)
    pace.wait(0.01)
    wall.now += 5.0
    assert pace.wait(0.02) == 0.0
    free = next(step for step in range(1000) if pace.wait(0.02 + step * 0.01) > 0)
    assert free * 0.01 == pytest.approx(made_up, abs=0.021)


def test_an_address_has_a_host_and_a_port_or_is_refused() -> None:
    assert parse_address("localhost:80") == ("localhost", 80)
    assert parse_address("[::1]:80") == ("::1", 80)
    for text in ("", "localhost", "localhost:", ":1", "a:0", "a:65536", "a:1.5"):
        with pytest.raises(ClockError, match="give HOST:PORT"):
            parse_address(text)


def test_the_clock_reaches_its_readers_and_they_come_back() -> None:
    heard: list[int] = []
    server = ClockServer()
    client = ClockClient(server.address, heard.append)
    client.start()
    stamps = iter(range(1, 1_000_000))

    def tick() -> bool:
        server.send(next(stamps))
        return bool(heard)

    wait_for(tick, "the first update")
    address = server.address
    server.close()
    wait_for(lambda: client.error, "the loss")
    heard.clear()
    server = ClockServer(*address)
    wait_for(tick, "an update of the new server")
    assert client.close()
    assert client.failure is None
    server.close()


def test_a_reader_that_sleeps_misses_updates_and_holds_nobody_up() -> None:
    server = ClockServer()
    with socket.create_connection(server.address) as sleeper:
        sleeper.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for stamp in range(10**18, 10**18 + 40_000):
            server.send(stamp)
        server.close()
        received = sleeper.makefile("rb").read().split(b"\n")
    assert int(received[0]) == 10**18
    assert len(received) < 40_000


def test_a_stream_that_is_not_a_clock_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        client = ClockClient(listener.getsockname(), lambda _: None)
        client.start()
        connection, _ = listener.accept()
        with connection:
            connection.sendall(b"SSH-2.0\n")
            wait_for(lambda: "not the clock" in client.error, "the refusal")
        assert client.close()


def test_a_defect_of_a_reader_is_kept() -> None:
    def fail(_: int) -> None:
        raise ValueError("a defect")

    server = ClockServer()
    client = ClockClient(server.address, fail)
    client.start()

    def failed() -> bool:
        server.send(1)
        return client.failure is not None

    wait_for(failed, "the defect")
    assert client.close()
    server.close()


def test_a_clock_that_stands_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    time = 10.0
    monkeypatch.setattr("twinmatch.emulation.clock.time.monotonic", lambda: time)
    stillness = Stillness(1.0)
    stillness.tell(5)
    time = 10.9
    assert stillness.seconds() == 0
    stillness.tell(5)  # the rig waits for its readers, and says so
    time = 11.5
    assert stillness.seconds() == 0
    time = 12.4
    assert stillness.seconds() == pytest.approx(1.5)
    stillness.tell(4)
    assert (stillness.seconds(), stillness.set_backs) == (0, 1)


class Reader:
    """A reader of a clock that keeps step."""

    def __init__(self, server: ClockServer) -> None:
        self.connection = socket.create_connection(server.address)
        server.listen(PATIENCE)

    def say(self, server: ClockServer, *lines: str) -> None:
        self.connection.sendall("".join(f"{line}\n" for line in lines).encode())
        server.listen(PATIENCE)


def test_the_slowest_reader_that_keeps_step_limits_the_plant() -> None:
    server = ClockServer()
    # a page reads the time and says nothing
    rig, twin, page = (Reader(server) for _ in range(3))
    assert server.limit(0) == INFINITE
    assert not server.driven
    rig.say(server, "drive 100")
    twin.say(server, "follow 70", "nonsense", "follow x")
    assert server.driven
    assert server.limit(60) == 70
    twin.say(server, "follow 300")
    assert server.limit(60) == 100
    assert not server.breathing
    rig.say(server, "breathe 105")
    assert (server.limit(60), server.breathing, server.driven) == (105, True, True)
    rig.say(server, "drive 110")
    assert (server.limit(60), server.breathing) == (110, False)
    assert not server.lacks(90)
    rig.say(server, "image 80")
    assert server.lacks(90)
    rig.say(server, "image 90")
    assert not server.lacks(90)
    rig.connection.close()  # as the kernel does for a process that was killed
    server.listen(PATIENCE)
    assert not server.driven
    assert server.limit(60) == 300
    twin.connection.close()
    page.connection.close()
    server.close()


def test_a_reader_that_gives_no_sign_of_life_is_given_up_until_it_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    time = 10.0
    monkeypatch.setattr("twinmatch.emulation.clock.time.monotonic", lambda: time)
    server = ClockServer()
    rig = Reader(server)
    rig.say(server, "drive 100")
    assert server.limit(99) == 100
    time = 1000.0  # the plant was not waiting for it
    assert server.limit(100) == 100
    time = 1029.0
    assert server.limit(100) == 100
    time = 1031.0
    assert server.limit(100) == INFINITE
    assert not server.driven
    rig.say(server, "drive 200")
    assert server.limit(150) == 200
    assert server.driven
    rig.connection.close()
    server.close()


class Bare(VirtualPlantTime):
    """A plant of nothing but time."""

    KINDS = frozenset()
    board_kind = board_remark = "none"

    def make(self, stack: ExitStack) -> dict[str, str]:  # noqa: ARG002
        return {}

    def advance(self) -> None:
        self.ms += self.slice

    def turn(self, kind: str, *, on: bool) -> None: ...

    def state(self) -> dict[str, object]:
        return {"time": self.elapsed}


def test_a_plant_refuses_what_it_does_not_simulate() -> None:
    """A kind that is added is accepted by those plants alone that name it."""
    with pytest.raises(FaultError, match="not available for this plant"):
        Bare(RigSettings(faults=parse_faults("ambient-step@3")))
    simulated = {kind.partition(".")[0] for kind in VirtualKit.KINDS | VirtualRig.KINDS}
    assert simulated == set(KINDS)


def test_a_plant_in_step_goes_exactly_as_far_as_it_is_let_and_waits_there() -> None:
    heard: list[int] = []
    with Bare(RigSettings(speed=INFINITE, in_step=True, duration=100.0)) as plant:
        client = ClockClient(parse_address(plant.addresses["clock"]), heard.append)
        client.start()
        stops = [
            plant.stamp + round(1e9 * second)
            for second in (30.0, 30.1234, 77.0, 1000.0)
        ]
        waited: list[int] = []

        def watch() -> None:
            """Let it continue once it has waited at a stop for a while."""
            waited.append(plant.stamp)
            if not stops or plant.stamp >= stops[0]:
                del stops[:1]
            if stops:
                client.say("drive", stops[0])

        before = plant.stamp
        plant.run(watch)
        assert plant.elapsed == 100.0
        assert client.close()
    assert {
        before + 30_000_000_000,
        before + 30_124_000_000,
        before + 77_000_000_000,
    } <= set(waited)
    assert heard == sorted(heard)


def test_who_drives_with_a_wrong_time_receives_that_of_the_plant() -> None:
    """A forged /clock may have let it continue for years: it would not stop, and never tell the time."""
    heard: list[int] = []
    with Bare(RigSettings(speed=50.0, in_step=True)) as plant:
        client = ClockClient(parse_address(plant.addresses["clock"]), heard.append)
        client.start()
        client.say("drive", 2 * plant.stamp)
        driven: list[int] = []

        def watch() -> None:
            """End once it has told a time at which it was driven."""
            driven.extend([plant.stamp] if plant.driven else [])
            if driven and any(stamp >= driven[0] for stamp in heard):
                plant.request_stop()

        thread = threading.Timer(PATIENCE, plant.request_stop)
        thread.start()
        plant.run(watch)
        thread.cancel()
        assert client.close()
    assert heard[-1] >= driven[0]


def test_without_a_process_that_drives_it_a_plant_in_step_keeps_real_time() -> None:
    with Bare(RigSettings(speed=INFINITE, in_step=True, duration=0.3)) as plant:
        plant.run()
        wall, _ = plant.achieved()
    assert wall >= 0.29
    with Bare(RigSettings(speed=INFINITE, duration=1000.0)) as plant:
        plant.run()
        _, speed = plant.achieved()
    assert speed > 100


def test_control_answers_each_line(tmp_path: Path) -> None:
    def obey(line: str) -> str:
        if line == "no":
            raise FaultError("it cannot be")
        return line.upper()

    server = ControlServer(tmp_path / "control", obey)
    stop = threading.Event()

    def serve() -> None:
        while not stop.wait(0.001):
            server.attend()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        assert tell(server.path, "hello") == "HELLO"
        with pytest.raises(RigControlError, match="it cannot be"):
            tell(server.path, "no")
        with pytest.raises(RigControlError, match="no answer"):
            tell(server.path, "x" * 600)
    finally:
        stop.set()
        thread.join()
        server.close()
    with pytest.raises(RigControlError, match="give the address it prints"):
        tell(server.path, "hello")


def test_without_a_host_two_runs_agree_to_the_last_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    faults = parse_faults(
        "ambient-step@1,fan-failed@1,sensor-frozen@1+1,cable-pulled@2,camera-gone@3"
    )
    settings = RigSettings(speed=20, board="python", seed=3, faults=faults)
    runs = []
    for _ in range(2):
        with VirtualRig(settings) as rig:
            assert Path(rig.addresses["serial"]).exists()
            states = []
            while rig.elapsed < 4.0:
                rig.step()
                states.append(
                    (rig.plant.states.tolist(), rig.drive, rig.state()["faults"])
                )
            assert not Path(rig.addresses["serial"]).exists()
        runs.append(states)
    assert runs[0] == runs[1]
    assert runs[0][-1][0][1] > RICH_RIG["ambient"]
    assert runs[0][-1][2] == [
        "ambient-step",
        "fan-failed",
        "cable-pulled",
        "camera-gone",
    ]
    assert list(tmp_path.iterdir()) == []


def test_without_a_simulator_the_stand_in_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(ArduinoError, match="cannot be built in"):
        virtual_tools()
    monkeypatch.setattr(arduino_virtual, "_PROJECT", tmp_path)
    with pytest.raises(ArduinoError, match="its sources are not installed"):
        make_board("simavr", tmp_path / "tty")
    with pytest.raises(ArduinoError, match="'esp32' does not exist"):
        make_board("esp32", tmp_path / "tty")
    stand_in = make_board("auto", tmp_path / "tty")
    assert stand_in.kind == "python"
    assert "its sources are not installed" in stand_in.remark
    stand_in.board.close()


def test_noise_on_the_line_writes_and_takes(tmp_path: Path) -> None:
    with make_board("python", tmp_path / "tty").board as board:  # type: ignore[attr-defined]
        noise = SerialNoise(board.port, seed=1)
        host = os.open(board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        heard = b""
        for _ in range(400):
            board.advance(0.001)
            noise.burst()
            try:
                heard += os.read(host, 100)
            except BlockingIOError:
                continue
        os.close(host)
        board.unplug()
        noise.burst()  # there is nothing to disturb
    assert b"2A8A\n" in heard  # the ends of the board's refusals
    assert b":E - CRC*2A8A\n" not in heard  # of each of which it took a part


def test_a_camera_program_that_cannot_listen_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(
        VirtualCameraError, match=r"has ended unexpectedly: .*emulated Lepton"
    ):
        VirtualCamera(ambient=float("nan"))
    monkeypatch.setattr(shipped, "__file__", "/nowhere/src/twinmatch/shipped.py")
    monkeypatch.setattr("sys.prefix", "/nowhere")
    with pytest.raises(
        VirtualCameraError,
        match=r"camera_server/src is in none of .*; reinstall twinmatch",
    ):
        VirtualCamera(ambient=22.0)


def test_a_camera_program_that_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(virtual_camera.VirtualCamera, "PATIENCE", 0.05)
    real = subprocess.Popen

    def slow(_: list[str], **settings: object) -> object:
        return real(["sleep", "60"], **settings)  # type: ignore[call-overload]

    monkeypatch.setattr("twinmatch.emulation.virtual_camera.subprocess.Popen", slow)
    with pytest.raises(VirtualCameraError, match=r"was not ready after 0.05 s"):
        VirtualCamera(ambient=22.0)


def test_any_structure_of_the_rig_can_be_the_truth() -> None:
    richest = list(Peltier.structures)[-1]
    plant = VirtualPlant(
        Peltier.model(richest).parameters(
            drive_ripple=1.0, sensor_lag=2.0, seebeck_slope=1e-4
        )
    )
    for _ in range(100):
        plant.advance(PinDrive(0.0, 200.0, enabled=True), 0.02)
    assert plant.plate - plant.seen > 2.0  # the camera lags behind
    massless = VirtualPlant(Peltier.model().parameters(ambient=290.0))
    massless.fan_failed = True
    massless.advance(PinDrive(0.0, 200.0, enabled=True), 10.0)
    assert massless.sink == pytest.approx(290.0 - KELVIN)
    assert massless.plate > 30.0
