"""`twinmatch report` as a user meets it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.support.places import SHIPPED
from tests.support.processes import run_twinmatch


def run(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return run_twinmatch("report", *arguments, folder=cwd)


def test_report_and_figures_are_written_and_named(tmp_path: Path) -> None:
    done = run(SHIPPED, "--figures", tmp_path / "figures", "--format", "pdf", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Nominal:" in done.stdout
    assert "report: four_setpoints.html" in done.stdout
    text = (tmp_path / "four_setpoints.html").read_text(encoding="utf-8")
    assert "twinmatch report" in text
    assert {p.name for p in (tmp_path / "figures").iterdir()} >= {"session.pdf", "nu_gap.pdf"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["absent.mcap"], ["absent.mcap", "does not exist"]),
        ([SHIPPED, "-o", "no/such/report.html"], ["the folder no/such does not exist"]),
        ([SHIPPED, "-o", "."], ["is a folder"]),
        ([SHIPPED, "--config", "absent.yaml"], ["absent.yaml", "cannot be read"]),
        (["noise.mat"], ["noise.mat"]),
    ],
    ids=["missing", "no folder", "folder", "config", "garbage"],
)
def test_a_mistake_is_one_line(arguments: list[object], words: list[str], tmp_path: Path) -> None:
    (tmp_path / "noise.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(range(256)) * 4)
    done = run(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert all(word in lines[0] for word in words), lines[0]
    assert not list(tmp_path.glob("*.html"))
