"""The rehearsal reaches everything that a first run would otherwise compile, and happens once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from twinmatch.offline import judging
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.plants import Incubator, Peltier
from twinmatch.twin import TwinSettings


def test_a_rehearsal_matches_judges_and_forecasts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[Judgement] = []

    def judge(*args: Any, **settings: Any) -> Judgement:
        judged.append(judge_samples(*args, **settings))
        return judged[-1]

    monkeypatch.setattr(judging, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(judging, "judge_samples", judge)
    for _ in range(2):
        judging.rehearse(Peltier, TwinSettings(), lambda _done, _total: None)
    (only,) = judged
    last = only.verdicts[-1]
    assert any(report.match.accepted for report in only.matches)
    assert len(last.candidates) >= 2
    assert last.nu_gap
    assert last.forecasts


def test_a_plant_without_a_loop_is_not_rehearsed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judging, "cache_folder", lambda: tmp_path)
    judging.rehearse(Incubator, TwinSettings(), lambda _done, _total: None)
    assert not list(tmp_path.iterdir())
