"""What pip and colcon install."""

from __future__ import annotations

import importlib
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any

import check_machine
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import twinmatch
from tests.support.places import PROJECT
from twinmatch.nodes.__main__ import PROGRAMS, nodes_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SCRIPTS = re.findall(
    r'^(\w+) = "(twinmatch\.\S+):main"',
    (PROJECT / "pyproject.toml").read_text(),
    re.MULTILINE,
)


@pytest.fixture(scope="module")
def colcon() -> str:
    """The program, with what reads package.xml and sorts by it."""
    packages = Path("/usr/lib/python3/dist-packages")
    program = shutil.which("colcon")
    if program is None or not all(
        (packages / f"colcon_{x}").is_dir() for x in ("ros", "package_information")
    ):
        pytest.skip("colcon is not installed: sh .ci/debian_tools.sh workspace")
    return program


def test_colcon_installs_the_nodes(colcon: str, sources: Path, tmp_path: Path) -> None:
    ours = (
        "LD_LIBRARY_PATH",
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
        "VIRTUAL_ENV",
        "PYTHONPATH",
    )
    environment = {k: v for k, v in os.environ.items() if k not in ours}
    environment["PATH"] = os.pathsep.join(
        folder
        for folder in environment["PATH"].split(os.pathsep)
        if not folder.startswith(sys.prefix)
    )
    folders = [f"--build-base={tmp_path}/build", f"--install-base={tmp_path}/install"]
    command = [
        colcon,
        f"--log-base={tmp_path}/log",
        "build",
        "--paths",
        str(sources),
        *folders,
    ]
    completed = subprocess.run(
        command,
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stdout + completed.stderr
    installed = tmp_path / "install" / "twinmatch"
    assert {path.name for path in (installed / "lib" / "twinmatch").iterdir()} == dict(
        SCRIPTS
    ).keys()
    assert (installed / "share" / "twinmatch" / "package.xml").exists()
    assert (
        installed
        / "share"
        / "ament_index"
        / "resource_index"
        / "packages"
        / "twinmatch"
    ).exists()


def test_colcon_finds_both_packages_where_the_page_says(colcon: str) -> None:
    page = (PROJECT / "docs" / "ros.md").read_text(encoding="utf-8")
    (named,) = re.findall(r"^colcon build --base-paths (.*)$", page, re.MULTILINE)
    folders = [
        str(PROJECT / Path(name).relative_to("src/twinmatch")) for name in named.split()
    ]
    environment = {
        k: v
        for k, v in os.environ.items()
        if k not in ("LD_LIBRARY_PATH", "PYTHONPATH")
    }
    command = [
        colcon,
        "--log-base",
        os.devnull,
        "list",
        "--names-only",
        "--base-paths",
        *folders,
    ]
    completed = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    )
    assert completed.stdout.split() == ["twinmatch", "twinmatch_msgs"]


def test_package_xml_names_what_pyproject_needs() -> None:
    """By rosdep's keys, or in the sentence that says what pip has to install."""
    text = (PROJECT / "package.xml").read_text(encoding="utf-8")
    documented = text + (PROJECT / "docs" / "ros.md").read_text(encoding="utf-8")
    block = (
        (PROJECT / "pyproject.toml")
        .read_text()
        .split("\ndependencies = [")[1]
        .split("]")[0]
    )
    names = [name.lower() for name in re.findall(r'"([\w-]+)', block)]
    assert "numpy" in names
    keys = {"pyserial": "python3-serial", "pyyaml": "python3-yaml"}
    documented = re.sub(r'"|[<>=,]+[\d.]+', " ", documented)
    missing = [
        n
        for n in names
        if keys.get(n, f"python3-{n}") not in text and f" {n} " not in documented
    ]
    assert not missing


