"""Errors of nodes on the launcher's terminal: each once, printable, and not without end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from tests.support.nonsense import Nonsense
from twinmatch.errors import TwinmatchError
from twinmatch.launching.live import Errors
from twinmatch.nodes.entrance import Entrance
from twinmatch.nodes.expected import MESSAGES, check
from twinmatch.nodes.health import NodeHealth
from twinmatch.showing.page.health import MAX_NODES


class ErrorScreen:
    """What is shown of reports."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._errors = Errors(lambda text, _: self.lines.append(text))

    def take(
        self, name: str, message: str, level: bytes = DiagnosticStatus.ERROR
    ) -> list[str]:
        """Take a report; returns the new lines."""
        before = len(self.lines)
        status = DiagnosticStatus(level=level, name=name, message=message)
        self._errors.take(DiagnosticArray(status=[status]))
        return self.lines[before:]


@pytest.fixture
def screen() -> Iterator[ErrorScreen]:
    return ErrorScreen()


def test_an_error_is_shown_once_while_it_stands(screen: ErrorScreen) -> None:
    assert screen.take("a: health", "no image for 3 s") == [
        "a: health: no image for 3 s"
    ]
    assert screen.take("a: health", "no image for 4 s") == []
    assert screen.take("a: health", "working", DiagnosticStatus.OK) == [
        "a: health: recovered"
    ]
    assert screen.take("a: health", "no image for 3 s") == [
        "a: health: no image for 3 s"
    ]


def test_of_a_report_only_what_is_new_is_shown_and_of_several_nodes_the_first(
    screen: ErrorScreen,
) -> None:
    first = "refused: /s: sample 3 has 0 outputs; give one"
    second = "refused: /s: its time is negative"
    assert screen.take("a: health", first) == [f"a: health: {first}"]
    assert screen.take("a: health", f"{first}; {second}") == [f"a: health: {second}"]
    assert screen.take("b: health", f"{second}; {first}") == []
    assert screen.take("b: health", f"{second}; refused: /c: x") == [
        "b: health: refused: /c: x"
    ]


def test_what_is_shown_is_one_printable_line_of_bounded_length(
    screen: ErrorScreen,
) -> None:
    [line] = screen.take(
        "\x1b]0;owned\x07", "\x1b[2J\nrig: health: recovered" + "x" * 40_000
    )
    assert line.startswith(r"\x1b]0;owned\x07: \x1b[2J\nrig: health")
    assert line.isprintable()
    assert len(line) < 2 * Errors.MAX_TEXT


def test_refusals_of_a_whole_graph_are_a_page_and_not_a_log(
    screen: ErrorScreen,
) -> None:
    """360 messages without meaning, each refused by eleven nodes, would be 38 kB."""
    drawn = Nonsense(seed=27)
    nodes = {f"node_{k}": NodeHealth() for k in range(11)}
    entrances = [Entrance(None, health) for health in nodes.values()]  # type: ignore[arg-type] # no DDS is asked
    for k in range(360):
        kind = list(MESSAGES)[k % len(MESSAGES)]
        try:
            check(message := drawn.message(kind), None)
            MESSAGES[kind].read(message)
        except TwinmatchError as error:
            for entrance in entrances:
                entrance.refuse(f"/{kind.__name__}", str(error))
        for name, health in nodes.items():
            report = health.report()
            screen.take(name, report.message, bytes([report.level]))
    report = nodes["node_0"].report()
    counted = sum(map(int, report.values.values()))
    assert counted > 150
    assert sum(map(len, screen.lines)) < 5000


def test_an_error_that_comes_and_goes_hides_no_other(screen: ErrorScreen) -> None:
    """A busy machine makes inputs late again and again; then the rig is switched off."""
    for k in range(100):
        screen.take("sampler", f"input arrives every 0.1{k} s")
        screen.take("sampler", "well", DiagnosticStatus.OK)
    assert len(screen.lines) == 2 * Errors.MAX_REPEATS
    screen.take("sampler", "/heater no longer has a publisher")
    assert screen.lines[-1] == "sampler: /heater no longer has a publisher"


def test_a_flood_of_errors_ends(screen: ErrorScreen) -> None:
    for k in range(100):
        screen.take("a", "x" * k)
        screen.take("a", "well", DiagnosticStatus.OK)
    assert len(screen.lines) == Errors.MAX_LINES
    for k in range(5000):
        screen.take(f"node {'x' * k}", "error", DiagnosticStatus.ERROR)
        screen.take(f"node {'x' * k}", "well", DiagnosticStatus.OK)
    assert len(screen.lines) <= 2 * MAX_NODES * Errors.MAX_LINES


def test_a_fault_of_the_plant_is_left_to_the_verdicts(screen: ErrorScreen) -> None:
    assert not screen.take(
        "rig_a/discriminator: plant", "drive-lost: the input has no effect"
    )
    assert screen.take("boiler: plant", "it is cold") == ["boiler: plant: it is cold"]
    assert screen.take("rig_a/discriminator: health", "broken")
