"""The rules of the house: style, types and which room may import which."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.places import PROJECT

TOOLS = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(["ruff", "check", "."], id="ruff"),
        pytest.param(["ruff", "format", "--check", "."], id="format"),
        pytest.param(
            ["mypy"], id="types", marks=pytest.mark.long("the types of everything")
        ),
        pytest.param(["mypy", "src/twinmatch_msgs/setup.py"], id="types of the build"),
        pytest.param(["lint-imports"], id="layers"),
    ],
)
def test_house_rules_hold(command: list[str]) -> None:
    tool = TOOLS / command[0]
    if not tool.exists():
        pytest.skip(f"{command[0]} is not installed; it is in the extra 'test'")
    completed = subprocess.run(
        [tool, *command[1:]], cwd=PROJECT, capture_output=True, text=True, check=False
    )
    assert completed.returncode == 0, completed.stdout + completed.stderr


def test_a_class_name_means_one_thing() -> None:
    names = Counter[str]()
    for path in (PROJECT / "src/twinmatch").rglob("*.py"):
        names.update(
            re.findall(r"^class (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
        )
    assert len(names) > 500
    assert [name for name, count in names.items() if count > 1] == []


PRIVATE = re.compile(r"_(?!_)\w+")
NOT_PRIVATE = {"_replace", "_fields", "_asdict", "_exit"}
"""Named like that by the language's library, which documents them."""
NO_OTHER_WAY = {"_H1"}
"""The heater of the model in the package `tclab`, which can be set nowhere else."""
WATCHES_NUMBA = "test_numba_insides.py"
"""Tests that what `numba_insides` relies on within numba is still there."""


def private_names(path: Path) -> Iterator[str]:
    """What a test uses that belongs to somebody else and is private there."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute):
            owner = node.value
            is_own = isinstance(owner, ast.Name) and owner.id in {"self", "cls"}
            is_inherited = isinstance(owner, ast.Call) and isinstance(
                owner.func, ast.Name
            )
            if is_own or (is_inherited and owner.func.id == "super"):
                continue
            if (
                PRIVATE.fullmatch(node.attr)
                and node.attr not in NOT_PRIVATE | NO_OTHER_WAY
            ):
                yield f"{path.name}:{node.lineno}: {node.attr}"
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if PRIVATE.fullmatch(alias.name):
                    yield f"{path.name}:{node.lineno}: {alias.name}"


def test_tests_use_nothing_private() -> None:
    paths = [
        path for path in (PROJECT / "tests").rglob("*.py") if path.name != WATCHES_NUMBA
    ]
    assert len(paths) > 200
    assert [name for path in paths for name in private_names(path)] == []


SLOW = (
    "scipy.signal",
    "scipy.stats",
    "sympy",
    "matplotlib",
    "control",
    "pint",
    "bokeh",
    "pandas",
)
"""Modules that take up to two seconds to import: only what needs one imports it, when it does."""
LATER = (
    "scipy.linalg",
    "twinmatch.fmu",
    "sympy",
    "concurrent.futures.process",
    "mcap.reader",
    "mcap.writer",
    "twinmatch.importing.tables",
    "twinmatch.sampling",
)
"""What the start of a command that judges, or of the node that does, must not import: few runs need it."""
OF_FILES = ("msgspec", "statistics", "difflib")
"""What reads candidates of a file, repairs a damaged session, and guesses what a mistyped name should be."""
OF_A_MEMORY = ("twinmatch.memory", "twinmatch.controllers", "sqlite3")
"""What holds earlier sessions, and what was learned from them of laws."""
DRAWING = ("twinmatch.showing.page", "twinmatch.showing.figures.elements")
"""What draws: the program of the live page with Bokeh, and what the first figure imports."""

IMPORT_ALL = f"""
import importlib, pkgutil, sys, twinmatch
import twinmatch.cli.backtest, twinmatch.cli.replay, twinmatch.twin.engine
print("twinmatch.dynamics.bank" in sys.modules)
loaded = set()
for found in pkgutil.walk_packages(twinmatch.__path__, "twinmatch.", onerror=print):
    if found.name.startswith({DRAWING}) or found.name.endswith("__main__"):
        continue
    try:
        importlib.import_module(found.name)
    except ModuleNotFoundError as error:
        if error.name.startswith("twinmatch"):
            raise
    new = {{name for name in {SLOW} if name in sys.modules}} - loaded
    loaded |= new
    if new:
        print(found.name, "imports", *sorted(new))
importlib.import_module("twinmatch.cli.replay")
print(len([name for name in sys.modules if name.startswith("twinmatch.")]) > 200)
"""


def test_no_command_and_no_node_waits_for_modules_that_others_need() -> None:
    """Every module but those that draw is imported, so also what a command or a node imports later; the
    arithmetic of plants with several loops is not imported for those with one."""
    completed = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert completed.stdout.split("\n") == ["False", "True", ""]


@pytest.mark.parametrize(
    "module", ["twinmatch.cli.replay", "twinmatch.twin.engine", "twinmatch.nodes.twin"]
)
def test_a_start_imports_nothing_that_few_runs_need(module: str) -> None:
    if module.startswith("twinmatch.nodes"):
        pytest.importorskip("rclpy")
    assert imported_with(module, LATER) == "[]\n"


def test_a_replay_imports_no_reader_of_files_that_it_is_not_given() -> None:
    assert imported_with("twinmatch.cli.replay", OF_FILES) == "[]\n"


def test_a_report_without_a_memory_imports_none() -> None:
    assert imported_with("twinmatch.cli.report", OF_A_MEMORY) == "[]\n"


def test_a_graph_without_a_terminal_imports_nothing_that_draws_on_one() -> None:
    pytest.importorskip("rclpy")
    assert imported_with("twinmatch.launching.live", ("rich", "rich.console")) == "[]\n"


def imported_with(module: str, names: tuple[str, ...]) -> str:
    """Which of these modules are imported with another one, as printed."""
    program = f"import sys, {module}; print(sorted(set({names}) & set(sys.modules)))"
    completed = subprocess.run(
        [sys.executable, "-c", program],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=True,
    )
    return completed.stdout
