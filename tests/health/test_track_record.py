"""Who has not predicted a plant accuses nobody, and evidence counts for what forecasts were worth."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support import faulty_incubator as incubators
from tests.support import faulty_rig as rig
from tests.support.abroad import KINDS, AbroadPlant
from tests.support.recorded_kits import kit_rows
from twinmatch.dynamics.filters import Readings
from twinmatch.dynamics.tracker import Tracker
from twinmatch.health import Alarm, Fault, HealthSettings, Monitor, Refusals
from twinmatch.health.changes import ChangeDetector, code_length_of
from twinmatch.health.earned import Record
from twinmatch.health.track_record import TrackRecord
from twinmatch.plants import Incubator, Peltier, TCLab
from twinmatch.signals import Sample

NOISE = 0.1


def alarms(samples: list[Sample], settings: HealthSettings) -> tuple[Alarm, ...]:
    monitor = Monitor(settings)
    refusals = Refusals(settings, 5)
    for sample in samples:
        monitor.push(refusals.settle(sample))
    return monitor.alarms


def calibrated(samples: list[Sample]) -> TrackRecord:
    detector = ChangeDetector(HealthSettings().followed, 1.0)
    for sample in samples:
        detector.push(sample)
    return detector.track_record


def late(samples: list[Sample], seconds: int) -> list[Sample]:
    """The same plant, its input recorded so much too early."""
    inputs = [s.input for s in samples[seconds:]]
    return [
        Sample(s.index, s.stamp, s.reference, s.output, u)
        for s, u in zip(samples, inputs, strict=False)
    ]


@cache
def record_of_a_rig_that_acts_late(seconds: int) -> TrackRecord:
    """After forty minutes."""
    samples, _ = rig.run(rig.profile(3, 2400), rig=rig.some_rig(3), seed=3)
    return calibrated(late(samples, seconds))


def test_a_plant_that_its_equations_describe_is_predicted_as_expected() -> None:
    record = record_of_a_rig_that_acts_late(0)
    assert record.earned
    # 130 forecasts that overlap: some 30 independent ones
    assert record.dispersion < 1.3


def test_evidence_on_a_plant_that_acts_late_is_worth_less() -> None:
    records = [record_of_a_rig_that_acts_late(seconds) for seconds in (0, 6, 12, 20)]
    dispersions = [record.dispersion for record in records]
    # What a later input explains is learned after four minutes: so they need not grow with the delay.
    assert min(dispersions[1:]) > 1.1 * dispersions[0]
    assert max(dispersions) > 1.5 * dispersions[0]
    assert [record.earned for record in records] == [True, True, True, False]


def test_a_plant_at_rest_proves_nothing() -> None:
    samples, _ = rig.run(np.full(1800, 23.0), rig=rig.some_rig(3), seed=3)
    assert not calibrated(samples[600:]).earned


squares = st.floats(0.0, 10.0)


@given(
    st.lists(st.tuples(squares, squares), min_size=1, max_size=20), st.floats(0.1, 10.0)
)
def test_what_is_earned_depends_on_no_unit(
    forecasts: list[tuple[float, float]], unit: float
) -> None:
    plain = scaled = Record()
    for error, moved in forecasts:
        plain = plain.after(error, moved)
        scaled = scaled.after(unit * error, unit * moved)
    limit = 0.25 * plain.moved - plain.error
    if abs(limit) > 1e-9 and abs(plain.moved - (20.0 * NOISE) ** 2) > 1e-9:
        assert plain.earned(NOISE) == scaled.earned(unit * NOISE)
    assert plain.earned(NOISE) or not plain.sees_drive(NOISE)


def test_errors_as_large_as_the_movements_earn_nothing() -> None:
    record = Record()
    for _ in range(100):
        record = record.after(3.0, 3.0)
    assert not record.earned(NOISE)
    for _ in range(100):
        record = record.after(0.1, 3.0, factor=0.9)
    assert record.earned(NOISE)


def test_lengths_of_whole_numbers_are_those_of_a_code() -> None:
    """Rissanen (1983): log* 1 is log₂ 2.865064 = 1.5186 bits, and Kraft's inequality holds."""
    assert code_length_of(1) / math.log(2.0) == pytest.approx(1.5186, abs=1e-4)
    assert code_length_of(1000) / math.log(2.0) == pytest.approx(
        1.5186 + 9.9658 + 3.3170 + 1.7299 + 0.7907, abs=1e-3
    )
    total = sum(math.exp(-code_length_of(n)) for n in range(1, 100_000))
    assert 0.8 < total < 1.0  # the series converges slowly


