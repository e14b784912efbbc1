"""Laws on trial through real nodes: the controller watches alone; the twin answers before anything is run."""

from __future__ import annotations

import itertools
import json
import math
import re
from typing import Any

import pytest

from tests.nodes.test_controller import Bench
from tests.support.odd_values import odd_values
from tests.support.processes import Start
from tests.support.rig import GAINS
from tests.support.ros import Listener
from tests.support.signed import SECRET, signed
from tests.support.steps import quarter_of_an_hour
from twinmatch.nodes.signature import VARIABLE
from twinmatch.nodes.topics import EVERYTHING, LATCHED
from twinmatch.twin import Snapshot
from twinmatch_msgs import msg as messages
from twinmatch_msgs.srv import ApplyLaw, Experiment, TryLaw, WhatIf

pytestmark = pytest.mark.ros

CALM = ("-p", "period:=0.1", "-p", "command_period:=0.05", "-p", "max_age:=10.0")
"""Readings and ticks may be late by seconds on a busy machine, for which a law on trial is taken back."""
PATIENCE = 100


@pytest.fixture(autouse=True)
def _secret(monkeypatch: pytest.MonkeyPatch) -> None:
    """All nodes are of one run, unless a test says otherwise."""
    monkeypatch.setenv(VARIABLE, SECRET)


class Operator:
    """Calls one of the services."""

    def __init__(self, listener: Listener, kind: Any, name: str) -> None:
        self._listener = listener
        self._client = listener.node.create_client(kind, name)
        self._kind = kind

    def __call__(self, bench: Bench | None = None, **fields: Any) -> Any:
        wait = self._listener.spin_until if bench is None else bench.feed
        wait(self._client.service_is_ready, "the service")
        answer = self._client.call_async(self._kind.Request(**fields))
        wait(answer.done, "an answer")
        return answer.result()


def law(bench: Bench, half: float = 2.0, **fields: Any) -> dict[str, Any]:
    """A law that is to hold 40 °C, as the twin would send and sign it."""
    asked = {
        "proportional": [GAINS.proportional / 2],
        "integral": [GAINS.integral / 2],
        "derivative": [0.0],
        "back_calculation": [1.0],
        "on_measurement": [False],
        "low": [40.0 - half] * 1000,
        "high": [40.0 + half] * 1000,
        "patience": PATIENCE,
        "decision": "safe",
        "sample": bench.samples[-1].index,
    }
    return signed(**(asked | fields))


