"""What a session teaches: parameters with covariances that say how far they are off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.support.places import RECORDINGS
from tests.support.rig import GAINS, rig, run
from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.fitting import Noise
from twinmatch.importing import open_any
from twinmatch.memory import (
    Lesson,
    SessionEvidence,
    current_lessons,
    digest_of,
    lessons_of,
    report_on,
)
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of
from twinmatch.signals import Window

RICH = "sink with mass, free ambient, switched drive"
TRUE = {
    "seebeck": 0.055,
    "conductance": 0.75,
    "heat_capacity": 30.0,
    "ambient": 294.0,
    "sink_heat_capacity": 350.0,
    "sink_convection": 3.0,
}


def hour(seed: int, structure: str = RICH, **changed: float) -> Window:
    """An hour of a simulated rig on twelve levels."""
    levels = np.random.default_rng(seed).choice(np.arange(30.0, 81.0, 5.0), 12)
    return run(rig(structure, **(TRUE | changed)), np.repeat(levels, 300), seed=seed)


def judged(
    window: Window,
    *verdicts: Verdict,
    name: str = "hour",
    stretches: tuple[Window, ...] = (),
) -> SessionEvidence:
    """It as a session with these verdicts."""
    samples = samples_of(window)
    return SessionEvidence(
        digest_of(samples), name, "", Peltier, samples[0].stamp, stretches or (window,), verdicts, (10.0,),
        Noise.of(Peltier), GAINS,
    )  # fmt: skip


def verdict(
    sample: int, fault: str = "", since: int | None = None, **changed: object
) -> Verdict:
    """A verdict of which only a few fields matter."""
    bare = Verdict.__new__(Verdict)
    usual = {
        "sample": sample,
        "level": TrustLevel.TRUSTED,
        "structure": RICH,
        "leader": None,
        "forecasts": (),
    }
    for name, value in (
        usual | {"fault": fault, "fault_since": since} | changed
    ).items():
        object.__setattr__(bare, name, value)
    return bare


@cache
def of_day(day: int, **changed: float) -> Lesson:
    """What an hour of this day teaches, in a room of its own."""
    hours = hour(20 + day, ambient=292.0 + day % 3, **changed)
    return of_structure(lessons_of(judged(hours, name=f"day {day}")))


def of_structure(lessons: Sequence[Lesson], name: str = RICH) -> Lesson:
    return next(lesson for lesson in lessons if lesson.structure == name)


@cache
def of_hour(seed: int) -> tuple[Lesson, ...]:
    """What an hour of the simulated rig teaches, without verdicts."""
    return tuple(lessons_of(judged(hour(seed))))


def test_covariances_say_how_far_the_parameters_are_off():
    errors = []
    for seed in range(16):
        learned = of_structure(of_hour(seed))
        error = learned.values - np.array([TRUE[name] for name in learned.free])
        errors.append(
            error @ np.linalg.solve(np.array(learned.covariance), error) / error.size
        )
    # χ² / n has the mean 1 over 16 · 6 numbers, ± 0.15; a covariance from 24 blocks is less exact.
    assert 0.5 <= np.mean(errors) <= 2.0


def test_an_hour_determines_the_conductance_to_a_hundredth():
    learned = of_structure(of_hour(1))
    assert learned.deviations[learned.free.index("conductance")] < 0.01
    assert learned.parameters["conductance"] == pytest.approx(0.75, abs=0.02)
    assert learned.samples == 3600
    assert learned.outputs[0] == pytest.approx((22.0, 82.0), abs=5.0)
    assert learned.equations == Peltier.model(RICH).equations
    assert current_lessons(
        [learned, replace(learned, equations="others")], Peltier
    ) == [learned]


def test_the_structures_worth_keeping_are_kept():
    window = hour(2)
    names = {lesson.structure for lesson in of_hour(2)}
    assert {RICH, "sink with mass, free ambient"} >= names - {
        "held sink",
        "sink with mass",
    }
    chosen = verdict(1800, structure="sink with mass, switched drive")
    learned = of_structure(
        lessons_of(judged(window, chosen)), "sink with mass, switched drive"
    )
    assert learned.chosen
    assert not learned.led
    assert learned.level == "trusted"


def test_nothing_is_learned_from_a_fault_on():
    window = hour(3)
    spoilt = replace(
        window, outputs=np.where(np.arange(3600) < 2000, window.output, 20.0)
    )
    faulty = judged(
        spoilt, verdict(1900), verdict(2100, "drive-lost", 2000), verdict(3000)
    )
    learned, healthy = (
        of_structure(lessons_of(judgement))
        for judgement in (faulty, judged(window.part(0, 1999), verdict(1900)))
    )
    assert learned.fault_at == 2000
    assert replace(learned, session="", fault_at=None) == replace(healthy, session="")
    assert lessons_of(judged(window, verdict(200, "sensor-frozen", 150))) == []


def test_lost_samples_count_nowhere():
    window = hour(4)
    is_seen = np.ones(3600, dtype=bool)
    is_seen[1000:1010] = is_seen[2500:2504] = False
    outputs = np.where(is_seen, window.output, 500.0)
    with_gaps = replace(window, outputs=outputs, seen=is_seen)
    learned = of_structure(lessons_of(judged(with_gaps)))
    whole = of_structure(of_hour(4))
    assert learned.samples == 3586
    assert learned.outputs[0][1] < 100.0
    assert np.all(np.abs(learned.values - whole.values) < whole.deviations)


def test_stretches_teach_together():
    window = hour(5)
    parts = window.part(0, 1499), window.part(1600, 1700), window.part(1750, 3599)
    learned = of_structure(lessons_of(judged(window, stretches=parts)))
    assert learned.samples == 1500 + 1850  # the short one is not used
    assert learned.parameters["conductance"] == pytest.approx(0.75, abs=0.03)


def test_a_session_at_rest_does_not_pretend_to_know():
    """Parameters that end on a bound make no lesson."""
    still = run(rig(RICH, **TRUE), np.full(900, 50.0), start=50.0, seed=6)
    for learned in lessons_of(judged(still)):
        declared = Peltier.model(learned.structure).declared
        for name, value in zip(learned.free, learned.values, strict=True):
            low, high = declared[name].bounds
            assert low < value < high


def test_a_session_is_known_by_its_samples():
    samples = samples_of(hour(7))
    later = [replace(sample, stamp=sample.stamp + 5) for sample in samples]
    assert digest_of(later) == digest_of(samples)
    assert digest_of(samples[:-1]) != digest_of(samples)
    assert digest_of([*samples[:-1], replace(samples[-1], inputs=(1.0,))]) != digest_of(
        samples
    )


@pytest.mark.parametrize(
    ("name", "factor", "named"),
    [
        ("conductance", 1.1, "conductance"),
        (
            "heat_capacity",
            1 / 1.1,
            "seebeck / heat_capacity",
        ),  # an hour knows each to 4 %, their ratio to 0.5 %
        ("sink_convection", 0.8, "sink_convection"),
    ],
)
def test_a_step_of_a_simulated_rig_is_named(name, factor, named):
    before = [of_day(day) for day in range(4)]
    lessons = before + [
        of_day(day, **{name: factor * TRUE[name]}) for day in range(4, 7)
    ]
    (change,) = report_on(lessons, Peltier.model(RICH)).changes
    assert (change.name, change.kind, change.since) == (named, "step", "day 4")
    assert abs(change.size) == pytest.approx(0.2 if factor == 0.8 else 0.1, abs=0.04)


@pytest.mark.skipif(
    not RECORDINGS.is_dir(), reason="needs the recordings of TWINMATCH_RECORDINGS"
)
def test_the_change_of_the_real_rig_is_named_between_recordings_9_and_14():
    lessons = []
    for number in (1, 2, 5, 9, 14, 20, 27):
        window = open_any(RECORDINGS / f"BMData{number}_022722.mat").window()
        verdicts = [verdict(2300, "drive-lost", 2229)] if number == 27 else []
        learned = lessons_of(judged(window, *verdicts, name=str(number)))
        lessons.append(of_structure(learned))
        conductance = lessons[-1].free.index("conductance")
        assert 0.002 < lessons[-1].deviations[conductance] < 0.04
    before = [lesson.parameters["conductance"] for lesson in lessons[:4]]
    after = [lesson.parameters["conductance"] for lesson in lessons[4:]]
    assert max(before) < 0.78
    assert min(after) > 0.80
    model = Peltier.model(RICH)
    assert [report_on(lessons[:count], model).changes for count in (4, 5)] == [[], []]
    for count in (6, 7):
        (change,) = report_on(lessons[:count], model).changes
        named = change.name, change.kind, change.after, change.since
        assert named == ("conductance", "step", "9", "14")
        apart = np.mean(after[: count - 4]) / np.mean(before) - 1.0
        assert change.size == pytest.approx(apart, abs=0.03)
    assert report_on(lessons, model).restless == ["temperature of the room"]
