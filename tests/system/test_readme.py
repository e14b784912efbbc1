"""Every command of the README is known here, and runs as it stands there.

Placeholders are filled in, ports are any that are free, and a program that runs until Ctrl-C is interrupted
once it has printed what it should. A command that needs hardware is parsed; make prints what it would do.
"""

from __future__ import annotations

import json
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.support.bags import bag as write_bag
from tests.support.bags import number, temperature
from tests.support.oven import RIG, oven_file
from tests.support.places import PROJECT, SHIPPED
from tests.support.processes import VERDICT_LINE, Processes, run_twinmatch
from twinmatch.cli import command_parser
from twinmatch.sessions import read_session, write_session

README = (PROJECT / "README.md").read_text("utf-8")
LINES = [
    line.split(" #")[0].strip()
    for block in re.findall(
        r"^```(?:sh)?\n(.*?)^```$", README, re.MULTILINE | re.DOTALL
    )
    for line in block.splitlines()
    if line.strip()
]
INLINE = re.findall(
    r"`((?:make|twinmatch|python) [^`]+)`",
    re.sub(r"```.*?```", "", README, flags=re.DOTALL),
)
TW = ".venv/bin/twinmatch"
ATTACH = f"{TW} attach --plant my_plant.py --map reference=/sp output=/camera:temperature input=/cmd --dashboard"
IMPORT = (
    f"{TW} import BAG --plant my_plant.py "
    "--map reference=/sp:data output=/camera:temperature input=/cmd:data -o SESSION"
)


class Runs(NamedTuple):
    """A command that is run, in this process if it is of twinmatch, starts no node and ends by itself."""

    says: str
    """Pattern of a line it has to print."""
    given: Mapping[str, str] = {}
    """What is replaced in it."""
    until: int | None = None
    """Exit code after the Ctrl-C that is sent after that line; None: it ends without one, with code 0."""
    needs: tuple[str, ...] = ()
    """Fixtures that prepare what it works on."""
    nodes: bool = False
    """Whether the command itself starts nodes."""


SHORT = {"SESSION": "short", "SAMPLE": "405"}
LONGER = {"SESSION": "longer"}
SHIPPED_SHORT = {"bags/four_setpoints": "short"}
FREE = {"--dashboard": "--dashboard 0"}

RUNS = {
    "source .venv/bin/activate": Runs(
        "twinmatch", {"activate": "activate && command -v twinmatch"}
    ),
    "twinmatch replay bags/four_setpoints": Runs(
        "Leader: .*trust it .* s ahead between", {"bags/four_setpoints": "longer"}
    ),
    "twinmatch report bags/four_setpoints -o report.html": Runs(
        "report.html", SHIPPED_SHORT
    ),
    "twinmatch forecast bags/four_setpoints --at 1200 --hold 80": Runs(
        r"leader.*confidence"
    ),
    "python launch_scripts/replay.py bags/four_setpoints --dashboard": Runs(
        VERDICT_LINE, FREE, 130
    ),
    "python launch_scripts/live.py --virtual --speed 5 --dashboard --control": Runs(
        "recording into", FREE, 0
    ),
    "twinmatch foxglove": Runs("ws://127.0.0.1", {"foxglove": "foxglove --port 0"}, 0),
    ATTACH: Runs(
        VERDICT_LINE,
        {"--dashboard": "--dashboard 0 --session attached"},
        0,
        ("foreign_rig",),
    ),
    f"{TW} import BAG --list": Runs("/camera", {"BAG": "bag"}, needs=("bag",)),
    IMPORT: Runs("samples", {"BAG": "bag", "SESSION": "imported"}, needs=("bag",)),
    f"{TW} replay SESSION": Runs("Leader: ", SHORT),
    f"{TW} replay SESSION --json out.json --figure verdict.png": Runs(
        "Leader: ", SHORT
    ),
    f"{TW} replay FOLDER --out RESULTS": Runs(
        "1 session judged", {"FOLDER": "judged", "RESULTS": "results"}
    ),
    f"{TW} forecast SESSION --at SAMPLE": Runs(r"leader.*confidence", SHORT),
    f"{TW} try-controller SESSION --loop law.json": Runs(
        "law.json: safe for all that the data allow", LONGER, needs=("law",)
    ),
    f"{TW} experiment SESSION": Runs("bits for structure are expected", LONGER),
    f"{TW} backtest SESSION": Runs("persistence", LONGER),
    f"{TW} verify SESSION": Runs(
        "are identical, bit for bit",
        {"SESSION": "attached --plant my_plant.py"},
        needs=("attached",),
    ),
    f"{TW} play SESSION --rate 50": Runs("Leader: ", SHORT, nodes=True),
    f"{TW} new-plant tank --from log.csv": Runs(
        "twinmatch check-plant", needs=("log",)
    ),
    f"{TW} check-plant tank.py": Runs("no problems found", needs=("tank",)),
    f"{TW} replay SESSION --plant tank.py": Runs(
        "Leader: ", {"SESSION": "tank_session"}, needs=("tank_session",)
    ),
    f"{TW} live --virtual --speed max": Runs("recording into", {}, 0),
    f"{TW} virtual-rig --speed 20 --fault drive-lost@300": Runs("^ready", {}, 0),
}
MAKES = {
    "make demo": "launch_scripts/demo.py",
    "make test": '-m "not long"',
    "make test-long": "-m long",
    "make demo SESSION=path": "launch_scripts/demo.py path",
    "make docs": "-m sphinx",
}
PARSED = (
    f"{TW} live --config config/rig.yaml",  # camera and board
    "twinmatch live --plant tclab",  # a kit
)


