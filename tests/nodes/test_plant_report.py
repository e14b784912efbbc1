"""The plant's own health on /diagnostics, for programs that read nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from tests.support.processes import Start
from tests.support.ros import Inside, Listener
from tests.support.steps import drive_lost
from tests.support.verdicts import LED, verdict
from twinmatch.comparing import TrustLevel
from twinmatch.nodes.discriminator import plant_report
from twinmatch.nodes.health import PLANT_REPORT, Level, Report, status_message
from twinmatch.nodes.topics import EVERYTHING
from twinmatch.showing.page.node import Dashboard
from twinmatch_msgs.msg import ModelScore

pytestmark = pytest.mark.ros
WELL = "the plant responds normally"


def test_a_lost_drive_is_an_error_of_the_plant_and_not_of_the_node(
    start: Start, listener: Listener
) -> None:
    assert not listener.health
    scores = listener.hear(ModelScore, "twin/model_score", EVERYTHING)
    start("discriminator")
    start("matcher")
    listener.wait_for_nodes("twin/match", "twin/match_request", "twin/model_score")
    listener.spin_until(lambda: listener.reports(PLANT_REPORT), "its first report")
    assert {s.message for s in listener.reports(PLANT_REPORT)} == {
        "nothing is judged yet"
    }
    assert {s.level for s in listener.reports(PLANT_REPORT)} == {DiagnosticStatus.OK}
    samples = drive_lost()
    listener.send(samples[:640])
    listener.spin_until(lambda: listener.said(WELL), "word that it is well")
    listener.send(samples[640:])
    listener.spin_until(lambda: any(score.fault for score in scores), "the verdict")
    errors = listener.spin_until(
        lambda: [
            s
            for s in listener.reports(PLANT_REPORT)
            if s.level == DiagnosticStatus.ERROR
        ],
        "the fault",
    )
    faulty = next(score for score in scores if score.fault)
    assert errors[0].message == f"drive-lost: {faulty.reason}"
    values = {entry.key: entry.value for entry in errors[0].values}
    assert values["fault"] == "drive-lost"
    assert values["channel"] == faulty.fault_signal == "pwm"
    assert values["since sample"] == str(faulty.fault_since)
    assert all(
        s.level != DiagnosticStatus.ERROR
        for s in listener.reports("discriminator: health")
    )


def test_what_a_verdict_says_of_the_plant() -> None:
    assert plant_report(None, "") == Report(Level.OK, "nothing is judged yet", {})
    assert plant_report(LED, "") == Report(Level.OK, WELL, {})
    lost = replace(
        LED,
        level=TrustLevel.FAULT,
        fault="drive-lost",
        fault_signal="pwm",
        fault_since=640,
    )
    assert plant_report(lost, "no effect") == Report(
        Level.ERROR,
        "drive-lost: no effect",
        {"fault": "drive-lost", "channel": "pwm", "since sample": "640"},
    )
    slow = verdict(TrustLevel.DOUBTFUL, fault="room-changed", fault_since=9)
    assert plant_report(slow, "warmer")[:2] == (Level.WARN, "room-changed: warmer")
    missed = verdict(
        TrustLevel.DOUBTFUL, miss_since=7, level_reason="measurements lie outside"
    )
    assert plant_report(missed, "") == Report(
        Level.WARN, "measurements lie outside", {"since sample": "7"}
    )
    # the twin is poor, not the plant
    assert plant_report(verdict(TrustLevel.DOUBTFUL), "").level is Level.OK


def test_the_page_leaves_it_to_the_verdicts(listener: Listener) -> None:
    page = Inside("dashboard", "-p", "port:=0", kinds=[Dashboard])
    try:
        (node,) = page.nodes
        assert isinstance(node, Dashboard)
        reports = listener.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        tasks = [
            status_message(
                f"rig_a/discriminator: {task}", Report(Level.ERROR, "drive-lost", {})
            )
            for task in ("plant", "health")
        ]
        listener.spin_until(reports.get_subscription_count, "the page")
        reports.publish(DiagnosticArray(status=tasks))
        listener.spin_until(
            lambda: "rig_a/discriminator: health" in node.state.nodes.reports,
            "the report",
        )
        assert "rig_a/discriminator: plant" not in node.state.nodes.reports
        assert [event.title for event in node.state.events] == [
            "rig_a/discriminator reports an error"
        ]
    finally:
        page.end()
