"""The changes that may begin in a plant, and how probable each is."""

from __future__ import annotations

import math

import pytest

from benchmarks.bank.kits import typical
from twinmatch.health.change_table import BETWEEN_ONSETS, ChangeTable
from twinmatch.health.faults import Fault
from twinmatch.health.hypotheses import ChangeRow, rows_of
from twinmatch.health.mixture import HealthyMixture

HOUR = 3600.0
USUAL = rows_of(typical().model)


@pytest.fixture(scope="module")
def healthy() -> HealthyMixture:
    return HealthyMixture(typical(), 1.0)


def first(fault: Fault) -> ChangeRow:
    return next(row for row in USUAL if row.cause[0] is fault)


def test_in_an_hour_one_change_begins(healthy: HealthyMixture) -> None:
    """What crosses between the loops is nobody's fault, and counts beside that."""
    table = ChangeTable(USUAL, [], healthy)
    masses = [
        mass
        for row, mass in zip(table.rows, table.of_bank.mass, strict=True)
        if not row.crosses
    ]
    assert sum(masses) * HOUR / BETWEEN_ONSETS == pytest.approx(1.0)


def test_causes_are_equally_probable_and_their_rows_share_it_by_price(
    healthy: HealthyMixture,
) -> None:
    table = ChangeTable(USUAL, [], healthy)
    by_explanation: dict[object, float] = {}
    for row, mass in zip(table.rows, table.of_bank.mass, strict=True):
        before = by_explanation.get(row.explanation, 0.0)
        by_explanation[row.explanation] = before + float(mass)
    assert [*by_explanation] == table.explanations
    masses = [*by_explanation.values()]
    assert masses == pytest.approx([masses[0]] * len(masses))
    dear, cheap = (
        float(table.of_bank.mass[table.rows.index(row)])
        for row in sorted(
            (row for row in USUAL if row.cause == (Fault.SENSOR_DRIFT, 0)),
            key=lambda row: -row.price,
        )
    )
    assert dear / cheap == pytest.approx(math.exp(-6.0))


def test_the_end_of_a_named_change_is_expected_within_ten_minutes(
    healthy: HealthyMixture,
) -> None:
    named = first(Fault.DRIVE_WEAK)
    table = ChangeTable(USUAL, [named], healthy)
    assert table.rows[:-1] == USUAL
    end = table.rows[-1]
    assert end.is_end
    assert end.number == named.number
    mass_of_end = float(table.of_bank.mass[-1])
    assert mass_of_end * 600.0 / BETWEEN_ONSETS == pytest.approx(1.0)
    causes = len({row.cause for row in USUAL if not row.crosses})
    mass_of_cause = BETWEEN_ONSETS / HOUR / causes
    assert table.expects_ends_by == pytest.approx(math.log(mass_of_end / mass_of_cause))


def test_the_bank_receives_what_each_row_moves(healthy: HealthyMixture) -> None:
    table = ChangeTable(USUAL, [], healthy)
    names = [*healthy.numbers]
    rows = table.of_bank
    assert [names[number] for number in rows.number] == [row.number for row in USUAL]
    for place, row in enumerate(USUAL):
        also = [names[number] for number in rows.also[place] if number >= 0]
        assert also == [*row.also]
        assert rows.follows[place].any() == row.crosses
        assert bool(rows.whole[place]) == (row.cause[0] is Fault.DRIVE_LOST)
