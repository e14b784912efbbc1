"""What the chain of a dead time shifts: truth is recovered by the intervals, and nothing else is touched."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.plants import Exchanger
from twinmatch.dynamics import (
    DeadTime,
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
    law_for,
)
from twinmatch.fitting import GateLimits, Match, match
from twinmatch.fitting.approximation import shift_by_dead_times
from twinmatch.fitting.estimation import profile_intervals
from twinmatch.fitting.problem import Noise, Problem
from twinmatch.signals import FloatArray, Window

PERIOD = 5.0


class Room(Plant, name="room_behind_a_pipe"):
    """A room whose heater acts late."""

    parts = ("dead time",)
    temperature = Output(unit="°C", noise=0.1, span=(-10.0, 100.0), absolute=273.15)
    heater = Drive(unit="", limits=(0.0, 1.0), noise=0.01)
    inner = State(unit="°C", span=(-10.0, 100.0))
    pipe = DeadTime(unit="", span=(0.0, 1.0))
    gain = Parameter(unit="K", default=40.0, bounds=(2.0, 800.0))
    lag = Parameter(unit="s", default=340.0, bounds=(17.0, 6800.0), positive=True)
    rest = Parameter(
        unit="°C", default=28.0, bounds=(-10.0, 100.0), scale=11.0, relative=False
    )
    delay = Parameter(unit="s", default=34.0, bounds=(3.0, 340.0), positive=True)
    structures = {  # noqa: RUF012
        "late": Structure(
            free=("gain", "lag", "rest", "delay"),
            parts=frozenset({"dead time"}),
            free_starts=("pipe_0", "pipe_1"),
        ),
        "at once": Structure(free=("gain", "lag", "rest")),
    }

    def equations(self, parts: frozenset[str]) -> Equations:
        """One lag, and a pipe before it."""
        arrives = self.pipe.after(self.heater, self.delay)
        is_late = "dead time" in parts
        acts = arrives.value if is_late else self.heater
        rates = dict(arrives.rates) if is_late else {}
        start = dict(arrives.start) if is_late else {}
        rates[self.inner] = (self.rest + self.gain * acts - self.inner) / self.lag
        start[self.inner] = self.temperature
        return Equations(rates=rates, output=self.inner, start=start)


def switched(
    delay: float, hysteresis: float, rows: int, rest: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Readings and switch of a thermostat: gain 60, lag 400 s, rest 20 °C, and an exact dead time, s.

    Args:
        delay: the dead time, s.
        hysteresis: half of it, °C.
        rows: how many samples.
        rest: samples before it is switched on for the first time.
    """
    random = np.random.default_rng(7)
    within = 20
    pole = np.exp(-PERIOD / within / 400.0)
    commands = [0.0] * round(delay * within / PERIOD)
    temperature = 20.0
    is_on = False
    readings = []
    switch = []
    for row in range(rows):
        reading = round(temperature + 0.06 * random.standard_normal(), 2)
        is_on = reading < 45.0 + (hysteresis if is_on else -hysteresis)
        is_on = is_on and row >= rest
        readings.append(reading)
        switch.append(float(is_on))
        for _ in range(within):
            commands.append(float(is_on))
            goal = 20.0 + 60.0 * commands.pop(0)
            temperature = goal + (temperature - goal) * pole
    return np.array(readings), np.array(switch)


def matched(readings: FloatArray, switch: FloatArray) -> Match:
    """A match of a window of a thermostat."""
    window = Window(readings, readings, switch, period=PERIOD)
    return match(window, start=Room.model("late").parameters(), law=None)


@pytest.mark.parametrize(
    ("delay", "hysteresis"), [(20.0, 0.3), (40.0, 1.0), (62.0, 1.0), (120.0, 0.3)]
)
def test_the_intervals_of_a_switched_plant_hold_the_truth(
    delay: float, hysteresis: float
) -> None:
    """In its cycles alone gain and lag are shifted by a sixth, and what is left is hardly more than noise."""
    readings, switch = switched(delay, hysteresis, rows=780)
    result = matched(readings[300:], switch[300:])
    truth = {"gain": 60.0, "lag": 400.0, "rest": 20.0}
    for name, value in truth.items():
        low, high = result.intervals[result.free.index(name)]
        assert low <= value <= high, result.determined
    if delay >= 40.0:
        gain = result.free.index("gain")
        # the shift that is reported is the one that was made, not a margin that holds everything
        assert result.parameters["gain"] < 55.0
        assert result.intervals[gain, 1] < 80.0
        assert "as the dead time is approximated" in result.determined
        assert "rest it before the first switching" in result.determined


def test_after_a_rest_nothing_is_shifted_that_counts() -> None:
    readings, switch = switched(40.0, 1.0, rows=480, rest=60)
    result = matched(readings, switch)
    low, high = result.intervals[result.free.index("gain")]
    assert low <= 60.0 <= high
    assert high - low < 1.0
    assert {"gain", "lag", "rest", "delay"} <= set(result.believed)
    assert "approximated" not in result.determined


def test_a_plant_without_a_dead_time_keeps_its_intervals() -> None:
    """Nothing is approximated where there is no chain, or where the twin's own loop drives it."""
    readings, switch = switched(5.0, 1.0, rows=300)
    window = Window(readings, readings, switch, period=PERIOD)
    start = Room.model("at once").parameters()
    found = match(window, start=start, law=None)
    problem = Problem(window, start.model.structure.free, start, Noise.of(Room), None)
    values = problem.values_of(found.parameters)
    assert not shift_by_dead_times(problem, values).any()
    without = profile_intervals(problem, values, found.covariance)
    np.testing.assert_array_equal(found.intervals, without)
    assert "approximated" not in found.determined


