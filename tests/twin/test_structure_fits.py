"""Structures fitted again and again beside a plant: which samples count, and what is found of known rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.rich_rig import RIG, apart, recorded
from tests.support.rig import GAINS
from twinmatch.dynamics import Model, Parameters, begin, simulate_closed_loop
from twinmatch.fitting import Noise
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import Schedule, StructureFits, watched
from twinmatch.twin.structure_fits import NewestSamples
from twinmatch.twin.structures import StructureChoice

PLAIN = Peltier.model().parameters(seebeck=0.065, conductance=0.65, heat_capacity=31.0)
TWO = tuple(map(Peltier.model, ("held sink", "held sink, free ambient")))
NEVER = (1e6, 1e6, 1200.0)
RICHEST = "sink with mass, free ambient, switched drive"


def candidates_only(models: tuple[Model, ...] = watched(Peltier)) -> StructureFits:
    return StructureFits(
        models, Noise.of(Peltier), GAINS, matched=models[0], choice=NEVER
    )


def choices_only() -> StructureFits:
    """Chooses between two structures, every 300 samples; neither competes."""
    return StructureFits(
        TWO, Noise.of(Peltier), GAINS, matched=TWO[1], choice=(300.0, 300.0, 300.0)
    )


def chosen(fits: StructureFits, window: Window) -> StructureChoice | None:
    """The choice made on a window, if one was."""
    before = fits.choice
    fits.push(window, excited=False)
    return fits.choice if fits.choice is not before else None


def plant_after(fits: StructureFits, window: Window) -> Parameters:
    fits.push(window, excited=False)
    parameters = fits.plant_now()
    assert parameters is not None
    return parameters


def rich(fits: StructureFits) -> Parameters:
    """The fit of the structure that was recorded."""
    return next(
        c.parameters for c in fits.candidates if c.parameters.model is RIG.model
    )


@pytest.fixture(scope="module")
def hour() -> Window:
    reference = np.repeat([50.0, 30.0, 75.0, 45.0, 60.0], 200)
    sensor = Peltier.sensor.realise(reference.size, 1.0, 8)
    run = simulate_closed_loop(
        PLAIN, reference, states=begin(PLAIN, 21.85), sensor=sensor
    )
    return Window(reference, run.output, run.input)


# --- choice of the structure ---


def test_the_plant_file_says_what_is_watched() -> None:
    without_external = [
        model for model in watched(Peltier) if model.structure.external is None
    ]
    assert [model.structure_name for model in without_external] == [
        "held sink",
        "sink with mass",
        "sink with mass, free ambient",
        RICHEST,
    ]


def test_it_chooses_every_so_many_samples_and_a_replay_chooses_the_same(
    hour: Window,
) -> None:
    figures = []
    for _ in range(2):
        fits = choices_only()
        choices = [chosen(fits, hour.part(k, k + 99)) for k in range(0, 1000, 100)]
        assert [c.samples for c in choices if c] == [(0, 299), (300, 599), (600, 899)]
        choice = fits.choice
        assert choice is choices[8]
        assert choice is not None
        assert choice.chosen == "held sink"
        np.testing.assert_array_equal(
            choice.score.evidence,
            np.concatenate([c.score.held_back for c in choices if c]),
        )
        figures.append((choice.parameters, choice.score.evidence.tolist()))
    assert figures[0] == figures[1]


def test_times_are_scaled_for_slow_samples(hour: Window) -> None:
    """At 5 s, 1500 s are 300 samples; the forecasts' horizons are counted in the same way."""
    times = (1500.0, 1500.0, 1500.0)
    fits = StructureFits(
        TWO, Noise.of(Peltier), None, 5.0, matched=TWO[1], choice=times
    )
    choices = [chosen(fits, hour.part(k, k + 99)) for k in range(0, 700, 100)]
    assert [c.samples for c in choices if c] == [(0, 299), (300, 599)]


def test_overlapping_windows_of_a_schedule_are_one_record(hour: Window) -> None:
    schedule = Schedule()
    fits = choices_only()
    triggers = [t for t in map(schedule.push, samples_of(hour)) if t]
    assert any(t.excited for t in triggers)
    choices_or_none = [chosen(fits, trigger.window) for trigger in triggers]
    choices = [choice for choice in choices_or_none if choice]
    assert len(choices) == 3
    for choice in choices:
        first, last = choice.samples
        assert last - first == 299
        measured = choice.score.fitted.measured[0]
        np.testing.assert_array_equal(measured[1], hour.input[first + 62 : last + 1])


def test_stand_ins_are_not_fitted_wherever_windows_were_joined(hour: Window) -> None:
    """The values in the place of lost samples may be anything: the candidates stay the same, bit for bit."""
    lost = {150, 330, 331, 470}
    candidates = []
    for wrong in (0.0, 25.0):
        fits = candidates_only()
        samples = [
            replace(s, outputs=s.output + wrong, seen=False) if s.index in lost else s
            for s in samples_of(hour.part(0, 599))
        ]
        joined = NewestSamples(len(samples))
        for first in (0, 200, 400):
            window = Window.from_samples(samples[max(first - 50, 0) : first + 200])
            fits.push(window, excited=True)
            joined.push(window)
        assert joined.window is not None
        assert joined.window.lost == sorted(lost)
        candidates.append([(c.name, c.parameters) for c in fits.candidates])
    assert candidates[0]
    assert candidates[0] == candidates[1]


