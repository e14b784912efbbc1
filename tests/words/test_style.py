"""No text of the project has a wording that its style page rules out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.places import PROJECT
from tests.support.prose import RULES, STYLE_PAGE, Rule, findings, prose_files, read_prose

SHOWS_THEM = {PROJECT / "tests" / "support" / "prose.py", Path(__file__).resolve()}
FILES = [path for path in prose_files() if path not in SHOWS_THEM]


def room_of(path: Path) -> str:
    """The folder that one editor goes through: a room of the source, or a folder of the project."""
    parts = path.relative_to(PROJECT).parts
    return "/".join(parts[:3] if parts[0] == "src" and len(parts) > 3 else parts[:-1][:2] or ("the project",))


ROOMS = sorted({room_of(path) for path in FILES})


def faults_of(path: Path) -> list[str]:
    found = {found for line, text in read_prose(path) for found in findings(text, line)}
    name = path.relative_to(PROJECT)
    return [f'{name}:{line}: "{words}": {instead}' for line, words, instead in sorted(found)]


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.pattern)
def test_a_rule_finds_what_it_rules_out_and_nothing_in_what_it_asks_for(rule: Rule) -> None:
    assert [found.instead for found in findings(rule.wrong)] == [rule.instead]
    assert findings(rule.right) == []


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("message.py", 'def refuse(x):\n    raise ValueError(f"{x}: is no number")\n'),
        ("split.py", 'def refuse(x):\n    raise ValueError("a text "\n        "that is no number")\n'),
        ("docstring.py", '"""A page.\n\nWhat it is: is no\nnumber.\n"""\n'),
        ("comment.py", "x = 1\n# this is no number\n"),
        ("test_name.py", "\ndef test_what_is_no_number_is_refused(): ...\n"),
        ("page.md", "# Page\n\nThis is no\nnumber.\n"),
        (
            "notes.ipynb",
            '{"cells": [{"cell_type": "markdown", "source": ["# A\\n", "This is no\\n", "number."]}]}',
        ),
        ("config.yaml", "a: 1\n# is no number\nb: 2\n"),
        ("Some.msg", "float64 a\n# is no number\n"),
    ],
)
def test_a_bad_sentence_is_found_wherever_it_stands(tmp_path: Path, name: str, text: str) -> None:
    page = tmp_path / name
    page.write_text(text, encoding="utf-8")
    found = sorted({f for line, prose in read_prose(page) for f in findings(prose, line)})
    assert [(f.words, f.instead) for f in found] == [("is no", RULES[0].instead)]
    assert 2 <= found[0].line <= 3


def test_identifiers_code_and_paths_are_left_out(tmp_path: Path) -> None:
    page = tmp_path / "module.py"
    page.write_text('heard = {"heard": 1}  # see docs/who-foretells.md and `foretell`\n', encoding="utf-8")
    assert not [f for line, prose in read_prose(page) for f in findings(prose, line)]


def test_there_is_prose_of_every_kind() -> None:
    assert {".py", ".md", ".msg", ".srv", ".yaml", ".html"} <= {path.suffix for path in FILES}
    assert len(FILES) > 700


@pytest.mark.parametrize("room", ROOMS)
def test_nothing_that_is_ruled_out_is_written(room: str) -> None:
    found = [fault for path in FILES if room_of(path) == room for fault in faults_of(path)]
    assert not found, f"{len(found)} wordings that docs/style.md rules out:\n" + "\n".join(found)


def test_the_style_page_shows_pairs_that_its_rules_agree_with() -> None:
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|", STYLE_PAGE.read_text("utf-8"), re.MULTILINE)
    pairs = [(before, after) for before, after in rows if before not in {"instead of", "---"}]
    assert len(pairs) >= 15
    assert not [after for _, after in pairs if findings(after)]
    assert sum(bool(findings(before)) for before, _ in pairs) >= 10
