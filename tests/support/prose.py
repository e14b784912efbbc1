"""The prose of the project, file by file, and the wordings that its style page rules out.

`read_prose` yields what a person reads: Markdown pages, the texts of notebooks, the comments and the strings
with a blank of a Python file (docstrings, messages, help, names of tests), and whole files of other kinds.
`findings` matches `RULES` against one piece of it.
"""

from __future__ import annotations

import ast
import io
import json
import re
import tokenize
from bisect import bisect_right
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from tests.support.places import PROJECT

STYLE_PAGE = PROJECT / "docs" / "style.md"
FOLDERS = ("src", "tests", "docs", "benchmarks", "launch_scripts", "camera_server", "config", ".ci")
PAGES = {".md", ".ipynb"}
COMMENTED = {".msg", ".srv", ".yaml", ".toml", ".cfg", ".sh", ".html", ".jinja", ".css", ".xml"}
LEFT_OUT = {"build", "__pycache__", ".venv", "first_form"}
"""Folders with files that are generated, or kept as they once were."""


class Rule(NamedTuple):
    """A wording that is ruled out."""

    pattern: str
    """Regular expression for words with one blank between them; case is ignored."""
    instead: str
    wrong: str
    """A sentence in which it must be found."""
    right: str
    """The sentence as it should be, in which nothing may be found."""


RULES = (
    Rule(
        r"(?<!there )(?<!still )\b(is|are|was|were) no (?!longer|more\b|less|better|worse|other|\w+er than)",
        'write "is not a …"',
        "'x' is no number; give one",
        "'x' is not a number; give one. There is no default, and it is no longer read.",
    ),
    Rule(
        r"\banew\b",
        'write "again", "starts over" or "restarts"',
        "windows begin anew there",
        "windows start over there",
    ),
    Rule(
        r"\b(who|whoever|one that|recorder that) (comes?|came|joins?) late(r)?\b",
        'write "a late subscriber" (or recorder, node)',
        "the value is kept for who comes late",
        "the value is latched for late subscribers",
    ),
    Rule(
        r"\b(pays?|paid|paying) for\b",
        'write "justify" or "support"',
        "the structure that the samples pay for",
        "the structure that the samples justify",
    ),
    Rule(
        r"\b(lest|thus|thereof|therein|thereby|thereupon|whereof|heretofore)\b",
        "write what follows from what in a plain sentence",
        "the copy is closed first, lest a reader see half of it",
        "the copy is closed first, so that no reader sees half of it",
    ),
    Rule(
        r"\bwhoever\b",
        "name the reader, the caller or the program",
        "the page is open to whoever reaches the machine",
        "the page is open to everyone who can reach the machine",
    ),
    Rule(
        r"\b(complain(s|ed|t|ts|ing)?)\b",
        'write "warn", "warning" or "report"',
        "a silent sensor is complained of",
        "a silent sensor is reported",
    ),
    Rule(r"\bwell again\b", 'write "recovered"', "health: well again", "health: recovered"),
    Rule(
        r"\bmend(s|ed|ing)?\b",
        'write "fix", "repair" or "correct"',
        "mend it, then clear the fault",
        "fix it, then clear the fault",
    ),
    Rule(
        r"\b(hears?|heard)\b",
        'write "receive" or "subscribe to"',
        "the node hears three topics",
        "the node subscribes to three topics",
    ),
    Rule(
        r"\b(foretell(s|ing|er)?|foretold)\b",
        'write "forecast" or "predict"',
        "each candidate foretells the next minutes",
        "each candidate forecasts the next minutes. See `foretell`.",
    ),
    Rule(
        r"\bnobody (publishes|hears|listens|answers)\b",
        'write "no publisher", "no subscriber", "no answer"',
        "nobody publishes /sp",
        "no publisher on /sp",
    ),
    Rule(
        r"\b(goes|go|went) on\b",
        'write "continues"',
        "the run goes on where it stopped",
        "the run continues where it stopped",
    ),
    Rule(
        r"\b(is|are|was|were|be|been) told\b(?! (apart|from)\b)",
        'write "reported", "distinguished" or "given"',
        "a lost drive is told within half a minute",
        "a lost drive is reported within half a minute, and can be told apart from a weak one",
    ),
    Rule(
        r"(?<!-)\b(shoot|shoots|shot)\b",
        'write "killed"',
        "a twin that was shot comes back",
        "a twin that was killed comes back",
    ),
    Rule(
        r"\bany more\b(?! than)",
        'write "no longer"',
        "it does not read the topic any more",
        "it no longer reads the topic",
    ),
    Rule(
        r"\b(asked for )?in writing\b",
        'write "explicitly enabled"',
        "the network is open only if asked for in writing",
        "the network is open only if explicitly enabled",
    ),
    Rule(
        r"\b\w+s? of (yours|ours|theirs)\b",
        'write "your …", "our …"',
        "how a program of yours reads it",
        "how your program reads it",
    ),
    Rule(
        r"\bpassed over\b",
        'write "skipped"',
        "a session that cannot be used is passed over",
        "a session that cannot be used is skipped",
    ),
    Rule(
        r"\b(that|which) (is|are) none\b",
        'write "invalid …" or "is not a …"',
        "an address that is none is refused",
        "an invalid address is refused",
    ),
    Rule(
        r"\bspeaks? of\b",
        'write "is about", "names" or "describes"',
        "it says of which sample it speaks, and speaks of it",
        "it names the sample it is based on",
    ),
    Rule(
        r"\bwhat came\b(?! (from|over|in)\b)",
        'write "the measurements" or "the samples after it"',
        "every forecast against what came",
        "every forecast against the measurements",
    ),
    Rule(
        r"\bin (plain|its own) words\b",
        "leave it out, or say what is shown",
        "what is wrong with it, in plain words",
        "what is wrong with it, and where",
    ),
    Rule(
        r"\bwhat (it|they) (was|were) given\b",
        'write "its arguments" or "its input"',
        "it returns what it was given",
        "it returns its input",
    ),
)