def test_every_command_of_the_readme_is_known_here_and_no_other() -> None:
    assert len(LINES) > 20
    assert set(LINES) | set(INLINE) == set(RUNS) | set(MAKES) | set(PARSED)


@pytest.mark.parametrize("command", MAKES)
def test_each_make_command_would_run_what_it_promises(command: str) -> None:
    completed = subprocess.run(
        [*command.split(), "--dry-run", "--always-make"],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert MAKES[command] in completed.stdout


@pytest.mark.parametrize("command", PARSED)
def test_what_needs_hardware_is_understood(command: str) -> None:
    options = command_parser().parse_args(shlex.split(command)[1:])
    if options.config is not None:
        assert (PROJECT / options.config).is_file()


def test_a_misspelt_option_would_be_found() -> None:
    with pytest.raises(SystemExit):
        command_parser().parse_args(["live", "--confg", "config/rig.yaml"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Looks like the project to the commands, and is written into; its session is shorter.

    The first candidate comes at sample 400, the second at 600.
    """
    directory = tmp_path_factory.mktemp("readme")
    samples = read_session(SHIPPED).samples
    write_session(directory / "bags" / SHIPPED.name, samples[:1300])
    write_session(directory / "longer", samples[:700])
    write_session(directory / "short", samples[:410])
    write_session(directory / "judged" / "one", samples[:410])
    for name in ("launch_scripts", "config"):
        (directory / name).symlink_to(PROJECT / name)
    (directory / ".venv").symlink_to(sys.prefix)
    return directory


def run(command: str, how: Runs, folder: Path, processes: Processes) -> str:
    for placeholder, value in how.given.items():
        command = command.replace(placeholder, value)
    program, *arguments = shlex.split(command)
    if Path(program).name == "twinmatch" and how.until is None and not how.nodes:
        completed = run_twinmatch(*arguments, folder=folder)
        assert completed.returncode == 0, completed.stdout + completed.stderr
        assert re.search(how.says, completed.stdout, re.MULTILINE), completed.stdout
        return completed.stdout
    if program == "source":
        process = processes.start("bash", "-c", command, folder=folder)
    else:
        # forked: that the installed programs start is shown by the first, and by tests of the wheel
        ours = ["-m", "twinmatch.cli"] if Path(program).name == "twinmatch" else []
        process = processes.start(
            sys.executable, *ours, *arguments, folder=folder, forked=True
        )
    if how.until is not None:
        process.said(how.says)
        assert process.end(signal.SIGINT) == how.until, process.text
        return process.text
    assert process.wait() == 0, process.text
    assert re.search(how.says, process.text, re.MULTILINE), process.text
    return process.text


@pytest.fixture
def plant(folder: Path) -> None:
    """The plant file of somebody's rig."""
    oven_file(folder).rename(folder / "my_plant.py")


@pytest.fixture
def foreign_rig(plant: None, processes: Processes) -> None:  # noqa: ARG001
    """That rig with the topics of the README."""
    processes.python(
        RIG, "--period", "0.1", "--stamped", "--topics", "/sp", "/camera", "/cmd"
    )


@pytest.fixture
def attached(
    folder: Path, processes: Processes, request: pytest.FixtureRequest
) -> None:
    """The session that the README's own command has recorded."""
    if not (folder / "attached").is_dir():
        request.getfixturevalue("foreign_rig")
        run(ATTACH, RUNS[ATTACH], folder, processes)


@pytest.fixture
def bag(folder: Path, plant: None) -> None:  # noqa: ARG001
    """A recording of the same topics, on a clock of its own: readings that a busy machine delays by three
    periods are refused at import, rightly."""
    if (folder / "bag").is_dir():
        return
    messages: list[tuple[float, str, Any]] = []
    for tick in range(100):
        time = tick / 10
        share_left = 0.9**tick
        messages.append((time, "/sp", number(30.0)))
        messages.append((time, "/camera", temperature(time, 30.0 - 10.0 * share_left)))
        messages.append((time, "/cmd", number(20.0 + 40.0 * share_left)))
    write_bag(folder / "bag", StoragePlugin.MCAP, messages)


@pytest.fixture
def log(folder: Path) -> None:
    """The table of docs/your_plant.md."""
    if (folder / "log.csv").exists():
        return
    text = (PROJECT / "docs" / "your_plant.md").read_text("utf-8")
    code = dict(
        re.findall(r"^```python (\w+\.py)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    )["make_log.py"]
    subprocess.run([sys.executable, "-c", code], cwd=folder, check=True)


@pytest.fixture
def law(folder: Path) -> None:
    """The example of docs/controllers.md with three quarters of its gains: the session of these tests is shorter
    than that page's, and leaves more open."""
    text = (PROJECT / "docs" / "controllers.md").read_text("utf-8")
    example = re.search(
        r"^```json doubled\.json\n(.*?)^```", text, re.DOTALL | re.MULTILINE
    )
    assert example
    gains = json.loads(example[1])
    for name in ("proportional", "integral", "derivative"):
        gains[name] *= 0.75
    (folder / "law.json").write_text(json.dumps(gains), encoding="utf-8")


@pytest.fixture
def tank(folder: Path, log: None, processes: Processes) -> None:  # noqa: ARG001
    """Its plant file."""
    if not (folder / "tank.py").exists():
        run(
            "twinmatch new-plant tank --from log.csv",
            Runs("tank.py"),
            folder,
            processes,
        )


@pytest.fixture
def tank_session(folder: Path, tank: None, processes: Processes) -> None:  # noqa: ARG001
    """The table as a session."""
    command = "twinmatch import log.csv --map-file tank_map.yaml --plant tank.py -o tank_session"
    run(command, Runs("samples"), folder, processes)


@pytest.mark.parametrize("command", RUNS)
def test_it_runs_as_it_stands_there(
    command: str, folder: Path, processes: Processes, request: pytest.FixtureRequest
) -> None:
    if (
        command.startswith("source")
        and not (folder / ".venv" / "bin" / "activate").is_file()
    ):
        pytest.skip("these tests do not run in a virtual environment")
    for name in RUNS[command].needs:
        request.getfixturevalue(name)
    run(command, RUNS[command], folder, processes)


@pytest.mark.long("two whole demonstrations, one after the other")
def test_the_demo_ends_with_a_report_and_a_second_one_starts_from_it(
    folder: Path, processes: Processes
) -> None:
    """Not through all its set-points, but until whichever structure leads is determined and has beaten both
    baselines; what the first has learned is trusted a minute after the second begins."""
    shipped = (PROJECT / "config" / "demo.yaml").read_text("utf-8")
    reports = []
    for holds in ("60.0, 200.0, 200.0, 200.0", "60.0, 200.0, 10.0, 10.0"):
        config = shipped
        for name, values in (("levels", "30.0, 50.0, 40.0, 60.0"), ("holds", holds)):
            config, replaced = re.subn(
                rf"(profile\.{name}: ).*", rf"\g<1>[{values}]", config
            )
            assert replaced == 1
        (folder / "demo.yaml").write_text(config, "utf-8")
        command = (
            "python launch_scripts/demo.py --config demo.yaml --memory demo.sqlite"
        )
        reports.append(run(command, Runs("^report: "), folder, processes))
    first, second = reports
    for text in (first, second):
        assert re.search(r"and [1-9]\d* match.* the same, bit for bit", text), text
        assert re.search(
            r"^remembered demo_.*: [1-9] structures$", text, re.MULTILINE
        ), text
    assert "nothing is remembered yet" in first
    assert "1 session is remembered" in second
    levels = {
        text: re.findall(r"^\d+ +(trusted|unknown|doubtful)", text, re.MULTILINE)
        for text in (first, second)
    }
    assert levels[first][0] == "unknown", first
    assert levels[second][0] == "trusted", second