def test_the_controller_takes_a_law_back_by_itself(
    start: Start, listener: Listener
) -> None:
    """There is no twin, and no node but the controller: the readings decide. Before it, what it refuses;
    after it, the operator takes another one back."""
    bench = Bench(listener)
    operator = Operator(listener, ApplyLaw, "plant/apply_law")
    reports = listener.hear(messages.LawReport, "plant/law", LATCHED)
    bench.temperature = 40.0
    start(
        "controller",
        *CALM,
        "-p",
        "profile.levels:=[40.0]",
        "-p",
        "profile.holds:=[1000.0]",
    )
    bench.feed(lambda: len(bench.samples) >= 20, "samples")
    for fields, words in (
        ({"decision": "fails"}, "the law is fails, not safe"),
        ({"decision": ""}, "the law is not tried, not safe"),
        ({"sample": 10**6}, "the answer is from sample 1000000"),
        ({"proportional": [math.nan]}, "a value that is not finite"),
        ({"integral": [0.0]}, "without integral gain"),
        ({"proportional": []}, "give 1 of each gain"),
        ({"high": [math.nan] * 1000}, "pairs of finite ends"),
        ({"low": []}, "pairs of finite ends"),
        ({"patience": 0}, "a patience of 0"),
        (
            {"proportional": [-50.0], "integral": [-5.0]},
            "pid.proportional is -50.0; allowed: ",
        ),
        ({"proportional": [1e9]}, "pid.proportional is 1000000000.0; allowed: "),
        (
            {"proportional": [9e3]},
            "the plant of its file is not stable (largest eigenvalue ",
        ),
    ):
        answer = operator(bench, **law(bench, **fields))
        assert not answer.success, fields
        assert words in answer.message
    for request in odd_values(ApplyLaw, seed=7, count=60):
        answer = operator(bench, **signed(**fields_of(request)))
        assert not answer.success, request
        assert "a defect of twinmatch" not in answer.message
    safe = law(bench)
    for forged in (
        safe | {"signature": ""},
        safe | {"proportional": [9.0]},
        signed("another run's secret", **safe),
    ):
        answer = operator(bench, **forged)
        assert "lacks the signature of this run's twin" in answer.message
    assert not reports, "the law of the configuration drives"
    assert not operator(bench, back=True).success
    unsafe = law(bench, decision="fails", although=True, request="mine")
    assert operator(bench, **unsafe).success
    bench.feed(lambda: reports, "a report")
    assert (reports[-1].phase_name, reports[-1].decision, reports[-1].although) == (
        "driving",
        "fails",
        True,
    )
    assert list(reports[-1].proportional) == [GAINS.proportional / 2]
    assert reports[-1].request == "mine"
    assert "on trial already" in operator(bench, **law(bench)).message
    bench.pass_time(0.5)
    assert reports[-1].phase_name == "driving"
    bench.temperature = 43.0
    bench.feed(lambda: reports[-1].phase_name == "back", "the law before")
    assert reports[-1].reason.startswith(
        "output 1 is 43, not 38 to 42, for 100 samples"
    )
    assert reports[-1].sample - reports[-1].first >= PATIENCE - 1
    bench.temperature = 40.0
    assert "on trial already; ask again" in operator(bench, **unsafe).message
    assert operator(bench, **law(bench, shadow=2)).success
    bench.feed(lambda: reports[-1].phase_name == "driving", "the shadow's end")
    assert operator(bench, back=True).success
    bench.feed(lambda: reports[-1].phase_name == "back", "the operator's word")
    assert reports[-1].reason == "given back by the operator"


DOCUMENT = {
    "kind": "pid",
    "proportional": 60,
    "integral": 2.0,
    "derivative": 13,
    "back_calculation": 1.0,
}


def test_the_twin_answers_before_anything_is_run(
    start_process: Start, listener: Listener
) -> None:
    """A document it cannot use, no twin yet, no controller; then an answer for the family that there is, once
    the outputs rest. The discriminator that gives it can be killed: nothing that drives depends on it."""
    # the outputs come to rest with a candidate, and stay so
    steps = quarter_of_an_hour()[:600]
    # subscribed before anything is asked: an answer then shows that the reports reach the test
    reports = listener.hear(messages.LawReport, "twin/law", EVERYTHING)
    ask = Operator(listener, TryLaw, "twin/try_law")
    start_process("matcher")
    twin = start_process("discriminator")
    text = json.dumps(DOCUMENT)
    assert "no controller is here" in ask(law=text, run=True).message
    for asked, words in (
        (text, "there is no candidate yet"),
        ("{", "law"),
        (json.dumps(DOCUMENT | {"filter": 2.0}), "has a filter"),
        (json.dumps({"kind": "two-level", "off": 0, "on": 9, "low": 1, "high": 2}), ""),
    ):
        count_before = len(reports)
        assert ask(law=asked).success
        listener.spin_until(lambda seen=count_before: len(reports) > seen, "a report")
        assert reports[-1].phase_name == "refused"
        assert words in reports[-1].reason
    listener.wait_for_nodes("twin/match", "twin/match_request")
    listener.send(steps)

    numbers = itertools.count()

    def answered() -> bool:
        """Whether a request was answered; until then another is made, each with a word of its own."""
        if any(report.phase_name == "answered" for report in reports):
            return True
        ask(law=text, request=f"number {next(numbers)}")
        return False

    listener.spin_until(answered, "an answer")
    report = next(report for report in reports if report.phase_name == "answered")
    assert report.decision in {"safe", "fails", "undecided"}
    assert len(report.family) == 12
    assert list(report.integral) == [2.0]
    answers_belong_to_requests(listener, ask, reports)
    assert odd_questions(listener, reports) == []
    assert twin.running


