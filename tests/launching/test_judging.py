"""The twin in a thread of its own: a defect in what is only shown costs that alone."""

from __future__ import annotations

import pytest

from tests.support.steps import quarter_of_an_hour
from twinmatch.defects import DefectWarning
from twinmatch.launching.judging import Judged, Judging
from twinmatch.signals import Sample
from twinmatch.twin import Mirror, MirrorState, TwinSettings


def test_a_defect_in_what_is_shown_costs_no_verdict(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = Mirror.push

    def broken(mirror: Mirror, sample: Sample) -> MirrorState:
        if sample.index == 7:
            raise ZeroDivisionError("a slip")
        return real(mirror, sample)

    def judged(number: int) -> list[Judged]:
        judging = Judging(TwinSettings(), [], shown=True)
        try:
            for sample in quarter_of_an_hour()[:number]:
                judging.push(sample)
            return [judging.judged.get() for _ in range(number)]
        finally:
            judging.close()

    monkeypatch.setattr(Mirror, "push", broken)
    with pytest.warns(
        DefectWarning, match="a sample could not be shown, because of a defect in"
    ):
        results = judged(61)
    assert [result.sample.index for result in results if result.mirror is None] == [7]
    assert [
        verdict.sample for result in results for verdict in result.outcome.verdicts
    ] == [59]
