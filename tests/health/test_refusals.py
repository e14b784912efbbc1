"""Which steps of a reading are refused, and when such steps are the plant's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
)
from twinmatch.health import Fault, HealthSettings, HealthState, Monitor, Refusals
from twinmatch.health.refusals import UsualSteps
from twinmatch.signals import Sample

PERIOD = 1.0 / 610.0


class Spring(Plant, name="spring-of-refusals"):
    """A mass on a spring that is taken for linear."""

    title = "Mass on a spring"
    out = Output(unit="V", noise=0.001, span=(-0.5, 0.5))
    volts = Drive(unit="V", limits=(-1.0, 1.0), noise=0.005)
    place = State(unit="V", span=(-0.6, 0.6), scale=0.05)
    speed = State(unit="V/s", span=(-300.0, 300.0), scale=20.0)
    stiff = Parameter(unit="1/s²", default=192000.0, bounds=(3e4, 6e5), positive=True)
    damp = Parameter(unit="1/s", default=42.0, bounds=(1.0, 300.0), positive=True)
    structures = {"linear": Structure(free=("stiff", "damp"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        force = 185000.0 * self.volts - self.stiff * self.place - self.damp * self.speed
        start = {self.place: self.out, self.speed: 0}
        return Equations(
            rates={self.place: self.speed, self.speed: force},
            output=self.place,
            start=start,
        )


def stiffening(size: int) -> list[Sample]:
    """A healthy mass whose spring stiffens, 610 samples a second, under a random force below 200 Hz."""
    random = np.random.default_rng(8)
    parts = 40
    frequencies = np.arange(1.0, 200.0, 0.7)
    phases = random.uniform(0.0, 2.0 * np.pi, frequencies.size)
    times = np.arange(size * parts) * PERIOD / parts
    force = np.sum(np.cos(2.0 * np.pi * np.outer(times, frequencies) + phases), axis=1)
    force *= 0.06 / force.std()
    place = speed = 0.0
    samples = []
    for k in range(size):
        read = place + 3e-4 * random.standard_normal()
        samples.append(
            Sample(k, round(k * PERIOD * 1e9), 0.0, read, float(force[k * parts]))
        )
        for part in range(parts):
            pull = (
                185000.0 * force[k * parts + part]
                - 192000.0 * place
                - 42.0 * speed
                - 7e5 * place**3
            )
            speed += pull * PERIOD / parts
            place += speed * PERIOD / parts
    return samples


def test_steps_that_recur_and_continue_are_the_plants() -> None:
    refusals = Refusals(HealthSettings.of(Spring, PERIOD), longest=10)
    refusals.know(Spring.model().parameters())
    samples = stiffening(3000)
    settled = [refusals.settle(sample) for sample in samples]
    refused = [sample.index for sample in settled if not sample.seen]
    assert refused, (
        "the twin holds each force for a sample, so some steps are more than it expects"
    )
    assert refusals.steps.recur
    assert max(refused) < 300
    # What no reading has ever done is refused as before.
    reading = samples[-1].output - 3.0 * refusals.steps.usual * np.sign(
        samples[-1].output
    )
    far = replace(
        samples[-1],
        index=3000,
        stamp=round(3000 * PERIOD * 1e9),
        outputs=(float(reading),),
    )
    assert not refusals.settle(far).seen


def test_a_spike_comes_back_and_teaches_nothing() -> None:
    refusals = Refusals(HealthSettings.of(Spring, PERIOD), longest=10)
    refusals.know(Spring.model().parameters())
    random = np.random.default_rng(2)
    for k in range(400):
        is_spike = k % 20 == 19
        reading = 0.2 if is_spike else 0.02 * float(random.standard_normal())
        settled = refusals.settle(Sample(k, round(k * PERIOD * 1e9), 0.0, reading, 0.0))
        assert settled.seen != is_spike
    assert not refusals.steps.recur


def test_only_what_has_been_made_several_times_is_usual() -> None:
    steps = UsualSteps()
    steps.take(5.0)
    steps.take(-4.0)
    assert steps.usual == 0.0
    steps.take(3.0)
    assert steps.usual == 3.0
    for _ in range(3):
        steps.refuse(9.5, samples=2)  # further than readings ever moved
    assert not steps.recur
    for _ in range(3):
        assert not steps.include(2.5, samples=1)
        steps.refuse(-5.5, samples=2)
    assert steps.include(4.4, samples=1)
    assert not steps.include(4.6, samples=1)


def test_a_fault_of_impossible_readings_is_taken_back_with_a_sentence() -> None:
    monitor = Monitor(HealthSettings())
    health = None
    for k in range(80):
        sample = Sample(k, k * 10**9, 30.0, 30.0 + 0.01 * (k % 3), 0.0)
        if k == 70:
            sample = replace(sample, refused=(60.0,), seen=False)
        if k == 72:
            assert monitor.push(sample).fault is Fault.SENSOR_IMPLAUSIBLE
            monitor.withdraw()
            continue
        health = monitor.push(sample)
        if k == 73:
            assert health.news is not None
            assert health.news.withdrawn.startswith(
                "sensor-implausible is taken back: steps of the "
            )
    assert health is not None
    assert health.state is HealthState.HEALTHY