def test_equations_without_a_dead_time_are_not_derived_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """That takes SymPy, whose import is a large part of a short replay."""
    asked: list[frozenset[str]] = []

    def counted(plant: Plant, parts: frozenset[str]) -> Equations:
        asked.append(parts)
        return plant.equations(parts)

    place = "twinmatch.fitting.approximation.written_equations"
    readings, switch = switched(5.0, 1.0, rows=100)
    window = Window(readings, readings, switch, period=PERIOD)

    class Hall(Room, name="hall_behind_a_pipe"):
        """Of which nothing has been asked."""

        pipe = DeadTime(unit="", span=(0.0, 1.0))

    for structure in ("at once", "late"):
        start = Hall.model(structure).parameters()
        free = start.model.structure.free
        problem = Problem(window, free, start, Noise.of(Hall), None)
        values = problem.values_of(start)
        problem.evaluate(values)
        with monkeypatch.context() as patched:
            patched.setattr(place, counted)
            shift_by_dead_times(problem, values)
    assert asked == [frozenset({"dead time"})]


class Annex(Room, name="annex_behind_a_pipe"):
    """A room whose class inherits the pipe."""


class Halves(Room, name="room_behind_two_pipes"):
    """A room with two heaters, each behind a pipe with the same dead time: one is declared here, one inherited."""

    second_heater = Drive(unit="", limits=(0.0, 1.0), noise=0.01)
    second_pipe = DeadTime(unit="", span=(0.0, 1.0))
    structures = {  # noqa: RUF012
        "late": Structure(
            free=("gain", "lag", "rest", "delay"),
            parts=frozenset({"dead time"}),
            free_starts=("pipe_0", "pipe_1", "second_pipe_0", "second_pipe_1"),
        )
    }

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """Each heater gives half of the heat."""
        first = self.pipe.after(self.heater, self.delay)
        second = self.second_pipe.after(self.second_heater, self.delay)
        heat = self.gain * (first.value + second.value) / 2
        rates = {**first.rates, **second.rates}
        rates[self.inner] = (self.rest + heat - self.inner) / self.lag
        start = {**first.start, **second.start, self.inner: self.temperature}
        return Equations(rates=rates, output=self.inner, start=start)


def shift_of(plant: type[Plant], window: Window) -> FloatArray:
    """What the chains of a plant near the truth shift."""
    near_truth = {"gain": 55.0, "lag": 380.0, "rest": 20.0, "delay": 42.0}
    start = plant.model("late").parameters(**near_truth)
    free = start.model.structure.free
    problem = Problem(window, free, start, Noise.of(plant), None)
    return shift_by_dead_times(problem, problem.values_of(start))


def test_a_dead_time_that_a_class_inherits_shifts_as_its_own_does() -> None:
    readings, switch = switched(40.0, 1.0, rows=480)
    window = Window(readings, readings, switch, period=PERIOD)
    shift = shift_of(Room, window)
    assert shift.all()
    np.testing.assert_array_equal(shift_of(Annex, window), shift)


def test_drives_with_one_dead_time_are_all_delayed_by_it() -> None:
    """Two heaters that give half of the heat each, and switch together, are one heater."""
    readings, switch = switched(40.0, 1.0, rows=480)
    window = Window(readings, readings, switch, period=PERIOD)
    both = Window(readings, readings, np.stack([switch, switch], 1), period=PERIOD)
    # rounding alone distinguishes them
    np.testing.assert_allclose(
        shift_of(Halves, both)[:4], shift_of(Room, window)[:4], rtol=1e-6, atol=1e-8
    )


def test_in_a_known_loop_nothing_is_shifted() -> None:
    """The twin's own inputs go through the same chain as the loop that was fitted."""
    readings, _ = switched(5.0, 1.0, rows=100)
    inlet = np.full((100, 1), 20.0)
    window = Window(readings, readings, readings, disturbances=inlet)
    start = Exchanger.model("with pipe").parameters()
    problem = Problem(
        window,
        start.model.structure.free,
        start,
        Noise.of(Exchanger),
        law_for(Exchanger, 1.0),
    )
    assert not shift_by_dead_times(problem, problem.values_of(start)).any()


def test_where_nothing_switches_an_approximation_shifts_nothing() -> None:
    """What changes slowly has no corners to be rounded off: intervals stay as the noise makes them."""
    smooth = 0.5 - 0.5 * np.cos(np.arange(480) / 60.0)
    readings, _ = switched(40.0, 1.0, rows=480)
    window = Window(readings, readings, smooth, period=PERIOD)
    parameters = Room.model("late").parameters(
        gain=60.0, lag=400.0, rest=20.0, delay=42.0
    )
    problem = Problem(
        window, parameters.model.structure.free, parameters, Noise.of(Room), None
    )
    shift = shift_by_dead_times(problem, problem.values_of(parameters))
    assert abs(shift[0]) < 0.1
    assert abs(shift[1]) < 1.0


def test_what_is_on_its_way_at_the_start_refuses_no_longer_window() -> None:
    """In a long window the parameters are known ever better, and what was on its way at its start is not."""
    readings, switch = switched(40.0, 1.0, rows=960)
    result = matched(readings, switch)
    assert result.condition > GateLimits().condition
    assert result.accepted, result.reason
    assert result.parameters["gain"] == pytest.approx(60.0, rel=0.05)
