"""An output in which a drive acts at once: the voltage of a cell under a current."""

from __future__ import annotations

import numpy as np
import pytest

from twinmatch.dynamics import (
    Drive,
    Equations,
    Foresight,
    Observer,
    Output,
    Parameter,
    PidGains,
    Plant,
    PlantError,
    State,
    Structure,
    begin,
    linearised_at,
    simulate_closed_loop,
    simulate_driven,
)
from twinmatch.fitting import match
from twinmatch.health import Fault, HealthSettings, Monitor
from twinmatch.signals import Sample, Window


class Cell(Plant, name="cell_at_once"):
    """Open-circuit voltage, a resistance, and an RC pair."""

    volts = Output(unit="V", noise=0.001, span=(2.5, 4.3))
    amps = Drive(unit="A", limits=(-120.0, 60.0), noise=0.05)
    charge = State(unit="A h", span=(-5.0, 40.0))
    fast = State(unit="V", span=(-0.5, 0.5))
    slope = Parameter(default=0.022, bounds=(0.001, 0.1), positive=True)
    r = Parameter(unit="Ω", default=0.001, bounds=(0.0001, 0.02), positive=True)
    r1 = Parameter(unit="Ω", default=0.0015, bounds=(0.00005, 0.02), positive=True)
    t1 = Parameter(unit="s", default=30.0, bounds=(2.0, 200.0), positive=True)
    structures = {"one pair": Structure(free=("slope", "r", "r1", "t1"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """The resistance acts at once."""
        return Equations(
            rates={
                self.charge: self.amps / 3600,
                self.fast: (self.r1 * self.amps - self.fast) / self.t1,
            },
            output=3.45 + self.slope * self.charge + self.r * self.amps + self.fast,
            start={
                self.charge: (self.volts - 3.45 - self.r * self.amps) / self.slope,
                self.fast: 0,
            },
        )


TRUTH = Cell.model().parameters(r=0.002, r1=0.001, t1=20.0)
AMPS = np.repeat([0.0, -30.0, -60.0, 0.0, 20.0, -30.0], 60)
RUN = simulate_driven(TRUTH, AMPS, states=begin(TRUTH, 4.0), period=1.0)


def test_the_reading_moves_with_the_drive_and_begins_where_it_was_measured() -> None:
    """By R·I in the sample of the step, and by no more than the pair moves in a second beside it."""
    moved = np.diff(RUN.output)
    steps = np.diff(AMPS)
    np.testing.assert_allclose(
        moved[steps != 0.0], 0.002 * steps[steps != 0.0], atol=0.004
    )
    assert np.abs(moved[steps == 0.0]).max() < 0.004
    loaded = begin(TRUTH, 3.9, input=-30.0)
    assert simulate_driven(TRUTH, [-30.0], states=loaded, period=1.0).output[
        0
    ] == pytest.approx(3.9)


def test_a_match_finds_the_resistance_even_if_the_window_begins_under_load() -> None:
    noisy = RUN.output + np.random.default_rng(1).normal(0.0, 0.001, AMPS.size)
    window = Window(np.zeros(AMPS.size), noisy, AMPS, period=1.0).part(58, 357)
    matched = match(window, start=Cell.model().parameters(), law=None)
    # The pair is at rest in the third sample, the first of 30 A. 300 readings of 1 mV after steps of 30 to
    # 60 A: some 10 µΩ.
    assert matched.parameters["r"] == pytest.approx(0.002, abs=5e-5)
    assert matched.chi2 < 1.3


def test_what_is_held_is_what_is_forecast_and_observed() -> None:
    """As a simulation with that current from the newest sample on, with bands of the noise alone."""
    newest = 200
    observer = Observer(
        TRUTH, period=1.0, drift=[0.0, 0.0], start=[1e-6, 1e-9], states=RUN.states[0]
    )
    surprises = []
    for k in range(newest + 1):
        surprises.append(observer.correct(RUN.output[k], None, AMPS[k])[0][0])
        if k < newest:
            observer.predict(AMPS[k])
    assert np.abs(surprises).max() < 1e-9
    foresight = Foresight([(TRUTH, ())], None, drift=[[0.0, 0.0]], period=1.0)
    newest_state = foresight.at(
        [observer.states], [observer.covariance], AMPS[newest], None
    )
    forecast = foresight.ahead(newest_state, np.full(30, -30.0))
    instead = np.append(AMPS[: newest + 1], np.full(30, -30.0))
    expected = simulate_driven(TRUTH, instead, states=RUN.states[0], period=1.0).output[
        newest + 1 :
    ]
    np.testing.assert_allclose(forecast.outputs[:, 0], expected, atol=1e-9)
    np.testing.assert_allclose(
        np.sqrt(forecast.output_variances[:, 0]), 0.001, rtol=1e-3
    )


def test_its_linear_model_answers_a_command_with_the_next_reading() -> None:
    linear = linearised_at(TRUTH, begin(TRUTH, 4.0), 0.0, 1.0)
    x = np.zeros(len(linear.A))
    y = []
    for _ in range(40):
        y.append(float((linear.C @ x)[0]))
        x = linear.A @ x + linear.B @ np.array([-30.0])
    stepped = (
        simulate_driven(
            TRUTH, np.full(40, -30.0), states=begin(TRUTH, 4.0), period=1.0
        ).output
        - 4.0
    )
    # The reading before the first command; then the states of one sample, under the command that acts.
    assert y[0] == 0.0
    np.testing.assert_allclose(y[1:], stepped[1:], atol=1e-9)


def test_a_controller_that_reads_what_it_commands_is_refused() -> None:
    law = PidGains(1.0, 0.1, 0.0, 1.0, low=-10.0, high=10.0, period=1.0)
    with pytest.raises(
        PlantError,
        match="an output depends on a drive at the same instant, so a controller",
    ):
        simulate_closed_loop(TRUTH, np.full(9, 4.0), states=begin(TRUTH, 4.0), law=law)


def test_health_names_a_contactor_that_opens_as_a_lost_drive() -> None:
    """Within a minute, although most of the effect comes at once, and moves nothing from sample to sample."""
    wanted = np.resize(np.repeat([0.0, -30.0, 0.0, 20.0, 0.0, -10.0], 120), 960)
    opens = 900
    amps = np.where(np.arange(wanted.size) < opens, wanted, 0.0)
    volts = simulate_driven(TRUTH, amps, states=begin(TRUTH, 4.0), period=1.0).output
    volts = np.round(volts + np.random.default_rng(7).normal(0.0, 0.001, volts.size), 4)
    monitor = Monitor(HealthSettings.of(Cell))
    for k, (commanded, reading) in enumerate(
        zip(wanted.tolist(), volts.tolist(), strict=True)
    ):
        monitor.push(Sample(k, k * 10**9, reading, reading, commanded), TRUTH)
    *before, last = monitor.alarms
    assert last.fault is Fault.DRIVE_LOST
    assert all(
        alarm.fault is Fault.DRIFT and alarm.flagged > opens for alarm in before
    ), "not yet told apart"
