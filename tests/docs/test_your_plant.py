"""The page that leads from a table to a verdict does so: its commands run in their order and say what it
says."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.places import PROJECT
from tests.support.processes import run_twinmatch

PAGE = PROJECT / "docs" / "your_plant.md"


def commands() -> list[list[str]]:
    blocks = re.findall(r"^```console\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [shlex.split(line.removeprefix("$ ")) for block in blocks for line in block.splitlines()]


def files(folder: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name, code in re.findall(r"^```python (\w+\.py)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        (folder / name).write_text(code, encoding="utf-8")


def python(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_page_leads_from_a_table_to_a_verdict(tmp_path: Path) -> None:
    files(tmp_path)
    assert python("make_log.py", folder=tmp_path).returncode == 0
    said: list[tuple[list[str], int, str]] = []
    for program, *arguments in commands():
        if program == "twinmatch":
            done = run_twinmatch(*arguments, folder=tmp_path)
        else:
            done = python(*arguments, folder=tmp_path)
        assert "Traceback" not in done.stderr, done.stderr
        said.append((arguments, done.returncode, done.stdout + done.stderr))
    looked = [(code, text) for arguments, code, text in said if "--data" in arguments]
    others = [(arguments, code) for arguments, code, _ in said if "--data" not in arguments]
    assert all(code == 0 for _, code in others), others
    assert [code for code, _ in looked] == [1, 0]
    assert re.search(
        r"as not_explained: even the best fit leaves residuals of \d\d.* times the noise "
        r"variance",
        looked[0][1],
    )
    found = dict(re.findall(r"(gain|lag|sensor_lag) = ([\d.]+) ±", looked[1][1]))
    # What the page's table was made with; its noise leaves less than a hundredth of it open.
    assert {name: float(value) for name, value in found.items()} == pytest.approx(
        {"gain": 0.45, "lag": 180.0, "sensor_lag": 12.0}, rel=0.02
    )
    assert "trust it between" in said[-1][2].splitlines()[-1]
