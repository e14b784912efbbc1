"""What is said of trust and faults, once for all who show it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import twinmatch
from tests.support.verdicts import LED, verdict
from twinmatch.comparing import (
    ANYWHERE,
    FaultStatement,
    TrustLevel,
    TrustStatement,
    ahead_words,
    fault_of_drive,
    plant_fault,
    statements_of,
)

LOST = verdict(
    TrustLevel.FAULT,
    fault="drive-lost",
    fault_signal="pwm",
    fault_since=640,
    reason="the drive does nothing: look at wires and supply",
)


def test_before_the_first_verdict_nothing_is_known() -> None:
    statements = statements_of(None)
    assert statements.trust == TrustStatement(
        TrustLevel.UNKNOWN, "no forecast has been compared with measurements yet"
    )
    assert statements.faults == ()


def test_trust_reaches_to_the_longest_horizon_that_passes_and_only_while_the_level_is_trusted() -> (
    None
):
    trusted = replace(LED, horizons=(10.0, 60.0, 300.0), trusted=(10.0, 60.0))
    for level, longest in (
        (TrustLevel.TRUSTED, 60.0),
        (TrustLevel.DOUBTFUL, 0.0),
        (TrustLevel.FAULT, 0.0),
    ):
        trust = statements_of(replace(trusted, level=level)).trust
        assert trust.longest == longest
        assert ahead_words(trust.horizons) == "10 and 60 s ahead"
    assert ahead_words(()) == "at no horizon"


def test_readings_outside_the_bands_are_a_reason_where_they_are_the_doubt() -> None:
    missed = verdict(TrustLevel.DOUBTFUL, miss_since=240)
    assert statements_of(missed).trust.missed_since == 240
    assert (
        statements_of(replace(missed, level=TrustLevel.TRUSTED)).trust.missed_since
        is None
    )


def test_a_level_without_a_reason_has_the_usual_one() -> None:
    silent = verdict(TrustLevel.DOUBTFUL, level_reason="")
    assert (
        statements_of(silent).trust.reason
        == "measurements lie outside the forecast bands"
    )


def test_a_fault_says_what_it_is_since_when_and_where_to_look() -> None:
    fault = plant_fault(LOST)
    assert fault is not None
    assert (
        fault.with_reason
        == "drive-lost: the drive does nothing: look at wires and supply"
    )
    assert fault.with_begin(2.0) == "drive-lost since 1280 s"
    assert fault.with_begin(0.5) == "drive-lost since 320.0 s"
    assert fault.with_signal == "drive-lost of pwm"
    assert fault.place == "wires and supply"
    unplaced = fault._replace(reason="it does nothing", signal="", since=None)
    assert unplaced.with_begin(0.5) == unplaced.with_signal == "drive-lost"
    assert unplaced.place == ANYWHERE
    assert plant_fault(verdict(TrustLevel.TRUSTED)) is None


def test_what_the_guard_reports_is_a_fault_beside_that_of_the_plant() -> None:
    held = fault_of_drive("too_hot: 121 °C")
    assert held == FaultStatement(
        "output held at zero: too hot",
        "",
        "output held at zero: too hot",
        "121 °C",
        TrustLevel.FAULT,
    )
    assert statements_of(LOST, "too_hot: 121 °C").faults == (plant_fault(LOST), held)
    limited = fault_of_drive("limited: hotter")
    assert limited is not None
    assert limited.called == "output limited"
    assert fault_of_drive("") is None


def test_no_display_has_words_of_its_own_for_trust_and_faults() -> None:
    """The fields of a verdict that are said are read by the statements alone."""
    said_fields = re.compile(r"\.(level_reason|fault_since|named_fault)\b")
    package = Path(twinmatch.__file__).parent
    displays = [
        path
        for room in ("showing", "launching", "cli")
        for path in (package / room).rglob("*.py")
    ]
    assert len(displays) > 50
    assert [
        path.name for path in displays if said_fields.search(path.read_text("utf-8"))
    ] == []