def answers_belong_to_requests(
    listener: Listener, ask: Operator, reports: list[Any]
) -> None:
    """Each report has the word of its request; a request that is refused at once has no report."""

    def reported(word: str) -> list[str]:
        return [report.phase_name for report in reports if report.request == word]

    listener.spin_until(lambda: ask(law="{", request="bad").success, "its turn")
    listener.spin_until(lambda: reported("bad"), "its refusal")
    assert reported("bad") == ["refused"]
    # A second one is taken on if it is asked between the first answer and its report here.
    answered = [report.request for report in reports if report.phase_name == "answered"]
    for word in answered:
        assert word.startswith("number ")
        assert reported(word) == ["answered"]
    for shadow in (math.nan, math.inf, -1.0, 1e300):
        assert ask(law=json.dumps(DOCUMENT), shadow=shadow).message.startswith(
            "shadow is "
        )


def odd_questions(listener: Listener, laws: list[Any]) -> list[str]:
    """Ask the twin what nobody means; returns what it calls a defect. Every request is answered, and one that
    is taken on has a report."""
    courses = listener.hear(messages.ExperimentReport, "twin/experiment", EVERYTHING)
    asked = (
        (TryLaw, "twin/try_law", laws),
        (Experiment, "twin/experiment", courses),
        (WhatIf, "twin/what_if", []),
    )
    replies = []
    for seed, (kind, name, reports) in enumerate(asked):
        ask = Operator(listener, kind, name)
        for request in odd_values(kind, seed, count=25):
            count_before = len(reports)
            answer = ask(**fields_of(request))
            replies.append(answer.message)
            if answer.success and kind is not WhatIf:
                listener.spin_until(
                    lambda r=reports, n=count_before: len(r) > n,
                    f"a report on {request}",
                )
                replies.append(reports[-1].reason)
    return [text for text in replies if "a defect of twinmatch" in text]


def fields_of(request: Any) -> dict[str, Any]:
    return {
        name: getattr(request, name) for name in request.get_fields_and_field_types()
    }


def test_a_defect_is_answered_in_a_sentence_and_the_node_continues(
    start: Start, listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is asked of the twin begins with its newest snapshot, which is broken here for a while."""

    def broken(*_: object) -> None:
        raise ZeroDivisionError("as no user could cause it")

    laws = listener.hear(messages.LawReport, "twin/law", EVERYTHING)
    courses = listener.hear(messages.ExperimentReport, "twin/experiment", EVERYTHING)
    asked = (
        Operator(listener, WhatIf, "twin/what_if"),
        Operator(listener, TryLaw, "twin/try_law"),
        Operator(listener, Experiment, "twin/experiment"),
    )
    start("discriminator")

    def ask_all() -> list[str]:
        laws.clear()
        courses.clear()
        what_if, try_law, experiment = asked
        texts = [what_if().message]
        listener.spin_until(
            lambda: try_law(law=json.dumps(DOCUMENT)).success, "its turn"
        )
        listener.spin_until(lambda: experiment().success, "its turn")
        listener.spin_until(lambda: laws and courses, "reports")
        return [*texts, laws[0].reason, courses[0].reason]

    with monkeypatch.context() as patch:
        patch.setattr(Snapshot, "outlook", broken)
        for words in ask_all():
            assert re.match(
                r"a defect of twinmatch \(\S+:\d+, \w+: ZeroDivisionError", words
            ), words
            assert "as no user could cause it" in words
    assert all("there is no candidate yet" in words for words in ask_all())
