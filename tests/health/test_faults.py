"""The rows of the kinds of faults."""

from __future__ import annotations

import pytest

from twinmatch.health import Fault
from twinmatch.health.faults import PRECEDENCE, SLOW, TRAITS
from twinmatch.safety.accusations import ACCUSED


def test_every_fault_has_a_row() -> None:
    assert list(TRAITS) == list(Fault)


@pytest.mark.parametrize("fault", Fault)
def test_a_sentence_has_all_that_it_names(fault: Fault) -> None:
    traits = TRAITS[fault]
    words = {
        "name": "T1",
        "size": "3 °C",
        "surroundings": "the room",
        "rivals": "losses",
    }
    assert "{" not in traits.suspect.format(**words) + traits.sentence.format(**words)


def test_what_a_guard_acts_on_are_sudden_faults_and_readings_that_shift() -> None:
    """A guard knows names alone, those of messages."""
    names = {fault.value for fault in Fault}
    accusations = set().union(*ACCUSED.values())
    assert accusations <= names
    for fault in Fault:
        if fault.value in accusations:
            assert TRAITS[fault].blinds or fault is Fault.SENSOR_DRIFT


def test_what_does_not_blind_is_replaced_by_what_does() -> None:
    for fault, traits in TRAITS.items():
        assert traits.blinds or Fault.DRIVE_LOST in PRECEDENCE[fault], fault


def test_a_fault_is_never_replaced_by_itself_and_a_sudden_one_by_none_but_graver_ones() -> (
    None
):
    for fault, graver in PRECEDENCE.items():
        assert fault not in graver
        assert (
            TRAITS[fault].slow
            or TRAITS[fault].unnamed
            or graver < {f for f in Fault if f not in SLOW}
        )
