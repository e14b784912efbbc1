"""A simulated kit with two heaters whose second sensor lies in the end, judged once for all that shows it."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.bank.kits import run
from twinmatch.offline.judging import Judgement
from twinmatch.plants.tclab import TCLabBoth
from twinmatch.sessions import write_session
from twinmatch.sessions.metadata import PLANT
from twinmatch.showing.report.report import (
    JudgedSession,
    SessionReport,
    build_report,
    judge_for_report,
)

LIES_FROM = 1020
"""Sample from which on T2 reads 5 °C too much: two horizons of either output are trusted by then."""
ENDS = LIES_FROM + 80
"""Samples of the session."""


@pytest.fixture(scope="session")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session."""
    folder = tmp_path_factory.mktemp("two") / "kit"
    records = {PLANT: {"plant": TCLabBoth.name}}
    return write_session(
        folder, list(run(21, "T2 +5 °C", ENDS, LIES_FROM)), records=records
    )


@pytest.fixture(scope="session")
def driven(kit: Path) -> Path:
    """Parameters with which it is judged under its inputs, as if its loop were not known."""
    path = kit.with_name("driven.yaml")
    path.write_text(
        "/**:\n  ros__parameters: {plant: tclab-both, loop: unknown}\n",
        encoding="utf-8",
    )
    return path


@pytest.fixture(scope="session")
def kit_judged(kit: Path, driven: Path) -> JudgedSession:
    """It judged, with forecasts on the way."""
    return judge_for_report(kit, driven)


@pytest.fixture(scope="session")
def kit_report(kit: Path, kit_judged: JudgedSession) -> SessionReport:
    """The report on it, whose figures take longer than the judgement."""
    return build_report(kit_judged, kit)


@pytest.fixture(scope="session")
def two(kit_judged: JudgedSession) -> Judgement:
    """Its judgement."""
    return kit_judged.judgement
