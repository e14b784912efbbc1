"""The page on what the program says is complete, and quotes what the program says."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support.places import PROJECT
from tests.words.test_style import prose_of_python
from twinmatch.comparing.verdict import ADMITTED, REFUSED, TrustLevel
from twinmatch.fitting.gate import Status
from twinmatch.health.faults import Fault, HealthState
from twinmatch.safety import FaultKind

PAGE = (PROJECT / "docs" / "troubleshooting.md").read_text("utf-8")
SOURCES = [
    path
    for folder in ("src/twinmatch", "camera_server/src", "launch_scripts")
    for path in (PROJECT / folder).rglob("*.py")
]
SIGALRM = 128 + 14


def section(title: str) -> str:
    matched = re.search(
        rf"^## {re.escape(title)}\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL
    )
    assert matched, f"the page has no section {title!r}"
    return matched[1]


def rows(text: str) -> list[list[str]]:
    cells = [cells_of(line) for line in text.splitlines() if line.startswith("|")]
    return [
        line
        for line in cells
        if not re.fullmatch(r"it says|code|-+", line[0].split("|")[0])
    ]


def cells_of(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split(" | ")]


def first_words(title: str) -> list[str]:
    return [
        word
        for row in rows(section(title))
        for word in re.findall(r"`([^`]+)`", row[0])
    ]


@pytest.mark.parametrize(
    ("title", "kind"),
    [
        ("Trust: the level of a verdict", TrustLevel),
        ("Matches: admitted or refused", Status),
        ("Health of the plant", Fault),
        ("Latched faults of the bridges", FaultKind),
    ],
)
def test_every_word_that_is_recorded_has_a_row_and_there_is_no_other(
    title: str, kind: type[Enum]
) -> None:
    single = {word for word in first_words(title) if " " not in word}
    assert single == {member.value for member in kind}


def test_every_level_of_diagnostics_has_a_row() -> None:
    diagnostics = pytest.importorskip(
        "twinmatch.nodes.health", reason="ROS 2 is not installed"
    )
    single = {
        word
        for word in first_words("Health of the nodes")
        if word.isupper() and " " not in word
    }
    assert single == {level.name for level in diagnostics.Level}


def test_states_and_fates_are_explained() -> None:
    assert all(
        f"`{state.value}`" in section("Health of the plant") for state in HealthState
    )
    assert all(
        f"`{fate}`" in section("Matches: admitted or refused")
        for fate in (ADMITTED, REFUSED)
    )


def exit_codes(tree: ast.AST) -> Iterator[int]:
    """Numbers that a module names EXIT_…, passes as exit code, or returns from a `run` or `main`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            named = any(
                isinstance(t, ast.Name) and t.id.startswith("EXIT_")
                for t in node.targets
            )
            if named and isinstance(node.value.value, int):
                yield node.value.value
        elif isinstance(node, ast.FunctionDef) and node.name in {
            "run",
            "main",
            "exit_code",
            "_run",
        }:
            for inner in ast.walk(node):
                if isinstance(inner, ast.Return) and inner.value is not None:
                    yield from (
                        leaf.value
                        for leaf in ast.walk(inner.value)
                        if isinstance(leaf, ast.Constant) and type(leaf.value) is int
                    )
        elif isinstance(node, ast.ClassDef):
            yield from (
                statement.value.value
                for statement in node.body
                if isinstance(statement, ast.Assign | ast.AnnAssign)
                and isinstance(statement.value, ast.Constant)
                and type(statement.value.value) is int
                and "exit_code" in ast.unparse(statement)
            )


class Said(NamedTuple):
    """What the programs can say, read once from their source."""

    codes: set[int]
    """Exit codes."""
    sentences: str
    """A text a line."""


@pytest.fixture(scope="module")
def said() -> Said:
    codes: set[int] = set()
    texts: list[str] = []
    for path in SOURCES:
        source = path.read_text("utf-8")
        tree = ast.parse(source)
        codes.update(exit_codes(tree))
        texts.extend(" ".join(text.split()) for text in prose_of_python(source, tree))
    return Said(codes, "\n".join(texts))


def test_every_exit_code_has_a_row_and_there_is_no_other(said: Said) -> None:
    used_codes = said.codes
    assert {0, 1, 2, 3, 4, 130} <= used_codes
    assert {int(row[0]) for row in rows(section("Exit codes"))} == used_codes | {
        SIGALRM
    }


def test_an_exit_code_that_is_new_would_be_found() -> None:
    assert list(exit_codes(ast.parse("EXIT_LATE = 7"))) == [7]
    assert list(
        exit_codes(ast.parse("def run(options):\n    return 0 if options else 9"))
    ) == [0, 9]


QUOTED = [
    word
    for title in re.findall(r"^## (.*)$", PAGE, re.MULTILINE)
    if title != "Exit codes"
    for word in first_words(title)
    if " " in word
]


def test_the_page_quotes_many_messages() -> None:
    assert len(QUOTED) > 80


@pytest.mark.parametrize("words", QUOTED)
def test_what_is_quoted_is_said(words: str, said: Said) -> None:
    pattern = ".*".join(re.escape(part.strip()) for part in words.split("…"))
    assert re.search(pattern, said.sentences), f"nothing in the source says {words!r}"


def test_what_is_not_said_would_be_found(said: Said) -> None:
    assert not re.search(re.escape("the flux capacitor is at fault"), said.sentences)


@pytest.mark.parametrize(
    "page", ["README.md", "docs/index.md", "docs/dashboard.md", "docs/health.md"]
)
def test_the_page_is_linked(page: str) -> None:
    text = (PROJECT / page).read_text("utf-8")
    name = Path("docs/troubleshooting.md").relative_to(Path(page).parent)
    assert f"]({name})" in text
