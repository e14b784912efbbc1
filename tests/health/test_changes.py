"""What changed is reported by name, in the plant's words; and ambiguous changes are reported as such."""

from __future__ import annotations

from collections import Counter
from copy import deepcopy
from typing import Any, cast

import numpy as np
import pytest

from tests.support import faulty_rig as rig
from tests.support.plants import Motor
from tests.support.watched import copied
from twinmatch.dynamics import Controller, Parameter, PlantError, advance, begin, read
from twinmatch.health import Fault, HealthSettings, Lie, Monitor
from twinmatch.health.changes import ChangeDetector
from twinmatch.plants import Peltier
from twinmatch.signals import Sample


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("fan-failed", "losses-changed"),
        ("room+10", "room-changed"),
        ("room-10", "room-changed"),
        ("supply*0.8", "drive-weak"),
        ("supply~0.6", "drive-weak"),
        ("reading+3", "sensor-drift"),
    ],
)
def test_a_change_is_named_and_not_called_another(kind: str, name: str) -> None:
    """Two rigs of the thirty of docs/health.md."""
    assert [rig.names_told(kind, seed)[0] for seed in (1, 5)] == [name] * 2


def test_a_hand_on_the_plate_is_a_disturbance_and_no_fault_of_drive_or_losses() -> None:
    counts: Counter[Fault] = Counter()
    for seed in range(2):
        still = np.full(800, rig.profile(seed + 1000, 600)[400])
        reference = np.concatenate([rig.profile(seed + 1000, 400), still])
        for heat in ("heat+4", "heat-4"):
            samples, _ = rig.run(
                reference, rig.Break(heat, 620, 20), rig=rig.some_rig(seed), seed=seed
            )
            alarms = rig.watch(samples)[0].alarms
            counts.update(alarm.fault for alarm in alarms)
            assert all(
                alarm.last is not None and 540 <= alarm.first <= 640 for alarm in alarms
            )
    assert set(counts) == {Fault.DISTURBANCE}
    assert counts[Fault.DISTURBANCE] == 4


def test_the_sentence_says_what_has_changed_by_how_much_and_where_to_look() -> None:
    samples, _ = rig.run(
        rig.profile(1002, 1200), rig.Break("room+10", 700), rig=rig.some_rig(2), seed=2
    )
    (alarm,) = rig.watch(samples)[0].alarms
    assert alarm.fault is Fault.ROOM_CHANGED
    assert 680 <= alarm.first <= 720
    assert alarm.reason.startswith("the temperature of the room has changed by +")
    assert "look at fan, heat sink and room" in alarm.reason


def test_what_is_undone_is_over_and_what_stays_is_usual_after_ten_minutes() -> None:
    reference = rig.profile(1004, 1450)
    undone, _ = rig.run(
        reference, rig.Break("supply*0.7", 700, 300), rig=rig.some_rig(4), seed=4
    )
    alarms = rig.watch(undone)[0].alarms
    assert [a.fault for a in alarms] == [Fault.DRIVE_WEAK]
    assert alarms[0].last is not None
    assert 1000 <= alarms[0].last <= 1100
    stays, _ = rig.run(
        reference, rig.Break("room+10", 700), rig=rig.some_rig(4), seed=4
    )
    monitor, _ = rig.watch(stays)
    (alarm,) = monitor.alarms
    assert not monitor.doubt  # the readings cannot have shifted
    assert alarm.last is not None
    assert alarm.last - alarm.flagged == pytest.approx(600, abs=10)


def test_shifted_readings_never_become_usual_and_are_over_when_they_step_back() -> None:
    """The step back comes while the plate heats up, where it hides best; other changes became usual long
    before."""
    samples, _ = rig.run(
        rig.profile(1005, 1980),
        rig.Break("reading+3", 700, 1200),
        rig=rig.some_rig(5),
        seed=5,
    )
    monitor = Monitor()
    doubts = []
    for sample in samples:
        monitor.push(sample)
        doubts.append(monitor.doubt)
    (alarm,) = monitor.alarms
    assert alarm.fault is Fault.SENSOR_DRIFT
    assert alarm.last is not None
    assert 1900 <= alarm.last <= 1960
    lie = monitor.lie_between(1000, 1100)
    assert lie == Lie("temperature", alarm.first, alarm.last)
    assert monitor.lie_between(0, alarm.first - 1) is None
    assert monitor.lie_between(alarm.last + 1, 1979) is None
    assert {bool(doubt) for doubt in doubts[800:1900]} == {True}
    assert doubts[1000].startswith(
        "the readings of the plate temperature may be off by about +3"
    )
    assert doubts[1000].endswith("°C: compare them with another thermometer")
    assert not doubts[1970]


