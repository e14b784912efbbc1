"""The command line as a user meets it: what it prints, writes and exits with."""

from __future__ import annotations

import errno
import fcntl
import gc
import io
import itertools
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.io

from tests.support.colours import drawn
from tests.support.places import PROJECT, SHIPPED
from tests.support.processes import Process, run_twinmatch
from tests.support.steps import drive_lost, quarter_of_an_hour
from twinmatch.cli import main
from twinmatch.cli.shared import Progress
from twinmatch.compiled import compiled
from twinmatch.importing import open_any
from twinmatch.launching.forking import fork_server
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.offline.processes import GARBAGE, LASTING_GARBAGE, held_interrupts
from twinmatch.sessions import read_session, samples_of, write_session
from twinmatch.showing.console import Console
from twinmatch.showing.terminal import Screen
from twinmatch.signals import Sample, Window
from twinmatch.twin import Outcome, Twin

TERMINAL_VARIABLES = (
    "NO_COLOR",
    "FORCE_COLOR",
    "COLUMNS",
    "LINES",
    "TTY_COMPATIBLE",
    "TTY_INTERACTIVE",
)
"""Variables of the user who runs the tests; they would change what a terminal is shown."""


def run(
    *arguments: object, cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    return run_twinmatch(*arguments, folder=cwd)


@pytest.fixture
def small_session(tmp_path: Path) -> Path:
    """A minute and a half with one step; the plate follows at once."""
    reference = np.repeat([30.0, 50.0], 45)
    return write_session(
        tmp_path / "small", samples_of(Window(reference, reference, reference / 2))
    )


WITHOUT_ROS = """
import sys
for name in ("rclpy", "diagnostic_msgs", "sensor_msgs", "std_msgs", "std_srvs", "twinmatch_msgs"):
    sys.modules[name] = None  # as if it were not installed
from twinmatch.cli import main
from twinmatch.nodes.__main__ import main as node
for sys.argv in (["sampler"], ["/usr/bin/rig"], ["-m", "matcher"]):
    try:
        node()
    except SystemExit as end:
        assert end.code == 2
for command in (
    ["demo"], ["live"], ["play", "session"], ["dashboard"], ["foxglove"], ["apply", "law.json"],
    ["apply", "--back"], ["attach"], ["experiment", "--live"], ["experiment", "--live", "--go"],
):
    assert main(command) == 2
"""


def test_commands_of_the_graph_say_that_they_need_ros() -> None:
    completed = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROS], capture_output=True, text=True, check=True
    )
    needs = "needs ROS 2: rclpy, diagnostic_msgs, twinmatch_msgs cannot be found; run make setup"
    programs = (
        "sampler",
        "rig",
        "matcher",
        "demo",
        "live",
        "play",
        "dashboard",
        "foxglove",
    )
    programs += ("apply", "apply", "attach", "experiment", "experiment")
    lines = completed.stderr.splitlines()
    for command, line in zip(programs, lines, strict=True):
        assert line.startswith(f"twinmatch: {command} {needs}"), line
    assert lines[-3].endswith("; for a plant without ROS, give --source URL")
    assert lines[-1].endswith("; without --live it works on a recorded SESSION")


WITHOUT_EXTRAS = """
import json
import sys
for name in json.loads(sys.argv[1]):
    sys.modules[name] = None  # as if it were not installed
from twinmatch.cli import main
for command in json.loads(sys.argv[2]):
    print(main(command), flush=True)
"""
ALONE = ("--alone", "--map", "output=a", "input=b", "--plant", "peltier", "--no-record")
BEHIND_EXTRAS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("paho", ("attach", "--source", "mqtt://127.0.0.1:1", "--list"), "mqtt"),
    ("paho", ("attach", "--source", "mqtt://127.0.0.1:1", *ALONE), "mqtt"),
    ("pymodbus", ("attach", "--source", "modbus://127.0.0.1:1/1", "--list"), "modbus"),
    ("bokeh", ("dashboard",), "dashboard"),
    ("foxglove", ("foxglove",), "foxglove"),
    ("tclab", ("virtual-rig", "--plant", "tclab", "--duration", "1"), "tclab"),
    ("rosbags", ("import", "BAG", "--list"), "bags"),
    (
        "rosbags",
        (
            "import",
            "BAG",
            "--plant",
            "peltier",
            "--map",
            "output=/a",
            "input=/b",
            "-o",
            "S",
        ),
        "bags",
    ),
    ("fmpy", ("fmu", "model.fmu"), "fmu"),
    ("fmpy", ("replay", "SESSION", "--allow-fmu", "MAP"), "fmu"),
    ("fmpy", ("forecast", "SESSION", "--allow-fmu", "MAP", "--at", "9"), "fmu"),
    (
        "distributed",
        ("replay", "SESSION", "--scheduler", "127.0.0.1:1", "--out", "OUT"),
        "cluster",
    ),
)
"""Packages with a command that needs them, and the extra to install."""