class Found(NamedTuple):
    """A wording that is ruled out, where it stands."""

    line: int
    words: str
    instead: str


def findings(text: str, line: int = 1) -> list[Found]:
    """Match the rules against a text that begins at `line`, without its code in backticks and its links."""
    shown = re.sub(r"`[^`\n]+`|\]\([^)\n]*\)|\S*/\S*\.(?:md|py)\b", lambda m: "•" * len(m[0]), text)
    words = [word for word in re.finditer(r"\S+", shown) if word[0] != "#"]
    starts = list(accumulate((len(word[0]) + 1 for word in words), initial=0))
    flat = " ".join(word[0] for word in words)

    def line_of(position: int) -> int:
        return line + shown.count("\n", 0, words[bisect_right(starts, position) - 1].start())

    return sorted(
        Found(line_of(m.start()), m[0].strip(), rule.instead)
        for rule in RULES
        for m in re.finditer(rule.pattern, flat, re.IGNORECASE)
    )


def _python_prose(source: str) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            parts = [str(p.value) if isinstance(p, ast.Constant) else "…" for p in node.values]
            yield node.lineno, "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value
        elif isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            yield node.lineno, node.name.replace("_", " ")
    yield from _comments(source)


def _comments(source: str) -> Iterator[tuple[int, str]]:
    """Comments on consecutive lines are one text."""
    first, held = 0, list[str]()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            if held and token.start[0] != first + len(held):
                yield first, "\n".join(held)
                held = []
            first = first if held else token.start[0]
            held.append(token.string)
    if held:
        yield first, "\n".join(held)


def read_prose(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of what a person reads in a file; nothing for a kind that holds no prose."""
    text = path.read_text("utf-8")
    if path == STYLE_PAGE:  # the first column of its table is there to show what is wrong
        yield 1, re.sub(r"^\|[^|]*\|", "|", text, flags=re.MULTILINE)
    elif path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        yield from ((1, "".join(cell["source"])) for cell in cells if cell["cell_type"] == "markdown")
    elif path.suffix in {".msg", ".srv"}:  # what stands before a comment is a field
        yield 1, re.sub(r"^[^#\n]*", "", text, flags=re.MULTILINE)
    elif path.suffix in PAGES:
        yield 1, text
    elif path.suffix == ".py":
        yield from _python_prose(text)
    elif path.suffix in COMMENTED or path.name == "Makefile":
        yield 1, text


def prose_files() -> list[Path]:
    """Every file of the project that may hold prose."""
    top = [path for path in PROJECT.iterdir() if path.is_file()]
    below = [path for folder in FOLDERS for path in (PROJECT / folder).rglob("*")]
    kinds = PAGES | COMMENTED | {".py"}
    return sorted(
        path
        for path in top + below
        if (path.suffix in kinds or path.name == "Makefile")
        and path.is_file()
        and not LEFT_OUT & set(path.relative_to(PROJECT).parts)
        and not any(part.endswith(".egg-info") for part in path.parts)
    )
