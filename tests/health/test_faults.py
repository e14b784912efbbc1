"""The rows of the kinds of faults."""

from __future__ import annotations

from dataclasses import replace

import pytest

from twinmatch.health import Fault
from twinmatch.health.faults import PRECEDENCE, SLOW, TRAITS, Alarm
from twinmatch.health.sentences import FaultSentences
from twinmatch.plants import Peltier
from twinmatch.safety.accusations import ACCUSED


def test_every_fault_has_a_row() -> None:
    assert list(TRAITS) == list(Fault)


@pytest.mark.parametrize("fault", Fault)
def test_a_sentence_has_all_that_it_names(fault: Fault) -> None:
    traits = TRAITS[fault]
    words = {
        "name": "T1",
        "size": "3 °C",
        "sensor": "the camera",
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


CHANGED = Alarm(Fault.LOSSES_CHANGED, 100, 120, None, "the lid is open", spoils=False)


def test_as_long_as_a_plant_is_another_forecasts_made_since_count() -> None:
    assert CHANGED.excuses_between(90, 100)
    assert CHANGED.excuses_between(99, 400)
    assert not CHANGED.excuses_between(100, 130)
    assert not CHANGED.excuses_between(50, 99)


def test_once_it_is_itself_again_none_of_the_meantime_counts() -> None:
    over = replace(CHANGED, last=200)
    assert over.excuses_between(100, 130)
    assert over.excuses_between(190, 250)
    assert not over.excuses_between(201, 250)


@pytest.mark.parametrize("fault", Fault)
def test_who_is_not_known_to_be_another_is_not_excused(fault: Fault) -> None:
    """A twin that does not fit shows an unnamed drift, and what was taken back was none."""
    spoils = fault not in SLOW
    alarm = Alarm(fault, 100, 120, 200, "", spoils)
    is_excused = alarm.excuses_between(100, 130)
    assert is_excused == (fault is not Fault.DRIFT)
    withdrawn = replace(alarm, withdrawn="such steps have recurred")
    assert not withdrawn.excuses_between(100, 130)


@pytest.mark.parametrize(
    ("fault", "parameter", "words"),
    [
        (Fault.DRIVE_LOST, "", {"name": "the drive"}),
        (Fault.DRIVE_WEAK, "", {"name": "the drive", "size": "55%"}),
        (
            Fault.SENSOR_DRIFT,
            "",
            {"name": "the plate temperature", "size": "+3 °C", "sensor": "the camera"},
        ),
        (
            Fault.ROOM_CHANGED,
            "ambient",
            {"name": "temperature of the room", "size": "+3 K"},
        ),
    ],
)
def test_a_change_is_said_in_the_sentence_of_its_row(
    fault: Fault, parameter: str, words: dict[str, str]
) -> None:
    """On a plant with one loop as on one with several: a kind has one sentence."""
    plant = Peltier
    sentences = FaultSentences(plant.model(), 1.0)
    everything = {"size": "", "sensor": "", "surroundings": plant.surroundings} | words
    expected = TRAITS[fault].sentence.format(**everything)
    declared = plant.parameters.get(parameter)
    assert sentences.changed(fault, declared, shift=3.0, share=0.55) == expected
