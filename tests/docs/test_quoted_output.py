"""What pages quote of a command's output is what the command says.

A block fenced as `console` begins with `$ ` and a command; the lines below it are quoted. A line `…` stands for
any number of lines, and `…` at the end of a line for the rest of it. Words are compared exactly; figures may
differ as far as another machine's last digits can move them.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.places import PROJECT
from tests.support.processes import run_twinmatch

DOCS = PROJECT / "docs"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
CLOSE = 0.03
"""Relative difference that figures may have."""


def quoted_runs(page: Path) -> list[tuple[list[str], list[str]]]:
    """Commands of a page, each with the lines that it quotes below them."""
    text = page.read_text(encoding="utf-8")
    runs: list[tuple[list[str], list[str]]] = []
    for block in re.findall(r"^```console\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        for line in block.splitlines():
            if line.startswith("$ "):
                runs.append((shlex.split(line.removeprefix("$ ")), []))
            else:
                runs[-1][1].append(line)
    return runs


def is_like(quoted: str, printed: str) -> bool:
    """Whether a printed line has the words of a quoted one, and nearly its figures."""
    if quoted.endswith("…"):
        quoted = quoted.removesuffix("…")
        words = len(NUMBER.split(quoted))
        pieces = NUMBER.split(printed)[:words]
        pieces[-1] = pieces[-1][: len(NUMBER.split(quoted)[-1])]
    else:
        pieces = NUMBER.split(printed)
    if pieces != NUMBER.split(quoted):
        return False
    figures = [float(figure) for figure in NUMBER.findall(quoted)]
    printed_figures = [float(figure) for figure in NUMBER.findall(printed)]
    return printed_figures[: len(figures)] == pytest.approx(figures, rel=CLOSE)


def missing_lines(quoted: list[str], printed: list[str]) -> list[str]:
    """The quoted lines that do not follow one another in what was printed."""
    missing = []
    rest = iter(printed)
    for line in quoted:
        if line.strip() == "…":
            continue
        if not any(is_like(line, candidate) for candidate in rest):
            missing.append(line)
            rest = iter(printed)
    return missing


@pytest.mark.parametrize(
    ("quoted", "printed", "expected"),
    [
        ("lag 656 ± 6.6", "lag 656 ± 6.61", True),
        ("lag 656 ± 6.6", "lag 700 ± 6.6", False),
        ("lag 656 ± 6.6", "gain 656 ± 6.6", False),
        ("then heater at 55 % …", "then heater at 55 % for 1440 s", True),
        ("then heater at 55 % …", "then heater at 40 % for 1440 s", False),
        ("its twin is trusted", "its twin is trusted, perhaps", False),
    ],
)
def test_lines_are_compared_by_words_and_figures(
    quoted: str, printed: str, expected: bool
) -> None:
    assert is_like(quoted, printed) == expected


def test_quoted_lines_have_to_come_in_their_order() -> None:
    printed = ["first 1", "second 2", "third 3"]
    assert missing_lines(["first 1", "…", "third 3"], printed) == []
    assert missing_lines(["third 3", "first 1"], printed) == ["first 1"]


@pytest.fixture
def _in_greenwich(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Times of day are those of the machine's zone; the pages quote them in UTC."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "UTC")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.usefixtures("_in_greenwich")
@pytest.mark.parametrize("name", ["controllers", "experiment", "forecast", "newcomer"])
def test_what_a_page_quotes_is_printed(name: str, tmp_path: Path) -> None:
    """In a folder with the files of the page and the sample session."""
    page = DOCS / f"{name}.md"
    for file, content in re.findall(
        r"^```(?:python|json) (\w+\.\w+)\n(.*?)^```",
        page.read_text(encoding="utf-8"),
        re.DOTALL | re.MULTILINE,
    ):
        (tmp_path / file).write_text(content, encoding="utf-8")
    (tmp_path / "bags").symlink_to(PROJECT / "bags")
    runs = quoted_runs(page)
    assert runs
    for (program, *arguments), quoted in runs:
        if program == "python":
            subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True)
        else:
            assert program == "twinmatch"
            completed = run_twinmatch(*arguments, folder=tmp_path)
            assert completed.returncode == 0, completed.stderr
            assert missing_lines(quoted, completed.stdout.splitlines()) == [], arguments


def test_the_sentence_that_the_readme_quotes_is_that_of_its_session() -> None:
    readme = (PROJECT / "README.md").read_text(encoding="utf-8")
    quoted = re.search(r"The sentence reads like this: \*(Leader: [^*]*)\*", readme)
    assert quoted is not None
    completed = run_twinmatch("replay", "bags/four_setpoints", folder=PROJECT)
    assert missing_lines([quoted[1]], completed.stdout.splitlines()) == []
