"""A law on trial: kept within its bands, taken back outside them, and nothing moves at a switch."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.control import ControlError, Loop
from twinmatch.dynamics import Law, PlantError, advance, begin, law_of, readings
from twinmatch.dynamics.loop import PidGains
from twinmatch.dynamics.pids import FilteredPid, pid_law
from twinmatch.plants import Peltier
from twinmatch.safety import LawTrial, TrialBands, TrialError, TrialPhase
from twinmatch.signals import Sample

LEVEL = 40.0
SETTLED = 300
OWN = law_of(Peltier, 1.0)
assert isinstance(OWN, PidGains)
SOUND = replace(OWN, proportional=1.5 * OWN.proportional, integral=1.5 * OWN.integral)
UNSOUND = replace(
    OWN, proportional=20.0 * OWN.proportional, integral=20.0 * OWN.integral
)


def bands(size: int = 60, half: float = 0.6, **options: int) -> TrialBands:
    return TrialBands(
        np.full((size, 1), LEVEL - half), np.full((size, 1), LEVEL + half), **options
    )


class Bench:
    """A simulated rig that rests at its set-point."""

    def __init__(self) -> None:
        self.truth = Peltier.model("sink with mass").parameters()
        self.loop = Loop(Peltier)
        self.states = begin(self.truth, [23.0])
        self.k = 0
        self.random = np.random.default_rng(3)
        self.off = 0.0
        self.silent = False
        self.level = LEVEL
        for _ in range(SETTLED):
            self.step()

    def step(self) -> Sample | None:
        """One tick."""
        noisy = (
            readings(self.truth, self.states)
            + 0.1 * self.random.standard_normal(1)
            + self.off
        )
        if not self.silent:
            self.loop.measure(tuple(noisy.tolist()), self.k * 10**9)
        sample = self.loop.tick(self.k * 10**9, lambda _: self.level)
        acting = [0.0] if sample is None else sample.inputs
        self.states = advance(self.truth, self.states, np.array(acting), 1.0)
        self.k = self.k + 1
        return sample


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_sound_law_is_kept_without_a_bump(bench: Bench) -> None:
    """In the shadow nothing changes; the first command of each law is the last one of the other, moved only
    by what the readings did in between, which its integral takes up."""
    twin = Bench()
    bench.loop.try_law(SOUND, trial := LawTrial(bands(shadow=20)))
    for _ in range(20 - 1):
        shadowed = bench.step()
        alone = twin.step()
        assert shadowed is not None
        assert alone is not None
        assert shadowed.inputs == alone.inputs
        assert trial.phase is TrialPhase.SHADOW
        assert len(bench.loop.shadow) == 1
    before = bench.loop.input
    bench.step()
    assert trial.phase is TrialPhase.DRIVING
    assert bench.loop.input == pytest.approx(before, abs=1e-9)
    for _ in range(60):
        bench.step()
    assert trial.phase is TrialPhase.KEPT
    assert not bench.loop.trying
    before = bench.loop.input
    bench.loop.take_back("given back by the operator")
    bench.step()
    assert bench.loop.input == pytest.approx(before, abs=1e-9)
    assert trial.phase is TrialPhase.BACK


def test_an_unsound_law_is_taken_back_and_the_old_one_holds_the_level(
    bench: Bench,
) -> None:
    bench.loop.try_law(UNSOUND, trial := LawTrial(bands()))
    highest = max(sample.output for _ in range(60) if (sample := bench.step()))
    assert trial.phase is TrialPhase.BACK
    assert trial.reason.startswith("output 1 is ")
    assert highest < Peltier.output.safe[1]
    for _ in range(SETTLED):
        sample = bench.step()
    assert sample is not None
    assert sample.output == pytest.approx(LEVEL, abs=0.6)


def hold_drive(loop: Loop) -> None:
    loop.held = True


def limited(loop: Loop) -> None:
    loop.limits = [100.0]


@pytest.mark.parametrize("guard", [hold_drive, limited])
def test_when_the_guard_acts_the_old_law_is_back(
    bench: Bench, guard: Callable[[Loop], None]
) -> None:
    bench.loop.try_law(SOUND, trial := LawTrial(bands()))
    bench.step()
    assert trial.drives
    guard(bench.loop)
    bench.step()
    assert trial.phase is TrialPhase.BACK
    assert trial.reason == "the guard holds or limits the drive"


def test_when_readings_stop_the_output_is_off_and_the_old_law_is_back(
    bench: Bench,
) -> None:
    bench.loop.try_law(SOUND, trial := LawTrial(bands()))
    bench.step()
    bench.silent = True
    for _ in range(4):
        bench.step()
    assert trial.phase is TrialPhase.BACK
    assert "s old" in trial.reason
    assert bench.loop.inputs == [0.0]


def test_ticks_that_are_lost_count_as_missed(bench: Bench) -> None:
    """After a pause of the process nothing says what the plant did; a short one is forgiven."""
    bench.loop.try_law(SOUND, trial := LawTrial(bands()))
    bench.step()
    bench.k += 5
    bench.step()
    assert trial.phase is TrialPhase.DRIVING
    bench.k += 30
    before = bench.loop.input
    bench.step()
    assert trial.phase is TrialPhase.BACK
    assert trial.reason.startswith("output 1 is nan")
    assert bench.loop.input == pytest.approx(before, abs=1e-9)


def test_a_set_point_that_moves_ends_a_trial(bench: Bench) -> None:
    """Its bands are for the one at which it began."""
    bench.loop.try_law(SOUND, trial := LawTrial(bands()))
    bench.step()
    bench.level += 5.0
    bench.step()
    assert trial.phase is TrialPhase.BACK
    assert trial.reason.startswith("the set-point has moved")


def test_a_kept_law_survives_a_later_fault(bench: Bench) -> None:
    """Nothing is on trial then: the guard acts as under any law."""
    bench.loop.try_law(SOUND, trial := LawTrial(bands(size=10)))
    for _ in range(12):
        bench.step()
    assert trial.phase is TrialPhase.KEPT
    bench.loop.held = True
    bench.step()
    assert trial.phase is TrialPhase.KEPT


NO_INTEGRAL = replace(OWN, integral=0.0)
FILTERED = pid_law([replace(FilteredPid.of(OWN), filter=2.0)], 1.0)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (NO_INTEGRAL, "without integral gain cannot take over"),
        (replace(OWN, period=0.5), "is 1 PIDs, every 1 s"),
        (FILTERED, "is 1 PIDs, every 1 s"),
    ],
)
def test_what_cannot_be_tried_is_said(bench: Bench, law: Law, words: str) -> None:
    with pytest.raises(ControlError, match=words):
        bench.loop.try_law(law, LawTrial(bands()))
    assert bench.loop.trial is None


def test_a_second_law_waits_for_the_first(bench: Bench) -> None:
    bench.loop.try_law(SOUND, LawTrial(bands()))
    with pytest.raises(ControlError, match="on trial already"):
        bench.loop.try_law(SOUND, LawTrial(bands()))
    bench.loop.take_back("given back by the operator")
    bench.loop.try_law(SOUND, LawTrial(bands()))
    assert bench.loop.trying


def test_bands_and_gains_that_are_not_numbers_are_refused() -> None:
    low = np.full((5, 1), 1.0)
    high = np.full((5, 1), 2.0)
    for ends in (
        (high, low),
        (low, np.full((5, 1), math.nan)),
        (low[:0], high[:0]),
        (low, high[:4]),
    ):
        with pytest.raises(TrialError, match="pairs of finite ends"):
            TrialBands(*ends)
    for options in ({"shadow": -1}, {"patience": 0}, {"patience": 6}):
        with pytest.raises(TrialError, match="samples in the shadow and a patience"):
            TrialBands(low, high, **{"patience": 2} | options)
    with pytest.raises(PlantError):
        replace(OWN, proportional=math.nan)


@given(
    outside=st.lists(st.booleans(), min_size=1, max_size=60),
    patience=st.integers(1, 20),
)
def test_it_is_taken_back_exactly_when_more_is_missed_than_stated(
    outside: list[bool], patience: int
) -> None:
    """Samples outside count one, those inside take one back; NaN is outside."""
    trial = LawTrial(bands(patience=patience))
    missed = 0
    for k, out in enumerate(outside):
        missed = max(missed + (1 if out else -1), 0)
        phase = trial.push([(LEVEL + 1.0, math.nan)[k % 2] if out else LEVEL])
        if missed >= patience:
            assert phase is TrialPhase.BACK
            return
        assert phase is (TrialPhase.KEPT if k == 59 else TrialPhase.DRIVING)
