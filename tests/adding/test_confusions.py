"""Which faults a plant file says cannot be told apart: as the monitor then does."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks.bank.kits import typical
from tests.support.exchanging import Heaters
from twinmatch.adding.confusions import FaultTrial, confusions
from twinmatch.dynamics import Equations, Parameter, Parameters, Structure
from twinmatch.dynamics.tracker import Assumed
from twinmatch.health import Fault
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.hypotheses import ChangeRow
from twinmatch.plants import PLANTS
from twinmatch.signals import FloatArray, Sample


def errors(
    parameters: Parameters, states: FloatArray, u: FloatArray, size: int
) -> FloatArray:
    """What a plant whose equations err as those of a real rig reads beyond them, with noise, shape (N, o).

    Its states stray as a filter of that model error assumes, to first order; pushes fade.
    """
    random = np.random.default_rng(0)
    assumed = Assumed.of(parameters, 1.0)
    model = parameters.model
    o = model.noise.size
    n = states.size
    slopes = model.kernels.slopes_at(parameters.vector, states, u, model.disturbances)
    moves = expm(slopes[1])
    shows = slopes[4]
    x = np.zeros(n)
    push = np.zeros(o)
    readings = []
    for _ in range(size):
        readings.append(shows @ x + model.noise * random.standard_normal(o))
        push = assumed.keeps[0] * push + assumed.stray * random.standard_normal(o)
        x = (
            moves @ x
            + assumed.drift[:n] * random.standard_normal(n)
            + np.linalg.pinv(shows) @ push
        )
    return np.array(readings)


AFTER = 240
"""Samples after a fault."""


@pytest.fixture(scope="module")
def watched() -> tuple[FaultTrial, ChannelMonitor, FloatArray]:
    """The trial of a kit, a monitor that has seen it healthy, and how its equations err afterwards."""
    kit = FaultTrial(typical(), 1.0)
    strayed = errors(
        kit.parameters, kit.states, kit.inputs[-1], len(kit.healthy) + AFTER
    )
    monitor = ChannelMonitor(kit.parameters, 1.0)
    for sample in samples(kit, kit.healthy + strayed[:-AFTER], 0):
        monitor.push(sample)
    assert monitor.alarms == ()
    # as if it had seen it since long: from then on losses are named
    monitor.competition.healthy.known = 1200
    return kit, monitor, strayed[-AFTER:]


def samples(kit: FaultTrial, readings: FloatArray, first: int) -> Iterator[Sample]:
    for k, y in enumerate(readings.tolist(), first):
        yield Sample(k, k * 10**9, (0.0, 0.0), tuple(y), tuple(kit.inputs[k].tolist()))


def rows(kit: FaultTrial) -> dict[str, ChangeRow]:
    """The faults that come at once, by number."""
    return {row.number: row for row in kit.rows if not row.slowly}


@pytest.mark.parametrize(
    ("number", "named", "within"),
    [
        # once heater 2 shows that it is not their supply
        ("share 0", (Fault.DRIVE_WEAK, "power"), AFTER),
        ("offset 1", (Fault.SENSOR_DRIFT, "second_temperature"), 150),
        ("losses", None, 150),
        ("ambient", None, 150),
    ],
)
def test_what_is_said_apart_is_named_and_what_is_said_alike_is_said_as_both(
    watched: tuple[FaultTrial, ChannelMonitor, FloatArray],
    number: str,
    named: tuple[Fault, str] | None,
    within: int,
) -> None:
    kit, healthy, strayed = watched
    faults = rows(kit)
    # Of two that are alike one may be told from the other, but not the other from it.
    rival_numbers = {
        cause
        for cause in ("losses", "ambient")
        if number in (kit.rivals(faults[cause]) or ())
    }
    rival_numbers |= {*(kit.rivals(faults[number]) or ())}
    monitor = copy.deepcopy(
        healthy,
        {id(shared): shared for shared in (kit.parameters, kit.parameters.model)},
    )
    readings = kit.readings(faults[number])[:within] + strayed[:within]
    for sample in samples(kit, readings, len(kit.healthy)):
        monitor.push(sample)
    (alarm,) = monitor.alarms
    if named:
        assert rival_numbers == set()
        assert (alarm.fault, alarm.signal, alarm.rivals) == (*named, ())
    else:
        assert rival_numbers == {"losses", "ambient"} - {number}
        assert alarm.fault is Fault.DRIFT
        assert {*alarm.rivals} == {
            kit.called[cause] for cause in (number, *rival_numbers)
        }


def test_with_one_sensor_losses_and_the_room_are_not_told_apart_either() -> None:
    (sentence,) = confusions(PLANTS["tclab"], 1.0)
    begins = "faults that cannot be told apart, even under large steps (a sample every 1 s): "
    assert sentence.startswith(begins)
    loss = "losses (convection to the room)"
    room = "temperature of the room"
    assert sentence.removeprefix(begins) == f"{loss} and {room}"


def test_what_is_too_small_at_its_usual_size_is_compared_with_nothing() -> None:
    sentences = confusions(PLANTS["peltier"], 1.0)
    assert sentences[-1].startswith(
        "faults too small to show beside such steps, at their usual size: losses (convection"
    )


class Walls(Heaters, name="walls"):
    """Two heated bodies with losses through two walls, of one body or of each."""

    near, far = (
        Parameter(
            unit="1/s",
            default=0.01,
            bounds=(1e-3, 0.1),
            positive=True,
            role="losses",
            text=text,
        )
        for text in ("near wall", "far wall")
    )
    parts = ("each",)
    structures: ClassVar = {
        name: Structure(
            free=("near", "far", "first_gain", "second_gain"), parts=frozenset(parts)
        )
        for name, parts in (("one body", ()), ("each body", ("each",)))
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        first_above = self.one - 23.0
        second_above = self.two - 23.0
        flow = self.exchange * (self.two - self.one)
        first = self.first_gain * self.first_power - self.near * first_above + flow
        second = self.second_gain * self.second_power - flow
        if "each" in parts:
            second -= self.far * second_above
        else:
            first -= self.far * first_above
        return Equations(
            rates={self.one: first, self.two: second},
            output={self.first: self.one, self.second: self.two},
            start={self.one: self.first, self.two: self.second},
        )


@pytest.mark.parametrize("name", ["one body", "each body"])
def test_two_losses_of_one_body_are_one_and_of_two_bodies_two(name: str) -> None:
    """Of one body they enter as a sum, which no experiment divides; of two each cools its own sensor more."""
    trial = FaultTrial(Walls.model(name).typical(), 2.0)
    for number, rival in (("near", "far"), ("far", "near")):
        rivals = trial.rivals(rows(trial)[number])
        assert rivals is not None
        assert (rival in rivals) == (name == "one body")


def test_the_trial_of_a_fault_needs_no_kernel_of_its_own() -> None:
    """Columns of a table that lies in memory row by row would have every kernel compiled again."""
    trial = FaultTrial(typical(), 1.0)
    assert trial.inputs.shape[1] == 2
    assert trial.inputs.flags.c_contiguous
