"""From wheels alone: the commands run in an environment and a folder that know nothing of the checkout.

The code is that of the wheel; only the libraries that it needs come from the environment of the tests, whose
own twinmatch cannot be seen: it is installed as a link, and links in a folder that is merely on the path are
not followed.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import os
import signal
import subprocess
import sys
import sysconfig
import time
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import ready_wheel

from tests.support.places import PROJECT, SHIPPED
from tests.support.processes import Processes
from twinmatch.plants import PLANTS

pytestmark = [
    pytest.mark.ros,
    pytest.mark.long("builds wheels and installs them in another environment"),
]


FIRST_REPLAY = """
import sys
from twinmatch.cli import main
from twinmatch.compiled import told

if __name__ == "__main__":
    compiled = []
    told.append(compiled.append)
    assert main(["replay", sys.argv[1]]) == 0
    assert "sympy" not in sys.modules
    print("compiled:", compiled)
"""
OPTIONS = ("--quiet", "--no-deps", "--no-index")


@pytest.fixture(scope="module")
def wheel(sources: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [*OPTIONS, "--no-build-isolation", "--wheel-dir", str(folder), str(sources)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *build], check=True)
    (built,) = folder.glob("twinmatch-*.whl")
    return built


@pytest.fixture(scope="module")
def ready_wheel_path(wheel: Path) -> Path:
    """That wheel with machine code; what the checkout has compiled is not compiled again."""
    assert ready_wheel.main(str(wheel), PROJECT / "src" / "twinmatch") == 0
    return wheel


@pytest.fixture(scope="module")
def installed(ready_wheel_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of programs of an environment with the wheel in it."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "env", symlinks=True)
    python = folder / "env" / "bin" / "python"
    install = [
        "-m",
        "pip",
        "--python",
        str(python),
        "install",
        *OPTIONS,
        str(ready_wheel_path),
    ]
    subprocess.run([sys.executable, *install], check=True)
    (packages,) = (folder / "env" / "lib").glob("python3*/site-packages")
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "env" / "bin"


@pytest.fixture
def programs(installed: Path, tmp_path: Path) -> Iterator[Processes]:
    """Starts programs of that environment in an empty folder."""
    inherited = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "VIRTUAL_ENV")
    }
    path = os.pathsep.join([str(installed), "/usr/bin", "/bin"])
    # Where the messages of the libraries lie, which are in the environment of the tests.
    started = Processes(
        tmp_path / "output",
        {**inherited, "PATH": path, "AMENT_PREFIX_PATH": sys.prefix},
    )
    yield started
    started.dismiss()


def lists_its_machine_code(archive: zipfile.ZipFile) -> None:
    """Whether the wheel's record is that of its files, and machine code is among them."""
    names = archive.namelist()
    (record,) = (name for name in names if name.endswith(".dist-info/RECORD"))
    rows = list(csv.reader(archive.read(record).decode().splitlines()))
    for name, digest, size in rows:
        if name != record:
            content = archive.read(name)
            hashed = base64.urlsafe_b64encode(hashlib.sha256(content).digest())
            assert digest == f"sha256={hashed.rstrip(b'=').decode()}"
            assert int(size) == len(content)
    assert sorted(name for name, _, _ in rows) == sorted(names)
    assert sum(name.endswith(".nbc") for name in names) > 30
    structures = [s for plant in PLANTS.values() for s in plant.structures.values()]
    codes = [name for name in names if name.startswith("twinmatch/machine_code/")]
    codes.remove("twinmatch/machine_code/made_with.json")
    assert 20 < len(codes) <= len(structures)


def test_the_wheel_carries_share_profile_and_the_machine_code_that_it_lists(
    ready_wheel_path: Path,
) -> None:
    with zipfile.ZipFile(ready_wheel_path) as archive:
        names = {name.split(".data/data/")[-1] for name in archive.namelist()}
        lists_its_machine_code(archive)
    shared = [
        *(PROJECT / "config").iterdir(),
        *(PROJECT / "camera_server" / "src").rglob("*.py"),
    ]
    assert names >= {f"share/twinmatch/{path.relative_to(PROJECT)}" for path in shared}
    assert names >= {
        "share/twinmatch/package.xml",
        "share/ament_index/resource_index/packages/twinmatch",
        "twinmatch/nodes/fastdds2_loopback.xml",
        "twinmatch/nodes/fastdds3_loopback.xml",
        "twinmatch/sessions/definitions/LoopSample.msg",
    }


def test_a_first_replay_from_the_wheel_compiles_nothing(
    installed: Path, programs: Processes, tmp_path: Path
) -> None:
    script = tmp_path / "first.py"
    script.write_text(FIRST_REPLAY)
    cache = tmp_path / "cache"
    empty = [f"XDG_CACHE_HOME={cache}", f"TWINMATCH_CACHE={cache}"]
    words = ["env", *empty, installed / "python", script, SHIPPED]
    process = programs.start(*words, folder=tmp_path)
    assert process.wait() == 0, process.text
    assert process.lines[-1] == "compiled: []"
    assert not list(cache.rglob("*.code"))


def test_code_and_files_are_those_of_the_wheel_and_it_begins_a_file_of_a_plant(
    installed: Path, programs: Processes, tmp_path: Path
) -> None:
    code = (
        "import twinmatch, twinmatch_msgs; from twinmatch.shipped import shipped; "
        "print(twinmatch.__file__, shipped('camera_server/src'), shipped('config/rig.yaml'), sep='\\n')"
    )
    process = programs.start(installed / "python", "-c", code, folder=tmp_path)
    assert process.wait() == 0, process.text
    assert len(process.lines) == 3
    assert all(Path(line).is_relative_to(installed.parent) for line in process.lines)
    process = programs.start(
        installed / "twinmatch", "new-plant", "tank", folder=tmp_path
    )
    assert process.wait() == 0, process.text
    assert (tmp_path / "tank.py").exists()


def test_the_virtual_rig_runs_live_until_ctrl_c(
    installed: Path, programs: Processes, tmp_path: Path
) -> None:
    """Camera program, stand-in of the board, bridges, controller, twin and recorder."""
    words = [
        "live",
        "--virtual",
        "--speed",
        "2",
        "--board",
        "python",
        "--session",
        "first",
    ]
    process = programs.start(installed / "twinmatch", *words, folder=tmp_path)
    process.said("recording into")
    process.said(r"level +decided")
    time.sleep(5)  # of samples
    process.send(signal.SIGINT)
    assert process.wait() == 0, process.text
    assert "Traceback" not in process.text
    assert (tmp_path / "first" / "metadata.yaml").exists()
