"""Health without ROS, and the messages it becomes."""

from __future__ import annotations

import threading
import time

import pytest

from tests.support.waiting import wait_for
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.health import Level, NodeHealth, Report, status_message
from twinmatch.nodes.node import Worker
from twinmatch.nodes.samples import SampleWatch, Standstill
from twinmatch.showing.page.health import NodeReport, NodeReports, PlayerState


def test_without_a_warning_a_node_reports_that_it_works_with_its_values() -> None:
    health = NodeHealth()
    health.set("rate", 0.1)
    health.set("name", "plate")
    assert health.report() == Report(
        Level.OK, "working", {"rate": "0.1", "name": "plate"}
    )


def test_worst_warning_is_the_level_and_comes_first() -> None:
    health = NodeHealth()
    health.flag("a", Level.WARN, "slow")
    health.flag("b", Level.ERROR, "wrong")
    assert health.report()[:2] == (Level.ERROR, "wrong; slow")
    health.withdraw("b")
    assert health.report()[:2] == (Level.WARN, "slow")
    health.flag("a", Level.STALE, "silent")
    assert health.report()[:2] == (Level.STALE, "silent")
    health.withdraw("a")
    health.withdraw("never said")
    assert health.report().level is Level.OK


def test_what_is_counted_is_reported_as_a_number() -> None:
    health = NodeHealth()
    health.count("gaps")
    health.count("gaps")
    assert health.report().values == {"gaps": "2"}


@pytest.mark.parametrize("level", list(Level))
def test_a_report_becomes_a_diagnostic_with_its_level_and_values(level: Level) -> None:
    message = status_message(
        "matcher: health", Report(level, "as said", {"key": "value"})
    )
    assert message.level == bytes([level])
    assert (message.name, message.message) == ("matcher: health", "as said")
    assert [(entry.key, entry.value) for entry in message.values] == [("key", "value")]


def test_gaps_and_silence_are_reported_and_withdrawn_in_time() -> None:
    health = NodeHealth()
    watch = SampleWatch(health, period=1.0, patience=5, remember=2)
    watch.check(1000.0)
    assert health.report()[:2] == (Level.OK, "waiting for samples")
    watch.push(7, 0.0)
    watch.push(8, 1.0)
    assert health.report()[:2] == (Level.OK, "working")
    watch.push(11, 2.0)
    assert health.report()[:2] == (
        Level.ERROR,
        "samples 9 to 10 are missing; behind a long gap windows start over",
    )
    watch.push(12, 3.0)
    assert health.report().level is Level.ERROR
    watch.push(13, 4.0)
    assert health.report().level is Level.OK
    watch.push(3, 5.0)
    assert "sample 3 came after sample 13" in health.report().message
    assert health.report().values["gaps"] == "2"
    watch.check(10.0)
    assert "no sample" not in health.report().message
    watch.check(10.1)
    assert "no sample for 5 s" in health.report().message
    # The dashboard leaves this out once a replay has ended, so it must know the words.
    roster = NodeReports(
        {"matcher": NodeReport(Level.WARN, health.report().message, 0.0)},
        ended=PlayerState("", False, 1.0, ""),
    )
    assert "no sample" not in roster.message("matcher")
    watch.push(4, 10.2)
    watch.check(10.2)
    assert "no sample" not in health.report().message


def test_worker_keeps_the_order() -> None:
    handled: list[int] = []
    worker = Worker(handled.append, NodeHealth())
    for number in range(1000):
        worker.put(number)
    wait_for(lambda: len(handled) == 1000, "the end of the work")
    assert worker.close()
    assert handled == list(range(1000))


def test_worker_reports_errors_of_the_outside_and_continues() -> None:
    health = NodeHealth()
    handled: list[int] = []

    def handle(number: int) -> None:
        if number == 0:
            raise TwinmatchError("zero is not a share")
        handled.append(number)

    worker = Worker(handle, health)
    worker.put(0)
    wait_for(lambda: health.report().level is Level.ERROR, "the error")
    assert health.report()[:2] == (Level.ERROR, "zero is not a share")
    worker.put(1)
    wait_for(lambda: health.report().level is Level.OK, "the end of the work")
    assert worker.failure is None
    assert worker.close()
    assert handled == [1]
    assert health.report().values["errors"] == "1"


def test_worker_hands_a_defect_over() -> None:
    worker = Worker(lambda number: 1 / number, NodeHealth())  # type: ignore[arg-type, return-value]
    worker.put(0)
    wait_for(lambda: worker.failure, "the defect")
    assert isinstance(worker.failure, ZeroDivisionError)


def test_worker_reports_its_backlog() -> None:
    health = NodeHealth()
    gate = threading.Event()
    worker = Worker(lambda _: gate.wait() and None, health, backlog=3)
    for number in range(5):
        worker.put(number)
    wait_for(lambda: worker.depth == 4, "the first message being handled")
    worker.watch()
    assert health.report()[:2] == (
        Level.WARN,
        "4 messages are queued; they arrive faster than they are processed",
    )
    assert not worker.close(timeout=0.01)
    gate.set()
    assert worker.close()


# After a standstill nothing is published until the readers are back.


def test_a_process_that_beats_never_waits() -> None:
    still = Standstill()
    for k in range(40):
        still.beat(k * Standstill.LONG)
        assert still.remaining(k * Standstill.LONG + 0.5 * Standstill.LONG) == 0.0


def test_after_a_standstill_the_first_to_look_waits_whether_or_not_the_heart_has_beaten() -> (
    None
):
    for heart_first in (True, False):
        still = Standstill()
        still.beat(0.0)
        woken = 10.0
        if heart_first:
            still.beat(woken)
        assert still.remaining(woken) == Standstill.REDISCOVERY
        assert (
            still.remaining(woken + 0.5 * Standstill.REDISCOVERY)
            == 0.5 * Standstill.REDISCOVERY
        )
        assert still.remaining(woken + Standstill.REDISCOVERY) == 0.0


def test_an_end_lets_go_of_who_waits() -> None:
    still = Standstill()
    still.beat(time.monotonic() - 2 * Standstill.LONG)
    still.close()
    still.wait()
    assert still.remaining(time.monotonic()) > 0.0
