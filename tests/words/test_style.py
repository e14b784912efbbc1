"""No text of the project has a wording that its style page rules out."""

from __future__ import annotations

import ast
import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.places import PROJECT

STYLE_PAGE = PROJECT / "docs" / "style.md"
PAGES = {".md", ".ipynb"}
OTHERS = {
    ".msg",
    ".srv",
    ".yaml",
    ".toml",
    ".cfg",
    ".sh",
    ".html",
    ".jinja",
    ".css",
    ".xml",
}
RULES = {
    r"(?<!there )(?<!still )\b(is|are|was|were) no (?!longer|more\b|less|better|worse|other|\w+er than)": (
        'write "is not a …"'
    ),
    r"\banew\b": 'write "again", "starts over" or "restarts"',
    r"\b(who|whoever|one that|recorder that) (comes?|came|joins?) late(r)?\b": 'write "a late subscriber"',
    r"\b(pays?|paid|paying) for\b": 'write "justify" or "support"',
    r"\b(lest|thus|thereof|therein|thereby|thereupon|whereof|heretofore)\b": "write a plain sentence",
    r"\bwhoever\b": "name the reader, the caller or the program",
    r"\b(complain(s|ed|t|ts|ing)?)\b": 'write "warn", "warning" or "report"',
    r"\bwell again\b": 'write "recovered"',
    r"\bmend(s|ed|ing)?\b": 'write "fix", "repair" or "correct"',
    r"\b(hears?|heard)\b": 'write "receive" or "subscribe to"',
    r"\b(foretell(s|ing|er)?|foretold)\b": 'write "forecast" or "predict"',
    r"\bnobody (publishes|hears|listens|answers)\b": 'write "no publisher", "no subscriber", "no answer"',
    r"\b(goes|go|went) on\b": 'write "continues"',
    r"\b(is|are|was|were|be|been) told\b(?! (apart|from)\b)": 'write "reported", "distinguished" or "given"',
    r"(?<!-)\b(shoot|shoots|shot)\b": 'write "killed"',
    r"\bany more\b(?! than)": 'write "no longer"',
    r"\b(asked for )?in writing\b": 'write "explicitly enabled"',
    r"\b\w+s? of (yours|ours|theirs)\b": 'write "your …", "our …"',
    r"\bpassed over\b": 'write "skipped"',
    r"\b(that|which) (is|are) none\b": 'write "invalid …" or "is not a …"',
    r"\bspeaks? of\b": 'write "is about", "names" or "describes"',
    r"\bwhat came\b(?! (from|over|in)\b)": 'write "the measurements" or "the samples after it"',
    r"\bin (plain|its own) words\b": "leave it out, or say what is shown",
    r"\bwhat (it|they) (was|were) given\b": 'write "its arguments" or "its input"',
}
"""Wordings that are ruled out, with one blank between words, and what to write instead."""
COMMENT = re.compile(
    r'"""[\s\S]*?"""|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'|(#[^\n]*)'
)
"""A string, or a comment, which is the group."""
READ = re.compile(rf"(?<=def )test_\w+|{COMMENT.pattern}")
"""What a person reads of a module: names of tests, strings and comments, in their order."""
SUSPECT = re.compile(
    r"\b(?:"
    + "|".join(re.sub(r"^(\(\?<![^)]*\))*", "", pattern) for pattern in RULES)
    + ")",
    re.IGNORECASE,
)
"""Where one of them may be: all in one pass, whatever stands before."""


JOINT = re.compile(r"""(?:\\n|[\s"'#_])+(?:[fr]{1,2}(?=["'])["'])?""")
"""What stands between words of a text that a module spreads over strings, comments or a name."""


def findings(text: str) -> list[str]:
    """What is ruled out in a text, less its code in backticks, links, paths and dotted names."""
    shown = re.sub(
        r"`[^`\n]+`|\]\([^)\n]*\)|\S*/\S*\.(?:md|py)\b|\w+(?:\.\w+){2,}", "•", text
    )
    flat = " ".join(word for word in shown.split() if word != "#")
    return [
        f'"{ruled_out[0].strip()}": {instead}'
        for suspect in SUSPECT.finditer(flat)
        for pattern, instead in RULES.items()
        if (
            ruled_out := re.compile(pattern, re.IGNORECASE).match(flat, suspect.start())
        )
    ]


def prose_of_python(source: str, tree: ast.AST | None = None) -> Iterator[str]:
    """Texts of a module with a blank in them, names of tests, and its comments.

    `tree` is its syntax, if it has been parsed before.
    """
    for node in ast.walk(tree or ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            yield "".join(
                str(p.value) if isinstance(p, ast.Constant) else "…"
                for p in node.values
            )
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and " " in node.value
        ):
            yield node.value
        elif isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            yield node.name.replace("_", " ")
    yield "\n".join(comment[1] for comment in COMMENT.finditer(source) if comment[1])


def prose(path: Path) -> Iterator[str]:
    """What a person reads in a file."""
    text = path.read_text("utf-8")
    if path.suffix == ".py":
        yield from prose_of_python(text)
    elif path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        yield from (
            "".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"
        )
    elif path == STYLE_PAGE:
        # the first column of its table is there to show what is wrong
        yield re.sub(r"^\|[^|]*\|", "|", text, flags=re.MULTILINE)
    elif path.suffix in {".msg", ".srv"}:  # what stands before a comment is a field
        yield re.sub(r"^[^#\n]*", "", text, flags=re.MULTILINE)
    else:
        yield text


def may_be_ruled_out(source: str) -> bool:
    """Whether a module may have a wording that is ruled out: most have none, and need no parsing.

    What a module spreads over several strings or comments is joined, whatever code stands between them.
    """
    texts = " ".join(text[0] for text in READ.finditer(source))
    return SUSPECT.search(JOINT.sub(" ", texts)) is not None


def ruled_out_in(path: Path) -> set[str]:
    """What is ruled out in a file."""
    if path.suffix == ".py" and not may_be_ruled_out(path.read_text("utf-8")):
        return set()
    return set(findings("\n•\n".join(prose(path))))  # no wording reaches across a •


def files() -> list[Path]:
    kinds = PAGES | OTHERS | {".py"}
    ours = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(
        ours, cwd=PROJECT, capture_output=True, text=True, check=False
    ).stdout.split("\n")
    paths = [PROJECT / name for name in listed if name] or list(PROJECT.rglob("*.*"))
    left_out = {Path(__file__).resolve(), *PROJECT.rglob("first_form/*")}
    return [
        p
        for p in paths
        if (p.suffix in kinds or p.name == "Makefile")
        and p.is_file()
        and p not in left_out
    ]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("message.py", 'def refuse(x):\n    raise ValueError(f"{x}: is no number")\n'),
        (
            "split.py",
            'def refuse(x):\n    raise ValueError("a text "\n        "that is no number")\n',
        ),
        ("docstring.py", '"""A page.\n\nWhat it is: is no\nnumber.\n"""\n'),
        ("comment.py", "x = 1\n# this is\n# no number\n"),
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
def test_a_bad_sentence_is_found_wherever_it_stands(
    tmp_path: Path, name: str, text: str
) -> None:
    page = tmp_path / name
    page.write_text(text, encoding="utf-8")
    assert ruled_out_in(page) == {f'"is no": {next(iter(RULES.values()))}'}


def test_identifiers_code_and_paths_are_left_out() -> None:
    source = 'heard = {"heard": 1}  # see docs/who-foretells.md and `foretell`\n'
    assert not [
        finding for part in prose_of_python(source) for finding in findings(part)
    ]


def test_nothing_that_is_ruled_out_is_written() -> None:
    paths = files()
    assert {".py", ".md", ".msg", ".srv", ".yaml", ".html"} <= {
        path.suffix for path in paths
    }
    reported = [
        f"{path.relative_to(PROJECT)}: {words}"
        for path in paths
        for words in sorted(ruled_out_in(path))
    ]
    assert not reported, "wordings that docs/style.md rules out:\n" + "\n".join(
        reported
    )


def test_the_style_page_shows_pairs_that_the_rules_agree_with() -> None:
    rows = re.findall(
        r"^\| ([^|]+) \| ([^|]+) \|", STYLE_PAGE.read_text("utf-8"), re.MULTILINE
    )
    pairs = [
        (before, after) for before, after in rows if before not in {"instead of", "---"}
    ]
    assert len(pairs) >= 15
    assert not [after for _, after in pairs if findings(after)]
    assert sum(bool(findings(before)) for before, _ in pairs) >= 10
