"""Nothing is tried again but single tests that say why, and nothing at all that holds the plate safe."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from tests.support.places import PROJECT, TESTS

NEVER = re.compile(r"safety|guard|gate|driver|bridge|arduino|pwm|firmware")
"""What stands between a fault and the plate, in the path or the name of a test: there a race is the bug."""


def is_flaky(node: ast.AST) -> bool:
    return isinstance(node, ast.Attribute) and node.attr == "flaky"


def warnings(source: str, where: str) -> Iterator[str]:
    """What is wrong with the retries in a file of tests."""
    tree = ast.parse(source)
    allowed = set()
    for test in ast.walk(tree):
        if not isinstance(test, ast.FunctionDef):
            continue
        for mark in test.decorator_list:
            if not isinstance(mark, ast.Call) or not is_flaky(mark.func):
                continue
            allowed.add(mark.func)
            reasons = [ast.literal_eval(word.value) for word in mark.keywords if word.arg == "reason"]
            if not reasons or len(reasons[0].split()) < 5:
                yield f"{where}: {test.name} is tried again without a reason"
            if NEVER.search(f"{where} {test.name}"):
                yield f"{where}: {test.name} is tried again; in what holds the plate safe a race is the bug"
    if any(is_flaky(node) and node not in allowed for node in ast.walk(tree)):
        yield f"{where}: a retry that is not on one test"


def test_retries_are_on_single_tests_with_their_reasons() -> None:
    files = sorted(TESTS.rglob("*.py"))
    assert len(files) > 100
    found = [words for file in files for words in warnings(file.read_text(), str(file.relative_to(TESTS)))]
    assert found == []


def test_no_run_tries_everything_again() -> None:
    for file in (PROJECT / "pyproject.toml", PROJECT / "Makefile"):
        assert not re.search(r"--reruns|^\s*reruns\s*=", file.read_text(), re.MULTILINE), file.name


@pytest.mark.parametrize(
    ("source", "where", "words"),
    [
        ("pytestmark = pytest.mark.flaky(reruns=2)", "nodes/test_a.py", "not on one test"),
        ("item.add_marker(pytest.mark.flaky(reruns=2))", "conftest.py", "not on one test"),
        ("@pytest.mark.flaky\ndef test_a(): ...", "views/test_a.py", "not on one test"),
        ("@pytest.mark.flaky(reruns=2)\ndef test_a(): ...", "views/test_a.py", "without a reason"),
        (
            "@pytest.mark.flaky(reruns=1, reason='discovery of another DDS is slow')\ndef test_a(): ...",
            "nodes/test_pwm_driver.py",
            "a race is the bug",
        ),
    ],
)
def test_what_is_refused(source: str, where: str, words: str) -> None:
    (found,) = warnings(source, where)
    assert words in found


def test_what_is_allowed() -> None:
    source = "@pytest.mark.flaky(reruns=1, reason='discovery of another DDS is slow')\ndef test_a(): ..."
    assert list(warnings(source, "system/test_a.py")) == []
