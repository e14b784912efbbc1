"""`twinmatch report` as a user meets it."""

from __future__ import annotations

import subprocess
from pathlib import Path

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