def test_a_gap_or_a_clock_set_back_starts_over(hour: Window) -> None:
    fits = choices_only()
    assert chosen(fits, hour.part(0, 299)) is not None
    assert chosen(fits, hour.part(350, 640)) is None
    assert chosen(fits, hour.part(641, 660)) is not None
    assert chosen(fits, hour.part(0, 250)) is None
    assert chosen(fits, hour.part(251, 310)) is not None


# --- the plant as it is now ---


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_plant_now_is_the_richest_structure_and_near_the_one_that_was_recorded(
    seed: int,
) -> None:
    """Nearer by far than a rig whose plate holds a third more heat."""
    plant_now = plant_after(candidates_only(), recorded(RIG, seed))
    assert plant_now.model.structure_name == RICHEST
    assert apart(plant_now, RIG) < 0.5 * apart(RIG.replace(heat_capacity=40.0), RIG)


def test_the_plant_now_follows_a_plant_that_changes() -> None:
    """From one window to the next the plate has got heavier; each time the newest samples count."""
    fits = candidates_only()
    heavy = RIG.replace(heat_capacity=40.0)
    first = plant_after(fits, recorded(RIG, 4))
    second = plant_after(fits, recorded(heavy, 5, first=5000))
    assert apart(first, RIG) < apart(first, heavy)
    assert apart(second, heavy) < apart(second, RIG)


def test_after_a_fault_the_plant_now_starts_over() -> None:
    fits = candidates_only()
    window = recorded(RIG, 6)
    first = plant_after(fits, window)
    assert fits.plant_now() is not None
    fits.expel(window.last + 1, window.last + 2)
    assert fits.plant_now() == first


# --- candidates ---


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_candidate_is_near_the_plant_that_was_recorded(seed: int) -> None:
    fits = candidates_only()
    heavier_plate = RIG.replace(heat_capacity=40.0)
    fits.push(recorded(RIG, seed), excited=True)
    assert apart(rich(fits), RIG) < 0.5 * apart(heavier_plate, RIG)


def test_all_but_the_matched_compete_and_a_fit_says_where_its_states_were() -> None:
    fits = candidates_only()
    window = recorded(RIG, 2)
    fits.push(window, excited=True)
    assert {c.parameters.model for c in fits.candidates} == set(watched(Peltier)[1:])
    best = fits.candidates[0]
    charges = list(map(fits.charge_of, fits.candidates))
    assert charges == sorted(charges), "the fit that is worth most goes first"
    states = best.states_at(window.last)
    assert states is not None
    # five times the noise
    assert states[0] - 273.15 == pytest.approx(window.output[-1], abs=0.5)
    assert best.states_at(window.last + 1) is None
    assert best.states_at(-1) is None


def test_a_structure_that_is_watched_later_competes_at_once() -> None:
    """It is fitted to the samples that are kept, and the others are left as they are."""
    fits = candidates_only(watched(Peltier)[:2])
    window = recorded(RIG, 2)
    fits.push(window, excited=True)
    before = fits.candidates
    fits.watch([RIG.model])
    fits.watch([RIG.model, *watched(Peltier)[:2]])
    assert {c.name for c in fits.candidates} == {before[0].name, RICHEST}
    assert before[0] in fits.candidates
    late = rich(fits)
    early = candidates_only()
    early.push(window, excited=True)
    assert late == rich(early)
    plant_now = fits.plant_now()
    assert plant_now is not None
    assert plant_now.model is RIG.model


def test_too_few_samples_and_quiet_ones_tell_nothing() -> None:
    few = candidates_only()
    quiet = candidates_only()
    window = recorded(RIG, 1)
    assert few.plant_now() is None
    few.push(window.part(0, 40), excited=True)
    assert not few.candidates
    assert few.plant_now() is None
    quiet.push(window, excited=False)
    assert not quiet.candidates, "the first fit waits for a step"


def test_a_quiet_plant_is_fitted_again_when_the_fit_is_old() -> None:
    fits = candidates_only()
    window = recorded(RIG, 1)
    lasts = []
    for first, last, excited in ((0, 300, True), (301, 600, False), (601, 950, False)):
        fits.push(window.part(first, last), excited=excited)
        lasts.append(fits.candidates[0].samples[1])
    assert lasts == [300, 300, 950]


def test_a_plant_that_has_changed_is_fitted_to_later_samples() -> None:
    fits = candidates_only()
    heavy = RIG.replace(heat_capacity=45.0)
    fits.push(recorded(RIG, 6), excited=True)
    fits.cut(1000)
    fits.push(recorded(heavy, 7, first=1000), excited=True)
    assert fits.candidates[0].samples[0] == 1000
    assert apart(rich(fits), heavy) < apart(rich(fits), RIG)


def test_who_was_fitted_to_a_fault_has_to_go() -> None:
    fits = candidates_only()
    window = recorded(RIG, 6)
    fits.push(window.part(0, 500), excited=True)
    assert not fits.expel(600, 700)
    gone = fits.expel(450, 520)
    assert set(gone) == {model.structure_name for model in watched(Peltier)[1:]}
    assert not fits.candidates