def test_a_command_without_its_extra_says_what_to_install(
    tmp_path: Path, small_session: Path
) -> None:
    (tmp_path / "bag.bag").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "model.fmu").write_bytes(b"")
    structures = {
        "a": {"fmu": "model.fmu", "variables": {"temperature": "t", "pwm": "u"}}
    }
    (tmp_path / "map.yaml").write_text(
        json.dumps({"plant": "peltier", "structures": structures})
    )
    files = {
        "BAG": "bag.bag",
        "SESSION": str(small_session),
        "MAP": "map.yaml",
        "OUT": "results",
    }
    packages = sorted({package for package, _, _ in BEHIND_EXTRAS})
    commands = []
    for _, words, _ in BEHIND_EXTRAS:
        commands.append([files.get(word, word) for word in words])
    completed = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS, json.dumps(packages), json.dumps(commands)],
        capture_output=True, text=True, check=True, cwd=tmp_path,
    )  # fmt: skip
    assert completed.stdout.split() == ["2"] * len(commands)
    for (package, command, extra), line in zip(
        BEHIND_EXTRAS, completed.stderr.splitlines(), strict=True
    ):
        assert line.startswith("twinmatch: "), command
        assert package in line, command
        assert line.endswith(f"pip install 'twinmatch[{extra}]'"), (command, line)


def test_work_of_unknown_length_is_reported_without_a_share(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Progress, "SILENCE", 0.0)
    with Progress() as progress:
        progress.show("reading the description", 0, 0)
    assert capsys.readouterr().err == "twinmatch: reading the description\n"


def test_reading_a_long_table_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Progress, "SILENCE", 0.0)
    rows = "".join(f"{k},{20 + k % 7},{k % 2}\n" for k in range(12_000))
    (tmp_path / "log.csv").write_text(f"t,T,duty\n{rows}")
    assert main(["import", str(tmp_path / "log.csv"), "--list"]) == 0
    assert re.search(
        r"^twinmatch: reading, \d+% done$", capsys.readouterr().err, re.MULTILINE
    )


class Replayed(NamedTuple):
    """A replay of the first half of the shipped session on a wide terminal."""

    code: int
    written: str
    stands: str
    json: Path
    figure: Path


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    out = tmp_path_factory.mktemp("replayed")
    files = out / "out.json", out / "verdict.png"
    half = write_session(out / "four_setpoints", read_session(SHIPPED).samples[:1010])
    run_of_replay = run_on_terminal(
        "replay", half, "--json", files[0], "--figure", files[1], width=160
    )
    return Replayed(*run_of_replay, *files)


def test_a_replay_gives_the_documented_json(replayed: Replayed) -> None:
    assert drawn(replayed.figure) > 0.01
    judged = json.loads(replayed.json.read_text())
    assert judged["session"] == "four_setpoints"
    assert len(judged["verdicts"]) >= 8
    last = judged["verdicts"][-1]
    assert set(last) >= {
        "sample",
        "first",
        "last",
        "level",
        "nominal",
        "decimals",
        "candidates",
        "nu_gap",
    }
    assert last["decimals"] == 2
    family = [c for c in last["candidates"] if c["orders"]]
    assert last["leader"] in {c["name"] for c in last["candidates"]}
    for candidate in family:
        assert set(candidate["parameters"]) >= {
            "seebeck",
            "resistance",
            "conductance",
            "heat_capacity",
        }
        assert candidate["parameters"]["resistance"] == 3.3
        assert [o["order"] for o in candidate["orders"]] == [
            "22221",
            "33331",
            "44441",
            "55551",
        ]
        for order in candidate["orders"]:
            for output in ("y", "u", "total"):
                assert set(order[output]) >= {"gain", "naic", "bic", "mdl"}
        assert candidate["chosen_order"] in {o["order"] for o in candidate["orders"]}
    sums = np.array(last["nu_gap"])[: len(family)].sum(axis=0)
    np.testing.assert_allclose(
        sums, [c["nu_gap_sum"] for c in last["candidates"]], rtol=1e-12
    )
    assert family[int(np.argmin(sums[: len(family)]))]["name"] == last["nominal"]
    summary = judged["summary"]
    assert summary["nominal"] == last["nominal"]
    assert summary["fit"]["y"] > 0.97
    assert summary["parameters"]["seebeck"] == pytest.approx(0.06, rel=0.2)


