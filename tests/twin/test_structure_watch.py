"""The watch beside a running plant: which samples it keeps, and when it looks."""

from __future__ import annotations

import numpy as np
import pytest

from twinmatch.dynamics import begin, simulate_closed_loop
from twinmatch.errors import TwinmatchError
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import Schedule
from twinmatch.twin.structure_watch import StructureSettings, StructureWatch, watched

PLAIN = Peltier.model().parameters(seebeck=0.065, conductance=0.65, heat_capacity=31.0)
TWO = tuple(map(Peltier.model, ("held sink", "held sink, free ambient")))
SETTINGS = StructureSettings(TWO, least=300, every=300, longest=300)


@pytest.fixture(scope="module")
def hour() -> Window:
    reference = np.repeat([50.0, 30.0, 75.0, 45.0, 60.0], 200)
    sensor = Peltier.sensor.realise(reference.size, 1.0, 8)
    run = simulate_closed_loop(PLAIN, reference, states=begin(PLAIN, 21.85), sensor=sensor)
    return Window(reference, run.output, run.input)


def test_the_plant_file_says_what_is_watched() -> None:
    own = [model for model in watched(Peltier) if model.structure.elsewhere is None]
    assert [model.structure_name for model in own] == [
        "held sink",
        "sink with mass",
        "sink with mass, free ambient",
        "sink with mass, free ambient, switched drive",
    ]


def test_it_looks_every_so_many_samples(hour: Window) -> None:
    watch = StructureWatch(SETTINGS)
    looks = [watch.push(hour.part(k, k + 99)) for k in range(0, 1000, 100)]
    assert [c.samples for c in looks if c] == [(0, 299), (300, 599), (600, 899)]
    assert watch.choice is looks[8]
    assert watch.choice.chosen == "held sink"
    score = watch.choice.score
    assert score.evidence.bic == pytest.approx(sum(c.score.total.bic for c in looks if c))


def test_overlapping_windows_of_a_schedule_are_one_record(hour: Window) -> None:
    schedule, watch = Schedule(), StructureWatch(SETTINGS)
    triggers = [t for t in map(schedule.push, samples_of(hour)) if t]
    assert any(t.excited for t in triggers)
    choices = [c for c in (watch.push(t.window) for t in triggers) if c]
    assert len(choices) == 3
    for choice in choices:
        first, last = choice.samples
        assert last - first == 299
        measured = choice.score.fitted.measured[0]
        np.testing.assert_array_equal(measured[1], hour.input[first + 62 : last + 1])


def test_a_replay_chooses_the_same(hour: Window) -> None:
    figures = []
    for _ in range(2):
        watch = StructureWatch(SETTINGS)
        for k in range(0, 1000, 100):
            watch.push(hour.part(k, k + 99))
        assert watch.choice is not None
        figures.append((watch.choice.parameters, watch.choice.score.evidence))
    assert figures[0] == figures[1]


def test_a_gap_or_a_clock_set_back_starts_over(hour: Window) -> None:
    watch = StructureWatch(SETTINGS)
    assert watch.push(hour.part(0, 299)) is not None
    assert watch.push(hour.part(350, 640)) is None
    assert watch.push(hour.part(641, 660)) is not None
    assert watch.push(hour.part(0, 250)) is None
    assert watch.push(hour.part(251, 310)) is not None


def test_counts_that_do_not_go_together_are_refused() -> None:
    with pytest.raises(TwinmatchError, match="least 400, longest 300"):
        StructureSettings(TWO, least=400, longest=300)
    with pytest.raises(TwinmatchError, match="every >= 1 and a structure"):
        StructureSettings(())
