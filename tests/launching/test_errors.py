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


class Told:
    """What is shown of reports."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._errors = Errors(lambda text, _: self.lines.append(text))

    def take(self, name: str, message: str, level: bytes = DiagnosticStatus.ERROR) -> list[str]:
        """Take a report; returns the new lines."""
        before = len(self.lines)
        status = DiagnosticStatus(level=level, name=name, message=message)
        self._errors.take(DiagnosticArray(status=[status]))
        return self.lines[before:]


@pytest.fixture
def told() -> Iterator[Told]:
    return Told()


def test_an_error_is_shown_once_while_it_stands(told: Told) -> None:
    assert told.take("a: health", "no image for 3 s") == ["a: health: no image for 3 s"]
    assert told.take("a: health", "no image for 4 s") == []
    assert told.take("a: health", "working", DiagnosticStatus.OK) == ["a: health: recovered"]
    assert told.take("a: health", "no image for 3 s") == ["a: health: no image for 3 s"]


def test_of_a_report_only_what_is_new_is_shown_and_of_several_nodes_the_first(told: Told) -> None:
    first = "refused: /s: sample 3 has 0 outputs; give one"
    second = "refused: /s: its time is negative"
    assert told.take("a: health", first) == [f"a: health: {first}"]
    assert told.take("a: health", f"{first}; {second}") == [f"a: health: {second}"]
    assert told.take("b: health", f"{second}; {first}") == []
    assert told.take("b: health", f"{second}; refused: /c: x") == ["b: health: refused: /c: x"]


def test_what_is_shown_is_one_printable_line_of_bounded_length(told: Told) -> None:
    [line] = told.take("\x1b]0;owned\x07", "\x1b[2J\nrig: health: recovered" + "x" * 40_000)
    assert line.startswith(r"\x1b]0;owned\x07: \x1b[2J\nrig: health")
    assert line.isprintable()
    assert len(line) < 2 * Errors.MAX_TEXT


def test_refusals_of_a_whole_graph_are_a_page_and_not_a_log(told: Told) -> None:
    """1,152 messages without meaning, each refused by eleven nodes, were 123 kB."""
    drawn = Nonsense(seed=27)
    nodes = {f"node_{k}": NodeHealth() for k in range(11)}
    entrances = [Entrance(None, health) for health in nodes.values()]  # type: ignore[arg-type] # no DDS is asked
    for k in range(1152):
        kind = list(MESSAGES)[k % len(MESSAGES)]
        try:
            check(message := drawn.message(kind), None)
            MESSAGES[kind].read(message)
        except TwinmatchError as error:
            for entrance in entrances:
                entrance.refuse(f"/{kind.__name__}", str(error))
        for name, health in nodes.items():
            report = health.report()
            told.take(name, report.message, bytes([report.level]))
    counted = sum(int(value) for value in entrances[0]._health.report().values.values())
    assert counted > 500
    assert sum(map(len, told.lines)) < 5000


def test_an_error_that_comes_and_goes_hides_no_other(told: Told) -> None:
    """A busy machine makes inputs late again and again; then the rig is switched off."""
    for k in range(100):
        told.take("sampler", f"input arrives every 0.1{k} s")
        told.take("sampler", "well", DiagnosticStatus.OK)
    assert len(told.lines) == 2 * Errors.MAX_REPEATS
    told.take("sampler", "/heater no longer has a publisher")
    assert told.lines[-1] == "sampler: /heater no longer has a publisher"


def test_a_flood_of_errors_ends(told: Told) -> None:
    for k in range(100):
        told.take("a", "x" * k)
        told.take("a", "well", DiagnosticStatus.OK)
    assert len(told.lines) == Errors.MAX_LINES
    for k in range(5000):
        told.take(f"node {'x' * k}", "error", DiagnosticStatus.ERROR)
        told.take(f"node {'x' * k}", "well", DiagnosticStatus.OK)
    assert len(told.lines) <= 2 * MAX_NODES * Errors.MAX_LINES


def test_a_fault_of_the_plant_is_left_to_the_verdicts(told: Told) -> None:
    assert not told.take("rig_a/discriminator: plant", "drive-lost: the input has no effect")
    assert told.take("boiler: plant", "it is cold") == ["boiler: plant: it is cold"]
    assert told.take("rig_a/discriminator: health", "broken")
