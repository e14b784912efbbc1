"""A plant with two inputs and outputs in the twin's nodes: what comes out is what the core gives offline."""

from __future__ import annotations

import pytest

from benchmarks.bank.kits import run
from tests.support.processes import Start
from tests.support.ros import Listener
from twinmatch.nodes.messages import message_of, record_of
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.plants import TCLabBoth
from twinmatch.signals import Sample
from twinmatch.twin import Outcome, Twin, TwinSettings
from twinmatch_msgs.msg import EstimatedReading, Forecast, ModelScore, TwinState

pytestmark = pytest.mark.ros
BEGINS = 460
"""The sample from which on the sensor is wrong: two matches are before it."""
SIZE = BEGINS + 60


@pytest.fixture(scope="module")
def steps() -> list[Sample]:
    """A kit under steps of both heaters, whose second sensor reads 5 °C too much from a moment on."""
    return list(run(21, "T2 +5 °C", SIZE, BEGINS))


@pytest.fixture(scope="module")
def offline(steps: list[Sample]) -> list[Outcome]:
    twin = Twin(TwinSettings.of(TCLabBoth, law=None))
    return [twin.push(sample) for sample in steps]


def test_live_verdicts_and_estimates_of_several_signals_are_the_offline_ones(
    start_process: Start,
    listener: Listener,
    steps: list[Sample],
    offline: list[Outcome],
) -> None:
    heard = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    estimates = listener.hear(EstimatedReading, "plant/estimate", EVERYTHING)
    forecasts = listener.hear(Forecast, "twin/forecast", EVERYTHING)
    states = listener.hear(TwinState, "twin/state", EVERYTHING)
    assert not listener.health
    start_process("twin", "-p", "plant:=tclab-both", "-p", "loop:=unknown")
    listener.wait_for_nodes(
        "twin/match", "twin/match_request", "twin/model_score", "twin/state", readers=2
    )  # twin simulator and discriminator
    listener.send(steps)
    verdicts = [verdict for outcome in offline for verdict in outcome.verdicts]
    listener.spin_until(
        lambda: len(heard) == len(verdicts) and len(states) == len(steps),
        "the last verdict",
    )
    stamps = {sample.index: sample.stamp for sample in steps}
    assert [repr(m) for m in heard] == [
        repr(message_of(v, stamps[v.sample])) for v in verdicts
    ]
    assert repr(record_of(heard[-1])) == repr(verdicts[-1])
    (named_fault,) = {(v.fault, v.fault_signal) for v in verdicts} - {("", "")}
    assert named_fault == ("sensor-drift", "second_temperature")
    read_on = [estimate for outcome in offline for estimate in outcome.estimates]
    listener.spin_until(lambda: len(estimates) == len(read_on), "the last estimate")
    assert [repr(m) for m in estimates] == [
        repr(message_of(e, stamps[e.sample])) for e in read_on
    ]
    newest = verdicts[-1]
    assert [signal.signal for signal in newest.signals] == [
        "temperature",
        "second_temperature",
    ]
    assert len(forecasts[-1].output) == 2 * len(forecasts[-1].time)
    assert [len(states[-1].driven_output), len(states[-1].reference)] == [2, 2]
