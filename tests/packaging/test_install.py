"""What pip and colcon install."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import twinmatch

PROJECT = Path(__file__).resolve().parents[2]
SCRIPTS = re.findall(
    r'^(\w+) = "(twinmatch\.\S+):main"', (PROJECT / "pyproject.toml").read_text(), re.MULTILINE
)
MAIN = re.compile(r"^(def main\(|main = program\()", re.MULTILINE)
"""How a module of a program defines its main function."""


def test_colcon_installs_the_nodes(sources: Path, tmp_path: Path) -> None:
    colcon = shutil.which("colcon")
    if colcon is None:
        pytest.skip("colcon is not installed: apt-get install colcon python3-colcon-ros")
    ours = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "VIRTUAL_ENV", "PYTHONPATH")
    environment = {k: v for k, v in os.environ.items() if k not in ours}
    environment["PATH"] = os.pathsep.join(
        folder for folder in environment["PATH"].split(os.pathsep) if not folder.startswith(sys.prefix)
    )
    folders = [f"--build-base={tmp_path}/build", f"--install-base={tmp_path}/install"]
    command = [colcon, f"--log-base={tmp_path}/log", "build", "--paths", str(sources), *folders]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    installed = tmp_path / "install" / "twinmatch"
    assert {path.name for path in (installed / "lib" / "twinmatch").iterdir()} == dict(SCRIPTS).keys()
    assert (installed / "share" / "twinmatch" / "package.xml").exists()
    assert (installed / "share" / "ament_index" / "resource_index" / "packages" / "twinmatch").exists()


def test_colcon_finds_both_packages_where_the_page_says() -> None:
    colcon = shutil.which("colcon")
    if colcon is None:
        pytest.skip("colcon is not installed: apt-get install colcon python3-colcon-ros")
    page = (PROJECT / "docs" / "ros.md").read_text(encoding="utf-8")
    (named,) = re.findall(r"^colcon build --base-paths (.*)$", page, re.MULTILINE)
    folders = [str(PROJECT / Path(name).relative_to("src/twinmatch")) for name in named.split()]
    environment = {k: v for k, v in os.environ.items() if k not in ("LD_LIBRARY_PATH", "PYTHONPATH")}
    command = [colcon, "--log-base", os.devnull, "list", "--names-only", "--base-paths", *folders]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["twinmatch", "twinmatch_msgs"]


def test_package_xml_names_what_pyproject_needs() -> None:
    """By rosdep's keys, or in the sentence that says what pip has to install."""
    text = (PROJECT / "package.xml").read_text(encoding="utf-8")
    told = text + (PROJECT / "docs" / "ros.md").read_text(encoding="utf-8")
    block = (PROJECT / "pyproject.toml").read_text().split("\ndependencies = [")[1].split("]")[0]
    names = [name.lower() for name in re.findall(r'"([\w-]+)', block)]
    assert "numpy" in names
    keys = {"pyserial": "python3-serial", "pyyaml": "python3-yaml"}
    missing = [n for n in names if keys.get(n, f"python3-{n}") not in text and f" {n} " not in told]
    assert not missing


@pytest.mark.parametrize(("name", "module"), SCRIPTS)
def test_console_script_has_its_module(name: str, module: str) -> None:
    """`ros2 run twinmatch <name>` starts what is called so."""
    source = PROJECT / "src" / (module.replace(".", "/") + ".py")
    assert source.stem == ("cli" if name == "twinmatch" else name)
    if not source.exists():
        source = source.with_suffix("") / "__init__.py"
    assert MAIN.search(source.read_text())


def test_every_node_has_a_console_script() -> None:
    nodes = PROJECT / "src" / "twinmatch" / "nodes"
    modules = {path.stem for path in nodes.glob("*.py") if MAIN.search(path.read_text())}
    assert modules == dict(SCRIPTS).keys() - {"twinmatch"}


@pytest.mark.parametrize("folder", [".", "src/twinmatch_msgs"])
def test_package_xml_has_the_version(folder: str) -> None:
    root = ET.parse(PROJECT / folder / "package.xml").getroot()
    assert root.findtext("version") == twinmatch.__version__
    assert root.get("format") == "3"