def test_a_recording_becomes_a_session_with_the_same_samples(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    r = np.full(50, 40.0)
    y = r + rng.normal(size=50)
    u = rng.uniform(-255, 255, 50)
    scipy.io.savemat(
        tmp_path / "run.mat", {"simout": np.column_stack([u, y, np.arange(50.0), r])}
    )
    result = run("import", tmp_path / "run.mat", "-o", tmp_path / "session")
    assert result.returncode == 0, result.stderr
    assert "50 samples" in result.stdout
    assert (tmp_path / "session" / "metadata.yaml").is_file()


def test_a_truncated_session_is_judged_as_far_as_it_goes_and_that_is_said(
    tmp_path: Path,
) -> None:
    whole = (SHIPPED / "four_setpoints_0.mcap").read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: len(whole) // 2])
    result = run("replay", torn)
    assert result.returncode == 0, result.stderr
    assert "Note:" in result.stdout
    assert "samples" in result.stdout.split("Note:")[1]


def test_a_family_to_begin_with_is_judged_too(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    paper = PROJECT / "config" / "paper_candidates.yaml"
    begun = write_session(tmp_path / "begun", open_any(SHIPPED).samples[:450])
    assert run("replay", begun, "--candidates", paper, "--json", out).returncode == 0
    first = next(v for v in json.loads(out.read_text())["verdicts"] if not v["stands"])
    assert {c["name"] for c in first["candidates"]} >= {
        "paper 30 °C",
        "paper 70 °C",
        "paper 90 °C",
    }


def test_a_session_in_which_nothing_moves_has_no_nominal(small_session: Path) -> None:
    result = run("replay", small_session)
    assert result.returncode == 0
    assert "No twin to trust yet" in result.stdout


def test_a_session_is_overwritten_if_asked(small_session: Path, tmp_path: Path) -> None:
    rows = np.column_stack(
        [np.zeros(20), np.full(20, 30.0), np.arange(20.0), np.full(20, 30.0)]
    )
    scipy.io.savemat(tmp_path / "run.mat", {"simout": rows})
    assert (
        run(
            "import", tmp_path / "run.mat", "-o", small_session, "--overwrite"
        ).returncode
        == 0
    )


@pytest.fixture(scope="module")
def fault_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve minutes, in the eleventh of which the drive is lost."""
    return write_session(tmp_path_factory.mktemp("fault") / "drive_lost", drive_lost())


def run_on_terminal(
    *arguments: object, width: int, until: str = "", **environment: str
) -> tuple[int, str, str]:
    """Exit code, all that was written to a pseudo-terminal of this width, and what still stands on it.

    It is killed as soon as the pattern `until` was written.
    """
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 60, width, 0, 0))
    inherited = {k: v for k, v in os.environ.items() if k not in TERMINAL_VARIABLES}
    process = fork_server().start(
        "-m",
        "twinmatch.cli",
        *map(str, arguments),
        output=theirs,
        environment={**inherited, "TERM": "xterm-256color", **environment},
    )
    os.close(theirs)
    written = b""
    try:
        while chunk := os.read(ours, 65536):
            written += chunk
            if until and re.search(until, written.decode(errors="ignore")):
                process.kill()
    except OSError as error:  # how Linux tells that the other side was closed
        if error.errno != errno.EIO:
            raise
    finally:
        os.close(ours)
    text = written.decode().replace("\r\n", "\n")
    stands = re.split(r"\x1b\[1A\x1b\[2K", text)[-1]
    return process.wait(120), text, re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", stands)


def test_a_terminal_shows_the_run_and_ends_with_the_sentence(
    replayed: Replayed,
) -> None:
    code, written, stands, *_ = replayed
    assert code == 0
    # drawn while it continued
    assert len(re.findall(r"four_setpoints.* \d+ %, ", written)) > 2
    assert re.search(r"\x1b\[[0-9;]*32[0-9;]*m TRUSTED ", written)
    # the cursor comes back
    assert written.count("\x1b[?25l") == written.count("\x1b[?25h") == 1
    lines = stands.splitlines()
    assert "100 %, 0:16:50 of 0:16:50 h" in lines[0]
    header = next(line for line in lines if line.startswith("candidate"))
    assert header.split() == [
        "candidate",
        "°C",
        "mV/K",
        "W/K",
        "J/K",
        "order",
        "characters",
        "nAIC",
        "BIC",
        "°C²+PWM²",
        *["Σ", "ν-gap", "90", "%", "of", "Σ", "P(nominal)", "ν-gap", "now", "margin"],
    ]
    ended = stands[stands.index("Leader: ") :]
    assert re.search(r"trust it [\d, and]+ s ahead between", " ".join(ended.split()))
    assert re.search(
        r"^Nominal, the centre of the family: match at .* \(orders \d{5}\)\.$",
        ended,
        re.MULTILINE,
    )


def test_long_work_is_reported_in_lines_where_nobody_sees_a_bar(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Progress("checking") as progress:
        progress.show("checking structure a", 1, 4)
        monkeypatch.setattr(Progress, "SILENCE", 0.0)
        progress.show("checking structure b", 2, 4)
    assert capsys.readouterr().err == "twinmatch: checking structure b, 50% done\n"


def kernel() -> Any:
    """One that no folder keeps, so it is compiled at its first call."""
    space: dict[str, Any] = {}
    exec("def _twice_it(x):\n    return 2.0 * x", space)
    return compiled(space["_twice_it"])


def test_the_first_kernel_of_a_first_run_is_reported_at_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Progress, "SILENCE", 3600.0)
    with Progress("preparing") as progress:
        progress.advance(1, 4)
        assert not capsys.readouterr().err
        assert kernel()(2.0) == 4.0
        assert kernel()(2.0) == 4.0
    assert capsys.readouterr().err.count("compiling") == 1


def test_what_is_compiled_is_said_once_by_progress_and_screen(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Progress, "SILENCE", 0.0)
    with Progress() as progress:
        progress.advance(1, 4)
        assert kernel()(2.0) == 4.0
    words = "judging, compiling twice it once on this machine (1 so far), 25% done"
    assert words in capsys.readouterr().err
    stream = io.StringIO()
    screen = Screen(
        Console(file=stream, force_terminal=True, width=100, height=40), "kit", 1.0, 600
    )
    screen.open()
    assert kernel()(2.0) == 4.0
    screen.close()
    assert "compiling twice it once on this machine" in stream.getvalue()
    assert kernel()(2.0) == 4.0
    assert not capsys.readouterr().err


def test_a_terminal_shows_the_progress_of_reading_a_session(tmp_path: Path) -> None:
    reference = np.repeat([30.0, 50.0], 2000)
    session = write_session(
        tmp_path / "long", samples_of(Window(reference, reference, reference / 2))
    )
    for command in (
        ["verify"],
        ["backtest"],
        ["forecast", "--at", "3500"],
        ["report", "-o", tmp_path / "r.html"],
    ):
        shown = r"reading .* \d+%"
        _, written, _ = run_on_terminal(
            command[0], session, *command[1:], width=100, until=shown
        )
        assert re.search(shown, written), (command, written[:2000])


def test_a_narrow_terminal_without_colours_cuts_no_number(fault_session: Path) -> None:
    code, written, stands = run_on_terminal(
        "replay", fault_session, width=60, NO_COLOR="1"
    )
    assert code == 0
    assert not re.search(r"\x1b\[(?:[0-9]+;)*(?:3[0-8]|4[0-8]|9[0-7])[;m]", written)
    lines = stands.splitlines()
    assert max(len(line.rstrip()) for line in lines) <= 60
    rows = [line for line in lines if re.match(r"[▶ ][○ ] \d+ °C", line)]
    assert len(rows) >= 2
    for row in rows:
        cells = re.split(r" {2,}", row[3:].strip())
        assert all(
            re.fullmatch(r"−?\d+(\.\d+)?\*?|\d\d\d\d1|–", cell) for cell in cells[1:]
        ), row
    words = " ".join(" ".join(lines).split())
    assert "fault drive-lost since" in words
    assert (
        "do not trust it now: the plant shows drive-lost"
        in words.rpartition("Leader: ")[2]
    )


def test_a_pipe_gets_plain_lines_and_the_sentence_at_the_end(
    fault_session: Path,
) -> None:
    result = run("replay", fault_session)
    assert result.returncode == 0
    assert result.stderr == ""
    assert "\x1b" not in result.stdout
    header, *lines = result.stdout.splitlines()
    assert header.startswith("t / s")
    verdicts = [
        (line, below)
        for line, below in itertools.pairwise(lines)
        if re.match(r"\d+ ", line)
    ]
    leader = header.index("leader")
    assert all(
        len(line) > leader and line[leader - 2 : leader] == "  " for line, _ in verdicts
    )
    assert all(below.startswith(" " * header.index("level")) for _, below in verdicts)
    alarm_line, reason = next(
        (line, below) for line, below in verdicts if " fault " in line
    )
    assert 640 <= int(alarm_line.split()[0]) < 660  # at once, not at the next trigger
    assert reason.lstrip().startswith("drive-lost: ")
    assert len({line.split()[0] for line, _ in verdicts}) == len(verdicts)
    *_, summed_up, nominal, certainty = lines
    assert summed_up.startswith("Leader: ")
    assert "do not trust it now: the plant shows drive-lost" in summed_up
    assert re.search(r"Faults: drive-lost since 6\d\d s\.$", summed_up)
    assert nominal.startswith("Nominal, the centre of the family: match at ")
    assert certainty.startswith("Certainty: ")


def test_a_dumb_terminal_gets_plain_lines(small_session: Path) -> None:
    code, written, _ = run_on_terminal("replay", small_session, width=80, TERM="dumb")
    assert code == 0
    assert "\x1b" not in written
    assert written.startswith("t / s")
    assert written.splitlines()[-1].startswith("No twin to trust yet")


def test_an_error_on_a_terminal_is_one_line(tmp_path: Path) -> None:
    code, written, _ = run_on_terminal("replay", tmp_path / "absent", width=80)
    assert code == 2
    assert len(written.splitlines()) == 1
    assert "absent" in written


def test_ctrl_c_ends_a_replay_with_one_line_and_its_code(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "twinmatch.cli", "replay", SHIPPED]
    process = Process(*command, output=tmp_path / "said", forked=True)
    process.said("^t / s")  # judging has begun
    assert process.end(signal.SIGINT) == 130
    assert process.lines[-1] == "twinmatch: interrupted"
    assert "Traceback" not in process.text


ENDING = """
import atexit, gc

# what is registered first is called last
atexit.register(lambda: print(gc.get_freeze_count() > 0))
from twinmatch.cli import main

main(["memory", "--help"])
"""


def test_a_command_leaves_its_objects_to_the_end_of_the_process(tmp_path: Path) -> None:
    """Python's last collection, which would look at all of them, finds none."""
    process = Process(sys.executable, "-c", ENDING, output=tmp_path / "said")
    assert process.wait() == 0
    assert process.lines[-1] == "True"


def test_only_what_runs_for_days_has_its_garbage_collected_often(
    tmp_path: Path, capsys: Any
) -> None:
    before = gc.get_threshold()
    nowhere = str(tmp_path / "nowhere")
    try:
        assert main(["replay", nowhere]) == 2
        assert gc.get_threshold()[0] == GARBAGE
        assert main(["virtual-rig", "--tell", nowhere, "stop"]) == 2
        assert gc.get_threshold()[0] == LASTING_GARBAGE
    finally:
        gc.set_threshold(*before)
    assert capsys.readouterr().err.count(nowhere) == 2


def test_ctrl_c_while_judging_takes_effect_between_two_samples(
    small_session: Path,
) -> None:
    """In every command that judges: they all do it here."""
    session = open_any(small_session)
    judged_indices: list[int] = []

    def told(_twin: Twin, sample: Sample, _outcome: Outcome) -> None:
        signal.raise_signal(signal.SIGINT)
        judged_indices.append(sample.index)

    with pytest.raises(KeyboardInterrupt):
        judge(session, terms_from_files(session), beside=told)
    assert judged_indices == [0]


def test_a_held_interrupt_is_raised_when_asked_for_and_at_the_latest_at_the_end() -> (
    None
):
    reached = []

    def work(*, ask: bool) -> None:
        with held_interrupts() as check:
            check()
            signal.raise_signal(signal.SIGINT)
            reached.append("held")
            if ask:
                check()
            reached.append("end")

    with pytest.raises(KeyboardInterrupt):
        work(ask=True)
    with pytest.raises(KeyboardInterrupt):
        work(ask=False)
    assert reached == ["held", "held", "end"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_before_an_inner_block_takes_effect_in_it() -> None:
    """A command holds interrupts from its start on, and the judging that it calls holds them again."""
    reached = []

    def work() -> None:
        with held_interrupts():
            signal.raise_signal(signal.SIGINT)
            with held_interrupts() as check:
                reached.append("inner")
                check()
                reached.append("not reached")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert reached == ["inner"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# `twinmatch forecast` as a user meets it.

AT = 700
"""In the middle of a transient: the set-point went from 60 to 45 °C at sample 660."""


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return quarter_of_an_hour()


@pytest.fixture(scope="module")
def session(samples: list[Sample], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_session(tmp_path_factory.mktemp("forecast") / "quarter", samples)


def asked(session: Path, out: Path, *options: object) -> list[dict[str, Any]]:
    assert main(["forecast", str(session), "--json", str(out), *map(str, options)]) == 0
    forecasts: list[dict[str, Any]] = json.loads(out.read_text(encoding="utf-8"))
    return forecasts


@pytest.fixture(scope="module")
def in_a_transient(
    session: Path, tmp_path_factory: pytest.TempPathFactory
) -> list[dict[str, Any]]:
    """Two forecasts in the middle of it, and between them one from before it."""
    out = tmp_path_factory.mktemp("transient") / "out.json"
    return asked(session, out, "--at", AT, 500, "--at", AT, "--horizon", 60)


def test_the_json_is_a_list_in_the_order_that_was_asked_for(
    in_a_transient: list[dict[str, Any]],
) -> None:
    forecasts = in_a_transient
    assert [f["sample"] for f in forecasts] == [AT, 500, AT]
    assert forecasts[0] == forecasts[2]
    for forecast in forecasts:
        assert set(forecast) == {
            *(
                "sample",
                "candidate",
                "structure",
                "confidence",
                "t",
                "y",
                "u",
                "reference",
                "notes",
            ),
        }
        assert forecast["confidence"] == 0.9
        assert forecast["t"] == [float(k) for k in range(1, 61)]
        for name in ("y", "u"):
            assert set(forecast[name]) == {"mean", "low", "high"}
            low, mean, high = (
                np.array(forecast[name][edge]) for edge in ("low", "mean", "high")
            )
            assert low.size == 60
            assert np.all(low <= mean)
            assert np.all(mean <= high)
    assert forecasts[1]["reference"] == [60.0] * 60  # held as it was
    assert forecasts[0]["reference"] == [45.0] * 60


def test_the_recorded_set_points_are_all_it_knows(
    samples: list[Sample], session: Path, tmp_path: Path
) -> None:
    with_recorded = asked(
        session,
        tmp_path / "told.json",
        "--at",
        600,
        "--reference",
        "recorded",
        "--horizon",
        120,
    )[0]
    assert with_recorded["reference"] == [60.0] * 59 + [45.0] * 61
    rows = "\n".join(f"{k - 600},{samples[k].reference}" for k in range(601, 721))
    (tmp_path / "ahead.csv").write_text(f"time,set-point\n{rows}\n", encoding="utf-8")
    cut = write_session(tmp_path / "cut", samples[:601])
    alone = asked(
        cut,
        tmp_path / "cut.json",
        "--at",
        600,
        "--reference",
        tmp_path / "ahead.csv",
        "--horizon",
        120,
    )[0]
    assert alone == with_recorded  # JSON gives every float64 back


def test_recorded_set_points_end_with_the_session(
    samples: list[Sample], tmp_path: Path
) -> None:
    short = write_session(tmp_path / "short", samples[:420])
    forecast = asked(
        short, tmp_path / "out.json", "--at", 400, "--reference", "recorded"
    )[0]
    assert len(forecast["t"]) == 19
    assert "shortened to 19 s: the session ends there" in forecast["notes"]


def test_another_candidate_may_be_asked(
    session: Path, in_a_transient: list[dict[str, Any]], tmp_path: Path, capsys: Any
) -> None:
    leader = in_a_transient[0]
    of_second = asked(
        session,
        tmp_path / "b.json",
        "--at",
        AT,
        "--candidate",
        "60 °C",
        "--horizon",
        20,
    )[0]
    assert leader["candidate"] != of_second["candidate"] == "60 °C"
    assert f"the leader is {leader['candidate']}" in capsys.readouterr().out


def test_what_was_never_visited_is_noted(
    session: Path, in_a_transient: list[dict[str, Any]], tmp_path: Path, capsys: Any
) -> None:
    forecast = asked(session, tmp_path / "out.json", "--at", AT, "--hold", 88)[0]
    assert any("was visited" in note for note in forecast["notes"])
    assert "Note: the forecast covers " in capsys.readouterr().out
    assert not in_a_transient[0]["notes"], "45 °C lie among those that were visited"


def test_the_answer_is_printed_as_sentences(
    session: Path, tmp_path: Path, capsys: Any
) -> None:
    picture = tmp_path / "fan.png"
    assert (
        main(
            [
                "forecast",
                str(session),
                "--at",
                "500",
                "--hold",
                "80",
                "--figure",
                str(picture),
            ]
        )
        == 0
    )
    printed = capsys.readouterr().out
    for words in (
        "At 500 s (sample 500), 80 °C held:",
        "forecasts 300 s; the leader (confidence 0.",
        "temperature after 300 s: 80.",
        "within 1 °C of 80 °C: first after ",
        "largest control: 255 PWM after 1 s",
        "at 10 s; ",
        "at 60 s; ",
        "at 300 s",
        "The leader is the candidate to forecast with",
    ):
        assert words in printed
    # the session continued under other set-points
    assert "compared with" not in printed
    assert drawn(picture) > 0.01


def test_it_is_compared_with_the_measurements(session: Path, capsys: Any) -> None:
    assert main(["forecast", str(session), "--at", "400"]) == 0
    assert (
        "compared with the next 259 s of measurements, under the same set-points: error 0."
        in capsys.readouterr().out
    )


def test_the_shipped_session_is_forecast_within_its_bands(tmp_path: Path) -> None:
    """Its generator is the paper's plant with a camera's noise, so the bands have every chance to hold it."""
    asked_samples = list(range(450, 1650, 100))
    samples = {s.index: s for s in read_session(SHIPPED).samples}
    held_shares = []
    for forecast in asked(
        SHIPPED,
        tmp_path / "out.json",
        "--reference",
        "recorded",
        "--at",
        *asked_samples,
    ):
        came = np.array(
            [
                samples[forecast["sample"] + k + 1].output
                for k in range(len(forecast["t"]))
            ]
        )
        held_shares.append(
            np.mean(
                (np.array(forecast["y"]["low"]) <= came)
                & (came <= np.array(forecast["y"]["high"]))
            )
        )
    # Twelve forecasts of 300 readings, 90 % of them promised; neighbours share readings and a twin.
    assert 0.8 < np.mean(held_shares) < 0.98


def test_sigterm_interrupts_the_start_of_a_run_as_ctrl_c_does(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """So that what has been started ends with it."""
    pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
    ended: list[str] = []

    def starting(_: object) -> int:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            ended.append("what was started")
        return 0

    starting.__module__ = "twinmatch.cli.play"
    monkeypatch.setattr("twinmatch.cli.play.run", starting)
    assert main(["play", str(SHIPPED)]) == 130
    assert ended == ["what was started"]
    assert capsys.readouterr().err == "twinmatch: interrupted\n"