def test_time_without_readings_does_not_show_that_they_are_right_again() -> None:
    """After a gap they are still off; a new session knows nothing."""
    samples, _ = rig.run(
        rig.profile(1004, 1150),
        rig.Break("reading+3", 700),
        rig=rig.some_rig(4),
        seed=4,
    )
    monitor = Monitor()
    for sample in samples[:1000] + samples[1060:]:
        monitor.push(sample)
    (alarm,) = monitor.alarms
    assert (alarm.fault, alarm.last) == (Fault.SENSOR_DRIFT, None)
    assert monitor.doubt
    monitor.push(samples[0])
    assert not monitor.alarms
    assert not monitor.doubt


def test_the_plant_is_trusted_as_far_as_the_samples_bear() -> None:
    """The simulated rig obeys the equations; one whose readings wander does not."""
    samples, _ = rig.run(rig.profile(3, 1500), rig=rig.some_rig(3), seed=3)
    exact = ChangeDetector(HealthSettings().followed, 1.0)
    for sample in samples:
        assert exact.push(sample) is None or not exact.suspected
    assert exact.level <= 0.5
    random = np.random.default_rng(1)
    rough = ChangeDetector(HealthSettings().followed, 1.0)
    wander = np.cumsum(random.normal(0.0, 0.15, len(samples)))
    for sample, wandered in zip(samples, wander, strict=True):
        rough.push(
            Sample(
                sample.index,
                0,
                sample.reference,
                sample.output + float(wandered),
                sample.input,
            )
        )
    assert rough.level > exact.level


def motors(*kinds: str) -> list[Monitor]:
    """Of 500 s of a motor whose load is measured, each changed in another way after 400 s."""
    truth = Motor.model("with friction").parameters(j=4.4e-4, b=1.1e-4, k=0.046)
    pid = Controller(Motor.loop)
    random = np.random.default_rng(7)
    period = Motor.loop.period
    monitor = Monitor(HealthSettings.of(Motor, period))
    reference = random.uniform(-150.0, 150.0, 60)

    def run(until: float, before: Any, kind: str = "") -> Any:
        k, states, pid, random, monitor = before
        while k * period < until:
            wanted = float(reference[k // 200])
            y = read(truth, states) + random.normal(0.0, 0.2)
            u = pid.step(wanted, y)[0]
            load = 0.02 * np.sin(k / 200)
            monitor.push(Sample(k, k, wanted, y, u, (load,)))
            unseen = 0.005 if kind == "load" else 0.0
            share = 0.75 if kind == "weak" else 1.0
            states = advance(
                truth, states, share * u, period, np.array([load + unseen])
            )
            k += 1
        return k, states, pid, random, monitor

    k, states, pid, random, monitor = run(
        400.0, (0, begin(truth, 0.0), pid, random, monitor)
    )
    return [
        run(500.0, (k, states, *deepcopy((pid, random)), copied(monitor)), kind)[-1]
        for kind in kinds
    ]


def test_another_plant_is_judged_by_what_its_file_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Motor, "typical", {"k": 0.05})
    unchanged, weak, loaded = motors("", "weak", "load")
    assert unchanged.alarms == ()
    assert Fault.DRIVE_WEAK in {a.fault for a in weak.alarms}
    # No parameter has a role, so a load that nobody measures has no name, and gets none.
    assert {a.fault for a in loaded.alarms} <= {Fault.DRIFT}


def test_roles_and_the_structure_to_be_followed_are_checked() -> None:
    with pytest.raises(PlantError, match="role 'lid' of a parameter"):
        Parameter(default=1.0, bounds=(0.5, 2.0), role="lid")
    assert Peltier.followed in Peltier.structures
    with pytest.raises(
        PlantError, match="`followed` is 'none'; name one of its structures"
    ):
        type("Other", (Motor,), {"followed": "none"})


class Stronger:
    """A supply that is first far too strong, then less so."""

    kind = ""
    start = 500

    def on(self, k: int) -> bool:
        self.kind = "supply*1.6" if k < 1000 else "supply*1.25"
        return k >= 500


def test_a_drive_that_does_more_than_it_should_is_not_weak() -> None:
    samples, _ = rig.run(
        rig.profile(1004, 1200), cast("Any", Stronger()), rig=rig.some_rig(4), seed=4
    )
    assert {a.fault for a in rig.watch(samples)[0].alarms} == {Fault.DRIFT}
