"""What a plant does while it is another says nothing of its twins."""

from __future__ import annotations

from pathlib import Path

from tests.support.incubator import LIDS, PERIOD, read_events, read_run
from twinmatch.plants import Incubator
from twinmatch.twin import Twin, TwinSettings

ENDS = 960
"""Samples of the recording: the lid is opened and closed once, and a quarter of an hour follows."""


def test_a_lid_that_was_open_for_minutes_costs_no_trust(incubator_folder: Path) -> None:
    """Forecasts of the open box had errors of a hundred noises, as those of ARX had, which has known the open
    box since, and errs by thirty for half an hour."""
    opened, closed = read_events(incubator_folder, LIDS)[:2] / PERIOD
    twin = Twin(TwinSettings.of(Incubator, law=None, period=PERIOD))
    verdicts = []
    for sample in read_run(incubator_folder, LIDS).samples(0)[:ENDS]:
        verdicts += twin.push(sample).verdicts
    before = [verdict for verdict in verdicts if verdict.sample < opened][-1]
    meanwhile = [v for v in verdicts if v.fault]
    last = verdicts[-1]
    assert opened < meanwhile[0].sample < closed
    assert {verdict.level.value for verdict in meanwhile} == {"doubtful"}
    assert last.level.value == "trusted"
    assert {*before.trusted} <= {*last.trusted}
    assert before.leading is not None
    assert last.leading is not None
    for now, then in zip(
        last.leading.persistence_skill, before.leading.persistence_skill, strict=True
    ):
        assert now > then - 0.1
