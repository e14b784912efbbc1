"""The plant as it is now, found again from samples of rigs that are known."""

from __future__ import annotations

import numpy as np
import pytest

from twinmatch.discrimination import Held, plant_gap, spans_of
from twinmatch.dynamics import Parameters, begin, gains_of, simulate_closed_loop
from twinmatch.matching import Noise
from twinmatch.plants import Peltier
from twinmatch.signals import Window
from twinmatch.twin import watched
from twinmatch.twin.present import Present

GAINS = gains_of(Peltier, 1.0)
TERMS = Held(GAINS, spans_of(Peltier))
POINTS = (30.0, 50.0, 70.0)
RIG = Peltier.model("sink with mass, free ambient, switched drive").parameters(
    seebeck=0.06,
    conductance=0.7,
    heat_capacity=30.0,
    ambient=296.0,
    sink_heat_capacity=350.0,
    sink_convection=4.0,
)


def present() -> Present:
    return Present(watched(Peltier), Noise.of(Peltier), GAINS)


def recorded(rig: Parameters, seed: int) -> Window:
    reference = np.repeat([30.0, 50.0, 70.0, 40.0, 60.0], 200)
    sensor = Peltier.sensor.realise(reference.size, 1.0, seed)
    run = simulate_closed_loop(rig, reference, states=begin(rig, 25.0), sensor=sensor, gains=GAINS)
    return Window(reference, run.output, run.input)


def test_it_is_the_richest_structure_that_is_watched() -> None:
    found = present().look(recorded(RIG, 1))
    assert found is not None
    assert found.model.structure_name == "sink with mass, free ambient, switched drive"


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_plant_is_near_the_one_that_was_recorded(seed: int) -> None:
    """Nearer by far than a rig whose plate holds a third more heat."""
    found = present().look(recorded(RIG, seed))
    assert found is not None
    other = RIG.replace(heat_capacity=40.0)
    assert plant_gap(found, RIG, POINTS, TERMS) < 0.5 * plant_gap(other, RIG, POINTS, TERMS)


def test_it_follows_a_plant_that_changes() -> None:
    """From one window to the next the plate has got heavier; each time the newest samples count."""
    now, heavy = present(), RIG.replace(heat_capacity=40.0)
    first = now.look(recorded(RIG, 4))
    second = now.look(recorded(heavy, 5))
    assert first is not None
    assert second is not None
    assert plant_gap(first, RIG, POINTS, TERMS) < plant_gap(first, heavy, POINTS, TERMS)
    assert plant_gap(second, heavy, POINTS, TERMS) < plant_gap(second, RIG, POINTS, TERMS)


def test_too_few_samples_tell_nothing() -> None:
    now = present()
    assert now.look(None) is None
    assert now.look(recorded(RIG, 1).part(0, 40)) is None


def test_after_a_fault_it_begins_anew() -> None:
    now, window = present(), recorded(RIG, 6)
    first = now.look(window)
    again = now.look(window)
    now.forget()
    assert now.look(window) == first
    assert again is not None
