"""The rules of the house: style, types and which room may import which."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.support.places import PROJECT

TOOLS = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(["ruff", "check", "."], id="ruff"),
        pytest.param(["ruff", "format", "--check", "."], id="format"),
        pytest.param(["mypy"], id="types"),
        pytest.param(["lint-imports"], id="layers"),
    ],
)
def test_house_rules_hold(command: list[str]) -> None:
    tool = TOOLS / command[0]
    if not tool.exists():
        pytest.skip(f"{command[0]} is not installed; it is in the extra 'test'")
    done = subprocess.run([tool, *command[1:]], cwd=PROJECT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_class_name_means_one_thing() -> None:
    modules = [
        ast.parse(path.read_text(encoding="utf-8")) for path in (PROJECT / "src/twinmatch").rglob("*.py")
    ]
    names = Counter(one.name for module in modules for one in module.body if isinstance(one, ast.ClassDef))
    assert [name for name, count in names.items() if count > 1] == []