@pytest.mark.parametrize(
    ("name", "seed", "size"),
    [
        ("motor", 0, 3600),
        ("motor", 1, 3600),
        ("tanks", 1, 400),
        ("tanks", 8, 400),
        ("kit", 8, 1200),
    ],
)
def test_a_plant_with_more_than_its_file_has_is_not_accused(
    name: str, seed: int, size: int
) -> None:
    """Coarse displays, loads, dead bands, lags: each of these was called broken before."""
    kind = KINDS[name]
    samples = list(AbroadPlant(kind, seed).run(size))
    assert alarms(samples, HealthSettings.of(kind.plant, kind.period)) == ()


@pytest.mark.parametrize("name", ["closed_loop_lqg", "prbs_open_loop"])
def test_a_kit_whose_second_heater_no_equation_has_is_not_accused(name: str) -> None:
    rows = kit_rows("tclab_2x2", name)[:1200]
    samples = [
        Sample(k, k * 1_000_000_000, r["T1"], r["T1"], r["Q1"], (r["Q2"],))
        for k, r in enumerate(rows)
    ]
    assert alarms(samples, HealthSettings.of(TCLab, 1.0)) == ()


def test_a_box_with_a_seventh_of_the_heat_is_not_accused() -> None:
    """As in other boxes of the kind, whose heat bed has 18.7 W and whose file says 127 W."""
    plant = incubators.some_incubator(5).replace(power=18.7)
    samples = incubators.run(plant, 5, 800)
    assert alarms(samples, HealthSettings.of(Incubator, incubators.PERIOD)) == ()


def test_as_long_as_nobody_has_predicted_the_plant_the_monitor_says_so() -> None:
    samples, _ = rig.run(rig.profile(3, 300), rig=rig.some_rig(3), seed=3)
    monitor = Monitor()
    assert monitor.reservation == "the twin does not describe this plant yet"
    for sample in samples:
        monitor.push(sample)
    assert monitor.reservation == ""


@pytest.mark.parametrize(
    ("kind", "latest"), [("drive-lost", 20), ("supply*0.5", 20), ("supply*0.62", 20)]
)
def test_a_fault_of_the_drive_is_over_when_it_is_over(kind: str, latest: int) -> None:
    """No sooner: at six tenths of its supply the drive still follows; no later: at rest it shows little."""
    reference = np.concatenate([np.full(200, 40.0), np.full(700, 60.0)])
    for seed in (4, 5):
        monitor, _ = rig.watch(
            rig.run(reference, rig.Break(kind, 400, 200), seed=seed)[0][:760]
        )
        ends = [
            a.last
            for a in monitor.alarms
            if a.fault in {Fault.DRIVE_LOST, Fault.DRIVE_WEAK}
        ]
        assert ends
        assert ends[-1] is not None
        assert 598 <= ends[-1] <= 600 + latest


def test_equations_that_leave_their_range_end_nothing() -> None:
    """The belief starts again from the reading."""
    tracker = Tracker(Peltier.model().typical(), 1.0, (1.0,))
    belief = tracker.begin(60.0, 0.0, np.zeros(0), 0)
    belief.values[0] = 1e200
    readings = Readings(
        np.full(12, 60.0), np.full(10, 100.0), np.zeros((10, 0)), np.full(10, 0.1)
    )
    after, cost = tracker.run(belief, readings, 0)
    assert np.isfinite(after.values).all()
    assert np.isfinite(after.covariance).all()
    assert math.isfinite(cost)


def test_what_another_twin_expected_is_forgotten_with_it() -> None:
    """A motor's first twin expects forty times what a better one does: its sums would be a lost drive."""
    kind = KINDS["motor"]
    plant = AbroadPlant(kind, 704)
    better = kind.plant.model("with friction").parameters(
        k=0.0384, j=3.1e-4, b=9e-5, dry=0.0116
    )
    monitor = Monitor(HealthSettings.of(kind.plant, kind.period))
    for sample in plant.run(2300):
        monitor.push(sample, better if sample.index > 1750 else None)
    assert monitor.alarms == ()
