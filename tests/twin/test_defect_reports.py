"""Defects behind verdicts that could not be made: what is logged, and when one is reported again."""

from __future__ import annotations

import pytest

from twinmatch.defects import Defect, DefectWarning
from twinmatch.errors import TwinmatchError
from twinmatch.twin.defect_reports import DefectReports

SLIP = Defect("ZeroDivisionError", "slip.py", 3, "divide")
OTHER = Defect("KeyError: 'a'", "other.py", 9, "look_up")


def test_a_defect_at_every_sample_is_reported_once_per_stride() -> None:
    reports = DefectReports(stride=30)
    due = [sample for sample in range(100) if reports.is_due(SLIP, sample)]
    assert due == [0, 30, 60, 90]


def test_a_defect_that_comes_back_is_reported_at_once() -> None:
    reports = DefectReports(stride=30)
    samples = [5, 6, 8, 9]
    assert [sample for sample in samples if reports.is_due(SLIP, sample)] == [5, 8]


def test_a_defect_in_another_place_is_reported_at_once() -> None:
    reports = DefectReports(stride=30)
    assert reports.is_due(SLIP, 5)
    assert reports.is_due(OTHER, 6)
    assert not reports.is_due(OTHER, 7)


def test_a_defect_is_logged_once_per_place() -> None:
    reports = DefectReports(stride=30)
    with pytest.raises(ZeroDivisionError) as raised:
        _ = 1 // 0
    with pytest.warns(DefectWarning, match="no verdict could be made") as warned:
        _logged_twice(reports, raised.value)
    assert len(warned) == 1
    assert len(reports.logged) == 1


def _logged_twice(reports: DefectReports, error: Exception) -> None:
    assert reports.log(error) == reports.log(error)


def test_an_error_that_the_user_can_fix_is_not_a_defect() -> None:
    reports = DefectReports(stride=30)
    with pytest.raises(TwinmatchError, match=r"tank\.yaml"):
        reports.log(TwinmatchError("tank.yaml: line 3: no period"))
    assert not reports.logged
