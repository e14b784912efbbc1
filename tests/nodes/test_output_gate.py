"""The gate between threads: what passes follows from stamps and clocks, whichever of them misbehaves."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import pytest
from rclpy.clock import ROSClock
from rclpy.time import Time
from rclpy.time_source import TimeSource

from twinmatch.nodes.fields import MessageError
from twinmatch.nodes.gated import EVERY_MOVE, ClockTimes, OutputGate
from twinmatch.nodes.tclab_bridge import TCLabBridge
from twinmatch.safety import FaultKind, GuardLimits, OutputGuard

SECOND = 1_000_000_000
DAY = 86_400 * SECOND


class Clocks:
    """Three clocks that a test sets."""

    def __init__(
        self, stamps: float = 1000.0, plant: float = 1000.0, wall: float = 50.0
    ) -> None:
        self.times = ClockTimes(
            round(stamps * SECOND), round(plant * SECOND), round(wall * SECOND)
        )

    def __call__(self) -> ClockTimes:
        return self.times

    def step(
        self, stamps: float, plant: float | None = None, wall: float | None = None
    ) -> None:
        """Let the clocks continue by so many seconds; all alike if only one number is given."""
        moves = (
            stamps,
            stamps if plant is None else plant,
            stamps if wall is None else wall,
        )
        self.times = ClockTimes(
            *(
                reading + round(seconds * SECOND)
                for reading, seconds in zip(self.times, moves, strict=True)
            )
        )

    @property
    def stamp(self) -> int:
        return self.times.stamps


def armed_gate() -> tuple[Clocks, OutputGate]:
    clocks = Clocks()
    gate = OutputGate(clocks)
    gate.decide()
    clocks.step(0.1)
    gate.command(120.0, 7, clocks.stamp)
    gate.temperature(25.0, clocks.stamp)
    decision = gate.decide()
    assert decision[:3] == ((120.0,), True, 7)
    return clocks, gate


def kind_of(gate: OutputGate) -> FaultKind | None:
    return None if gate.fault is None else gate.fault.kind


def test_simulated_time_that_moves_wakes_who_waits_at_the_gate() -> None:
    gate = OutputGate(Clocks())
    clock = ROSClock()
    source = TimeSource()
    source.attach_clock(clock)
    source.ros_time_is_active = True
    moves = clock.create_jump_callback(EVERY_MOVE, post_callback=gate.wake)
    driver = threading.Thread(target=gate.wait, args=(1e6,), daemon=True)
    driver.start()
    for k in range(1, 10_000):  # it may not wait yet
        clock.set_ros_time_override(Time(nanoseconds=k, clock_type=clock.clock_type))
        driver.join(0.001)
        if not driver.is_alive():
            break
    moves.unregister()
    assert not driver.is_alive()


def test_age_is_that_of_the_stamp_not_of_the_arrival() -> None:
    clocks = Clocks()
    gate = OutputGate(clocks)
    gate.decide()
    clocks.step(0.1)
    gate.command(120.0, 0, clocks.stamp)
    gate.temperature(25.0, clocks.stamp - round(3.1 * SECOND))
    assert not gate.decide().armed
    gate.temperature(25.0, clocks.stamp - round(2.9 * SECOND))
    assert gate.decide().armed
    for _ in range(2):
        clocks.step(0.1)
        gate.command(120.0, 0, clocks.stamp)
        gate.decide()
    assert kind_of(gate) is FaultKind.TEMPERATURE_STALE


@pytest.mark.parametrize("stamp", [0, DAY * 100_000], ids=["none", "future"])
def test_a_command_with_a_foreign_stamp_buys_no_time(stamp: int) -> None:
    clocks, gate = armed_gate()
    gate.command(130.0, 8, stamp)
    clocks.step(0.99)
    gate.temperature(25.0, clocks.stamp)
    assert gate.decide().armed
    clocks.step(0.02)
    gate.decide()
    assert kind_of(gate) is FaultKind.COMMAND_SILENT


def test_a_simulated_clock_that_jumps_back_buys_no_time() -> None:
    clocks, gate = armed_gate()
    clocks.step(0.6)
    assert gate.decide().armed
    clocks.step(-900.0, -900.0, 0.0)
    assert gate.decide().armed
    clocks.step(0.3)
    gate.command(120.0, 7, clocks.stamp + 900 * SECOND)  # sent before the jump
    clocks.step(0.3)
    assert gate.decide().armed  # it did come just now, whatever its stamp says
    clocks.step(0.8)
    gate.decide()
    assert kind_of(gate) is FaultKind.COMMAND_SILENT


def test_a_standing_clock_closes_the_gate_by_the_wall_clock() -> None:
    clocks, gate = armed_gate()
    clocks.step(0.0, 0.0, 0.9)
    gate.command(120.0, 8, clocks.stamp)
    gate.temperature(25.0, clocks.stamp)
    assert gate.decide().armed
    clocks.step(0.0, 0.0, 0.2)
    gate.command(120.0, 9, clocks.stamp)
    gate.temperature(25.0, clocks.stamp)
    assert gate.decide()[:2] == ((0.0,), False)
    assert kind_of(gate) is FaultKind.CLOCK
    clocks.step(0.1)
    assert gate.decide()[:2] == ((0.0,), False)  # it latched


def test_nothing_is_armed_before_the_clock_has_moved_and_that_is_not_a_fault() -> None:
    clocks = Clocks(0.0, 0.0)
    gate = OutputGate(clocks)
    for _ in range(30):
        gate.command(120.0, 0, clocks.stamp)
        gate.temperature(25.0, clocks.stamp)
        assert gate.decide()[:2] == ((0.0,), False)
        clocks.step(0.0, 0.0, 0.1)
    assert gate.clock_stopped
    assert gate.fault is None
    clocks.step(500.0, 500.0, 0.1)  # the first word of /clock
    gate.decide()
    gate.command(120.0, 0, clocks.stamp)
    gate.temperature(25.0, clocks.stamp)
    assert gate.decide().armed


def test_deadlines_are_in_the_plants_time() -> None:
    """A tenth of a wall second is too long for a rig that runs twenty times as fast."""
    clocks, gate = armed_gate()
    clocks.step(2.0, 2.0, 0.1)
    gate.decide()
    assert kind_of(gate) is FaultKind.COMMAND_SILENT


def test_an_input_wakes_who_waits() -> None:
    clocks, gate = armed_gate()
    woken = threading.Event()

    def wait() -> None:
        gate.wait(60.0)
        woken.set()

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    while not woken.wait(0.01):
        gate.command(10.0, 8, clocks.stamp)
    thread.join(10)
    assert not thread.is_alive()


def armed_pair() -> tuple[Clocks, OutputGate]:
    """The gate of two drives, of which nothing is known but their names."""
    clocks = Clocks()
    limits = (GuardLimits(thing="left plate"), GuardLimits(thing="right plate"))
    gate = OutputGate(
        clocks, [OutputGuard(limits_of_drive) for limits_of_drive in limits]
    )
    gate.decide()
    clocks.step(0.1)
    gate.command((120.0, 80.0), 7, clocks.stamp)
    assert gate.decide()[:2] == ((0.0, 0.0), False)  # no temperature of either
    gate.temperature((25.0, 30.0), clocks.stamp)
    assert gate.decide()[:3] == ((120.0, 80.0), True, 7)
    return clocks, gate


@pytest.mark.parametrize(
    ("spoil", "kind", "text"),
    [
        (
            lambda gate, now: gate.command((120.0, math.nan), 8, now),
            "command_invalid",
            "right plate is nan",
        ),
        (
            lambda gate, now: gate.command((900.0, 80.0), 8, now),
            "command_invalid",
            "left plate is 900",
        ),
        (
            lambda gate, now: gate.command(120.0, 8, now),
            "command_invalid",
            "1 values for 2 drives",
        ),
        (
            lambda gate, now: gate.temperature((25.0, 111.0), now),
            "over_temperature",
            "the right plate is at",
        ),
        (
            lambda gate, now: gate.temperature((math.nan, 30.0), now),
            "temperature_invalid",
            "nan",
        ),
        (lambda gate, _: gate.sample((90.0,) * 2, (25.0, 30.0), (255.0, 0.0)), "", ""),
        (lambda gate, _: gate.trip(FaultKind.LINK, "gone"), "link", "gone"),
    ],
)
def test_what_is_wrong_with_either_drive_puts_both_to_zero(
    spoil: Callable[[OutputGate, int], None], kind: str, text: str
) -> None:
    clocks, gate = armed_pair()
    clocks.step(0.1)
    spoil(gate, clocks.stamp)
    if not kind:  # a tick of the loops alone ends nothing
        assert gate.decide().inputs == (120.0, 80.0)
        return
    assert gate.decide()[:2] == ((0.0, 0.0), False)
    fault = gate.fault
    assert fault is not None
    assert (fault.kind.value, text in fault.message) == (kind, True)
    gate.command((120.0, 80.0), 9, clocks.stamp)
    gate.temperature((25.0, 30.0), clocks.stamp)
    assert gate.decide()[:2] == ((0.0, 0.0), False)
    assert gate.fault is fault
    gate.clear()
    gate.command((1.0, 2.0), 10, clocks.stamp)
    gate.temperature((25.0, 30.0), clocks.stamp)
    assert gate.decide().inputs == (1.0, 2.0)


def test_a_sample_of_other_size_is_refused() -> None:
    _, gate = armed_pair()
    with pytest.raises(MessageError, match="it has 1 values for 2 drives"):
        gate.sample((30.0,), (25.0,), (0.0,))


def test_a_limit_is_that_of_its_drive() -> None:
    """Sensor 2 stays cold while heater 2 is at full power; heater 1 keeps its command."""
    clocks = Clocks()
    gate = OutputGate(clocks, TCLabBridge.guards_of_both(TCLabBridge.LIMITS))
    applied = []
    for second in range(200):
        gate.command((10.0, 100.0), second, clocks.stamp)
        gate.temperature((25.0 + 0.02 * second, 25.0), clocks.stamp)
        gate.sample((30.0, 30.0), (25.0, 25.0), (10.0, 0.0))
        applied.append(gate.decide().inputs)
        clocks.step(1.0)
        if gate.fault is not None:
            break
    assert gate.fault is not None
    assert gate.fault.kind is FaultKind.LIMITED
    assert "the second heater is at" in gate.fault.message
    assert applied[-1][0] == 10.0
    assert 0.0 < applied[-1][1] < 100.0
