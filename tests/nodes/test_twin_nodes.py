"""The twin's nodes on a played session: what comes out is what the core gives offline, bit for bit.

Messages are compared as text: that writes every float64 exactly, and NaN is equal to NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.support.nonsense import Nonsense, is_sound
from tests.support.processes import Start
from tests.support.ros import Listener
from twinmatch.comparing import Verdict
from twinmatch.defects import DefectWarning
from twinmatch.nodes.messages import (
    message_of,
    parameters_message,
    record_of,
    state_message,
)
from twinmatch.nodes.topics import EVERYTHING, LATCHED
from twinmatch.plants import Peltier
from twinmatch.signals import Sample
from twinmatch.twin import Mirror, Outcome, TwinSettings, engine
from twinmatch.twin.knowledge import Knowledge
from twinmatch_msgs.msg import (
    Candidate,
    ForecastScore,
    LoopSample,
    Match,
    MatchRequest,
    ModelScore,
    PlantDescription,
    TwinState,
)

pytestmark = pytest.mark.ros


def test_live_verdicts_are_the_offline_ones_whatever_is_published_beside(
    start_process: Start,
    listener: Listener,
    session: Path,
    steps: list[Sample],
    offline: list[Outcome],
) -> None:
    verdicts = [verdict for outcome in offline for verdict in outcome.verdicts]
    matches = [outcome.match for outcome in offline if outcome.match is not None]
    assert any(report.match.accepted for report in matches)
    heard = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    heard_matches = listener.hear(Match, "twin/match", EVERYTHING)
    states = listener.hear(TwinState, "twin/state", EVERYTHING)
    nominals = listener.hear(Candidate, "twin/nominal", LATCHED)
    for name in ("discriminator", "twin_simulator", "matcher"):
        start_process(name)
    requests = listener.hear(MatchRequest, "twin/match_request", EVERYTHING)
    topics = ("twin/match", "twin/match_request", "twin/model_score", "twin/state")
    listener.wait_for_nodes(*topics, readers=2)
    options = ("-p", "rate:=0.0", "-p", "wait_for:=2", "-p", "wait_timeout:=60.0")
    start_process("player", "-p", f"session:={session}", *options)
    drawn = Nonsense(46)
    rounds = iter(range(0, len(steps), 20))
    beside = {
        "plant/sample": LoopSample,
        "twin/match": Match,
        "twin/match_request": MatchRequest,
    }
    make = listener.node.create_publisher
    due = 0
    writers = [(make(kind, name, EVERYTHING), kind) for name, kind in beside.items()]

    def all_there() -> bool:
        nonlocal due
        if len(states) >= due:
            due = next(rounds, len(steps) + 1)
            for writer, kind in writers:
                writer.publish(drawn.refused(kind))
        return len(heard) == len(verdicts) and len(states) == len(steps)

    listener.spin_until(all_there, "the last verdict")
    listener.spin_until(
        lambda: sum(map(is_sound, heard_matches)) >= len(matches), "the last match"
    )
    heard_matches, requests = (
        list(filter(is_sound, received)) for received in (heard_matches, requests)
    )
    stamps = {sample.index: sample.stamp for sample in steps}
    expected: list[Any] = [
        message_of(verdict, stamps[verdict.sample]) for verdict in verdicts
    ]
    assert [repr(m) for m in heard] == [repr(m) for m in expected]
    expected = [message_of(report, stamps[report.sample]) for report in matches]
    # On a busy machine one may have been asked for, and so answered, twice.
    assert list(dict.fromkeys(repr(m) for m in heard_matches)) == [
        repr(m) for m in expected
    ]
    assert list(dict.fromkeys(r.sample for r in requests)) == [
        report.sample for report in matches
    ]
    assert [state.index for state in states] == [sample.index for sample in steps]
    listener.spin_until(
        lambda: nominals[-1].name == verdicts[-1].nominal, "the last nominal"
    )
    assert repr(record_of(heard[-1])) == repr(verdicts[-1])
    assert repr(record_of(heard_matches[-1])) == repr(matches[-1])


def test_a_matcher_that_dies_costs_time_and_nothing_else(
    start_process: Start, listener: Any, steps: list[Sample], offline: list[Outcome]
) -> None:
    """Killed while it works on a match: another one is asked again, and the verdicts are the same."""
    beginning = 420  # samples, until shortly after the first match
    heard = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    requests = listener.hear(MatchRequest, "twin/match_request", EVERYTHING)
    assert not listener.health
    start_process("discriminator")
    first = start_process("matcher")
    listener.wait_for_nodes("twin/match", "twin/match_request", "twin/model_score")
    listener.send(steps[:beginning])
    listener.spin_until(lambda: requests, "the first request")
    first.kill()
    listener.spin_until(
        lambda: listener.said("no answer to the match request"),
        "word of the lost match",
    )
    assert {request.sample for request in requests} == {requests[0].sample}
    assert len(requests) > 1
    start_process("matcher")
    verdicts = [
        verdict for outcome in offline[:beginning] for verdict in outcome.verdicts
    ]
    assert any(verdict.candidates for verdict in verdicts)
    listener.spin_until(lambda: len(heard) == len(verdicts), "the last verdict")
    assert [repr(record_of(m)) for m in heard] == [repr(v) for v in verdicts]


def test_late_simulator_is_given_the_leader(
    start: Start, listener: Listener, steps: list[Sample]
) -> None:
    """And its state is that of a mirror with those parameters."""
    parameters = Peltier.model().parameters(
        seebeck=0.08, conductance=0.4, heat_capacity=30.0
    )
    leader = ForecastScore(name="60 °C", parameters=parameters_message(parameters))
    listener.node.create_publisher(ForecastScore, "twin/leader", LATCHED).publish(
        leader
    )
    states = listener.hear(TwinState, "twin/state", EVERYTHING)
    assert not listener.health
    start("twin_simulator")
    listener.spin_until(lambda: "60 °C" in listener.values("leader"), "the leader")
    listener.send(steps[:50])
    listener.spin_until(lambda: len(states) == 50, "the states")
    mirror = Mirror(TwinSettings().start)
    mirror.parameters = parameters
    expected = [
        state_message(mirror.push(sample), "60 °C", Peltier.states)
        for sample in steps[:50]
    ]
    assert [repr(state) for state in states] == [repr(state) for state in expected]


def test_simulator_says_once_what_plant_it_is(
    start: Callable[..., Any], listener: Any
) -> None:
    start("twin_simulator", "-p", "period:=0.5")
    heard = listener.hear(PlantDescription, "plant/description", LATCHED)
    listener.spin_until(lambda: heard, "the description")
    assert (heard[0].plant, heard[0].period) == ("peltier", 0.5)
    assert [signal.unit for signal in heard[0].output] == ["°C"]
    assert [state.name for state in heard[0].states] == list(Peltier.states)
    assert "sink with mass" in heard[0].structures


def test_gap_is_an_error_on_diagnostics(
    start: Start, listener: Listener, steps: list[Sample]
) -> None:
    assert not listener.health
    start("discriminator")
    listener.spin_until(listener.samples.get_subscription_count, "the discriminator")
    listener.send([*steps[:5], *steps[8:12]])
    listener.spin_until(lambda: listener.said("missing"), "the warning")
    status = next(s for s in listener.reports() if "missing" in s.message)
    assert status.level == b"\x02"
    assert status.name == "discriminator: health"
    assert "samples 5 to 7 are missing" in status.message


def test_a_verdict_on_a_lost_sample_is_stamped_with_its_time(
    start: Start, listener: Listener, steps: list[Sample], offline: list[Outcome]
) -> None:
    lost = (
        offline[next(k for k, outcome in enumerate(offline) if outcome.verdicts)]
        .verdicts[0]
        .sample
    )
    heard = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    start("discriminator")
    listener.wait_for_nodes("twin/match_request", "twin/model_score")
    listener.send([*steps[:lost], steps[lost + 1]])
    listener.spin_until(lambda: heard, "the verdict")
    stamp = heard[0].header.stamp
    assert heard[0].sample == lost
    assert stamp.sec * 10**9 + stamp.nanosec == steps[lost].stamp


def test_three_in_one_process_have_nothing_to_say(
    start_process: Start, listener: Listener
) -> None:
    process = start_process("twin")
    names = {"matcher", "discriminator", "twin_simulator"}
    listener.spin_until(
        lambda: names <= set(listener.node.get_node_names()), "the nodes"
    )
    assert process.well(process.end())
    assert process.text == ""


def test_a_defect_ends_no_node_and_is_said_by_verdict_and_diagnostics(
    start: Start,
    listener: Listener,
    steps: list[Sample],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = engine.verdict_of

    def broken(knowledge: Knowledge) -> Verdict:
        if knowledge.sample == 119:
            raise ZeroDivisionError("a slip")
        return real(knowledge)

    monkeypatch.setattr(engine, "verdict_of", broken)
    heard = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    assert not listener.health

    def judged() -> None:
        start("discriminator")
        listener.wait_for_nodes("twin/model_score")
        listener.send(steps[:200])
        listener.spin_until(lambda: len(heard) == 3, "the verdict behind the defect")
        listener.spin_until(
            lambda: listener.said("a defect of this program"), "its report"
        )

    with pytest.warns(DefectWarning, match="a slip"):
        judged()
    assert [score.sample for score in heard] == [59, 119, 179]
    assert [record_of(score).level.value for score in heard] == ["unknown"] * 3
    assert "ZeroDivisionError: a slip" in heard[1].reason
    assert "defect" not in heard[2].reason