@pytest.mark.parametrize("version", ["3.10", "3.11", "3.12", "3.13"])
@pytest.mark.parametrize(
    ("release", "other_extra"), [("jazzy", "ros-kilted"), ("kilted", "ros")]
)
def test_constraints_name_a_version_of_everything_that_pyproject_asks_for(
    release: str, other_extra: str, version: str
) -> None:
    """For every Python, and one that pyproject.toml agrees with."""
    environment = {
        **{
            "python_version": version,
            "python_full_version": f"{version}.9",
            "sys_platform": "linux",
        },
        **{
            "platform_machine": "x86_64",
            "implementation_name": "cpython",
            "os_name": "posix",
        },
    }

    def asked(lines: list[str]) -> list[Requirement]:
        requirements = [Requirement(line) for line in lines]
        return [
            requirement
            for requirement in requirements
            if requirement.marker is None or requirement.marker.evaluate(environment)
        ]

    lines = (
        (PROJECT / "constraints" / f"{release}.txt")
        .read_text(encoding="utf-8")
        .splitlines()
    )
    assert all(re.match(r"[a-z0-9-]+==[\w.]+( ;|$)", line) for line in lines), (
        "names and versions only"
    )
    pinned = {
        canonicalize_name(requirement.name): requirement.specifier
        for requirement in asked(lines)
    }
    assert len(pinned) == len(asked(lines)), "one version of each"
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = {
        k: v
        for k, v in project["project"]["optional-dependencies"].items()
        if k != other_extra
    }
    wanted = asked(
        [
            *project["build-system"]["requires"],
            *project["project"]["dependencies"],
            "uv",
        ]
    )
    wanted += [
        requirement
        for lines in extras.values()
        for requirement in asked(lines)
        if requirement.name != "twinmatch"
    ]
    assert len(wanted) > 40
    for requirement in wanted:
        (pin,) = pinned[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(pin.version, prereleases=True), (
            f"{requirement}: make constraints"
        )


def test_every_program_of_nodes_has_a_console_script() -> None:
    """`ros2 run twinmatch <name>` starts what is called so."""
    ours = dict(SCRIPTS)
    assert ours.pop("twinmatch") == "twinmatch.cli"
    assert ours == dict.fromkeys(PROGRAMS, "twinmatch.nodes.__main__")
    for name in PROGRAMS:
        assert [kind.NAME for kind in nodes_of(name)]


def test_a_program_that_there_is_not_is_answered_with_those_there_are() -> None:
    command = [sys.executable, "-m", "twinmatch.nodes", "playr"]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert completed.returncode == 2
    assert re.fullmatch(
        r"usage: python -m twinmatch\.nodes \{.*player,.*\} \[--help\]\n",
        completed.stderr,
    )


@pytest.mark.parametrize("folder", [".", "src/twinmatch_msgs"])
def test_package_xml_has_the_version(folder: str) -> None:
    root = ET.parse(PROJECT / folder / "package.xml").getroot()
    assert root.findtext("version") == twinmatch.__version__
    assert root.get("format") == "3"


# `make setup` says what a machine lacks before it starts.


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module, on a machine that has everything."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(Path, "exists", lambda _: True)
    return check_machine


def test_on_a_complete_machine_nothing_is_reported_missing(machine: ModuleType) -> None:
    assert machine.missing() is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ((sys, "version_info", (3, 9, 0)), r"Python 3\.9 at .*; use 3\.10 to 3\.13"),
        ((sys, "version_info", (3, 14, 0)), r"Python 3\.14 at .*; use 3\.10 to 3\.13"),
        ((platform, "machine", lambda: "aarch64"), "linux on aarch64"),
        ((shutil, "which", lambda _: None), r"apt-get install g\+\+"),
        (
            (Path, "exists", lambda _: False),
            re.escape(str(Path(sysconfig.get_path("include")) / "Python.h")),
        ),
    ],
    ids=["older Python", "newer Python", "processor", "compiler", "headers"],
)
def test_what_a_machine_lacks_is_named(
    machine: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    change: tuple[Any, str, object],
    words: str,
) -> None:
    monkeypatch.setattr(*change)
    assert re.search(words, machine.missing())


# The messages that are installed are those of the sources.

PACKAGE = PROJECT / "src" / "twinmatch_msgs"
SOURCES = sorted((PACKAGE / "msg").glob("*.msg"))
SERVICES = sorted((PACKAGE / "srv").glob("*.srv"))

pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)


@pytest.mark.parametrize("source", SOURCES + SERVICES, ids=lambda path: path.stem)
def test_installed_message_is_up_to_date(source: Path) -> None:
    installed = (
        Path(sys.prefix) / "share" / "twinmatch_msgs" / source.parent.name / source.name
    )
    if not installed.exists():
        pytest.skip("twinmatch_msgs comes from elsewhere than this environment")
    assert installed.read_text() == source.read_text(), "run make setup"


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_every_message_survives_its_serialisation(source: Path) -> None:
    _there_and_back(getattr(importlib.import_module("twinmatch_msgs.msg"), source.stem))


@pytest.mark.parametrize("source", SERVICES, ids=lambda path: path.stem)
def test_every_service_survives_its_serialisation(source: Path) -> None:
    kind = getattr(importlib.import_module("twinmatch_msgs.srv"), source.stem)
    _there_and_back(kind.Request)
    _there_and_back(kind.Response)


def _there_and_back(kind: Any) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    message = kind()
    for field, name in kind.get_fields_and_field_types().items():
        if name == "double":
            setattr(message, field, 0.1 + 0.2)
        elif name == "sequence<double>":
            setattr(message, field, [0.1 + 0.2, float("inf")])
    assert deserialize_message(serialize_message(message), kind) == message


def test_fast_dds_finds_the_introspection() -> None:
    """Without it rcl prints a page about an overwritten error in every program that uses two messages."""
    program = """
from twinmatch.nodes import network
network.prepare()
import rclpy
from twinmatch_msgs.msg import LoopSample, Match
rclpy.init()
for name in ("one", "two"):
    node = rclpy.create_node(name)
    node.create_publisher(LoopSample, "sample", 10)
    node.create_subscription(Match, "match", print, 10)
    node.destroy_node()
rclpy.shutdown()
"""
    completed = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (completed.returncode, completed.stdout, completed.stderr) == (0, "", "")


def test_messages_have_double_precision_alone() -> None:
    """A float32 would round, and live and replayed verdicts would differ."""
    for source in SOURCES + SERVICES:
        assert not re.search(r"^float32", source.read_text(), re.MULTILINE), source.name
