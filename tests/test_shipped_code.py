"""Machine code of a wheel that is not used is reported where somebody waits for it to be compiled."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from twinmatch import compiled, shipped_code
from twinmatch.cli import shared
from twinmatch.cli.shared import Progress
from twinmatch.shipped_code import versions, why_not_used
from twinmatch.showing import terminal
from twinmatch.showing.console import Console
from twinmatch.showing.terminal import Screen


@pytest.fixture
def made_with(tmp_path: Path) -> Path:
    return tmp_path / "made_with.json"


def test_with_the_same_versions_nothing_is_said(made_with: Path) -> None:
    assert why_not_used(made_with) == ""
    made_with.write_text(json.dumps(versions()))
    assert why_not_used(made_with) == ""
    assert not shipped_code.MADE_WITH.exists(), "a checkout has no such file"


def test_another_numba_is_named_with_what_to_do(made_with: Path) -> None:
    installed = versions()
    made_with.write_text(json.dumps(installed | {"numba": "0.61.0"}))
    reason = why_not_used(made_with)
    assert f"is for numba 0.61.0, not for numba {installed['numba']}" in reason
    assert "`pip install numba==0.61.0` saves it" in reason
    assert "Python" not in reason
    assert "\n" not in reason


def test_another_python_is_named_and_nothing_is_to_be_installed(
    made_with: Path,
) -> None:
    made_with.write_text(json.dumps(versions() | {"Python": "3.9"}))
    reason = why_not_used(made_with)
    assert "is for Python 3.9, not for Python 3." in reason
    assert "pip" not in reason


def test_one_line_for_who_waits(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for place in (shared, terminal):
        monkeypatch.setattr(place, "why_not_used", lambda: "it is for another numba")
    with Progress():
        for tell in compiled.told:
            tell("one")
            tell("two")
    lines = capsys.readouterr().err.splitlines()
    assert lines.count("twinmatch: it is for another numba") == 1
    stream = io.StringIO()
    screen = Screen(Console(file=stream), "replay", 1.0)
    screen.open()
    for tell in compiled.told:
        tell("one")
        tell("two")
    screen.close()
    assert stream.getvalue().count("twinmatch: it is for another numba") == 1
