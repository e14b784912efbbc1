"""The next experiment: what a published design reaches, what re-fits confirm, and what always holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import max_len_seq

from twinmatch.controllers import (
    Contender,
    ControllerError,
    ExperimentTerms,
    Holding,
    LearningGoal,
    NextExperiment,
    Staircase,
    TriedTwin,
    goal_named,
    next_experiment,
)
from twinmatch.controllers.courses import maximal_sequence, staircases_within
from twinmatch.controllers.experiment_search import (
    EFFORT,
    ExperimentSearch,
    RatedCourse,
)
from twinmatch.controllers.learning_goals import ENOUGH
from twinmatch.controllers.next_experiment import NEARLY
from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
    sensitivities,
    simulate_driven,
)
from twinmatch.signals import FloatArray

ROOM = 22.2
PERIOD = 6.0
STEPS = 150
NOISE = 0.5
"""°C, s, samples, °C: the published information divides by 0.25, the sensor's deviation, not its square."""
NOMINAL = np.array(
    [0.0417051733576387, 0.009440714239773074, 0.1659093525658045, 5.8357556063605465]
)
PUBLISHED = np.array(
    [
        [517225.409, 1360.013, -66404.725, -1002.473],
        [1360.013, 5004.374, 12379.266, 5238.404],
        [-66404.725, 12379.266, 65481.169, 14190.015],
        [-1002.473, 5238.404, 14190.015, 5526.944],
    ]
)
"""Information of the published sine test (pyomo-doe, `doe_optimize`), scaled by the nominal parameters."""
OPTIMUM = 14.56
"""log₁₀ det of the published D-optimal next experiment with that test."""
ALL = ("Ua", "Ub", "inv_CpH", "inv_CpS")
FREE = ("Ua", "inv_CpH", "inv_CpS")
"""A transfer function of the second order without a zero has three coefficients: only three
parameters can be recovered."""
SINE = np.round(
    50.0 + 50.0 * np.sin(2.0 * np.pi * PERIOD * np.arange(1, STEPS + 1) / 300.0)
)


class TwoStateLab(Plant, name="two_state_lab"):
    """A heater and its sensor, as published."""

    title = "two-state lab"
    temperature = Output(unit="°C", noise=NOISE, span=(0.0, 85.0), safe=(0.0, 85.0))
    heater = Drive(unit="%", limits=(0.0, 100.0), noise=1.0)
    body = State(unit="°C", span=(0.0, 85.0))
    probe = State(unit="°C", span=(0.0, 85.0))
    Ua = Parameter(
        unit="W/K",
        default=NOMINAL[0],
        bounds=(0.001, 1.0),
        positive=True,
        role="losses",
    )
    Ub = Parameter(unit="W/K", default=NOMINAL[1], bounds=(0.001, 1.0), positive=True)
    inv_CpH = Parameter(  # noqa: N815
        unit="K/J", default=NOMINAL[2], bounds=(0.01, 10.0), positive=True
    )
    inv_CpS = Parameter(  # noqa: N815
        unit="K/J", default=NOMINAL[3], bounds=(0.1, 100.0), positive=True
    )
    structures = {"two": Structure(free=ALL)}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """Energy of the heater and of the sensor."""
        across = self.Ub * (self.body - self.probe)
        heat = self.Ua * (ROOM - self.body) - across + 0.00016 * 200.0 * self.heater
        return Equations(
            rates={self.body: heat * self.inv_CpH, self.probe: across * self.inv_CpS},
            output=self.probe,
            start={self.body: self.temperature, self.probe: self.temperature},
        )


def readings(values: FloatArray, u: FloatArray) -> FloatArray:
    """The published discretisation, backward Euler, apart from all plant files: sensor at every 6 s."""
    ua, ub, body, probe = values
    slopes = np.array([[-(ua + ub) * body, ub * body], [ub * probe, -ub * probe]])
    step = np.linalg.inv(np.eye(2) - PERIOD * slopes)
    temperatures = np.zeros(2)
    probe_readings = [0.0]
    for command in u:
        temperatures = step @ (
            temperatures + PERIOD * np.array([0.00016 * 200.0 * command * body, 0.0])
        )
        probe_readings.append(temperatures[1])
    return ROOM + np.array(probe_readings)


def information(u: FloatArray) -> FloatArray:
    """Its information on the parameters, scaled by them, by central differences."""
    columns = [
        (readings(NOMINAL + d, u) - readings(NOMINAL - d, u)) / 2e-5
        for d in 1e-5 * np.diag(NOMINAL)
    ]
    slopes = np.array(columns) / NOISE
    return slopes @ slopes.T


def log_det(matrix: FloatArray) -> float:
    return float(np.linalg.slogdet(matrix)[1] / np.log(10.0))


def lab(
    covariance: FloatArray | None, free: Sequence[str] = FREE, **values: float
) -> TriedTwin:
    parameters = TwoStateLab.model().parameters(**values)
    return TriedTwin(
        "lab", parameters, tuple(free), covariance, np.full(2, ROOM), np.zeros(1)
    )


def terms(high: float = 85.0, size: int = STEPS) -> ExperimentTerms:
    level = np.array([ROOM])
    ends = np.array([[0.0], [high]])
    return ExperimentTerms(
        Holding(None, PERIOD, 100), level, size, np.array([[0.0], [100.0]]), ends, 0.0
    )


def known_to(share: float) -> FloatArray:
    """Parameters known to such a share of their values."""
    return np.diag((share * NOMINAL[[0, 2, 3]]) ** 2)


@pytest.fixture(scope="module")
def experiment() -> NextExperiment:
    member = lab(known_to(0.1))
    return next_experiment(
        [member], goal_named("parameters", [member], terms(200.0)), terms(200.0)
    )


def test_the_sine_test_tells_as_much_as_was_published() -> None:
    """The three eigenvalues that the readings determine are within 2 % (the recorded commands are a little
    late); the fourth, 0.016 beside 527 000, is an error of the published derivatives: it is zero."""
    ours, published = (
        np.linalg.eigvalsh(matrix) for matrix in (information(SINE), PUBLISHED)
    )
    assert ours[1:] == pytest.approx(published[1:], rel=0.02)
    assert log_det(PUBLISHED) == pytest.approx(12.31, abs=0.01)
    assert abs(ours[0]) < 1e-6


def test_tangents_are_those_of_the_simulation() -> None:
    """Beside central differences, whose error is a few millionths here."""
    twin = lab(None, ALL)
    start = np.full(2, ROOM)

    def read(name: str, way: float) -> FloatArray:
        moved = twin.parameters.replace(**{name: twin.parameters[name] * (1.0 + way)})
        return simulate_driven(moved, SINE, states=start, period=PERIOD).output

    still = np.zeros((STEPS, 0))
    outputs, tangents = sensitivities(
        twin.parameters, ALL, SINE[:, None], start, period=PERIOD, disturbances=still
    )
    assert np.array_equal(outputs[:, 0], read("Ua", 0.0))
    for k, name in enumerate(ALL):
        slope = (read(name, 1e-4) - read(name, -1e-4)) / 2e-4
        assert tangents[:, 0, k] * twin.parameters[name] == pytest.approx(
            slope, abs=1e-5 * np.abs(slope).max()
        )


def test_the_next_experiment_reaches_the_published_optimum() -> None:
    """With the published information as prior; a part of the published 14.56 is that error, see above."""
    member = lab(np.outer(NOMINAL, NOMINAL) * np.linalg.inv(PUBLISHED), ALL)
    best = next_experiment(
        [member], goal_named("parameters", [member], terms()), terms()
    )
    reached = log_det(PUBLISHED) + 2.0 * best.most * np.log10(2.0)
    assert reached == pytest.approx(OPTIMUM, abs=0.06)
    assert best.course.bits >= NEARLY * best.most
    assert len(best.course.rows) < STEPS


def test_it_tells_more_than_a_step_and_keeps_to_the_range(
    experiment: NextExperiment,
) -> None:
    """In as much time, and no band leaves the range."""
    assert experiment.course.within
    step, binary, nothing = experiment.others
    assert experiment.course.bits > max(binary.bits, nothing.bits)
    assert experiment.course.bits > step.bits or not step.within
    # at rest in the room nothing shows
    assert nothing.bits == pytest.approx(0.0, abs=1e-9)


def test_the_spread_after_it_is_as_predicted(experiment: NextExperiment) -> None:
    """Twelve labs drawn from the prior, recorded over the course with noise and fitted again, prior included:
    the RMS of 36 errors scatters by 12 %; the courses bend, so a factor of 2 is allowed."""
    rng = np.random.default_rng(4)
    twin = lab(known_to(0.1))
    rows = experiment.course.rows
    centre = NOMINAL[[0, 2, 3]]
    errors = []

    def read(values: FloatArray) -> FloatArray:
        varied = twin.parameters.replace(
            **dict(zip(FREE, values.tolist(), strict=True))
        )
        return simulate_driven(
            varied, rows, states=np.full(2, ROOM), period=PERIOD
        ).output

    for _ in range(12):
        true = centre * (1.0 + 0.1 * rng.standard_normal(3))
        recorded = read(true) + NOISE * rng.standard_normal(len(rows))

        def misses(scaled: FloatArray, measured: FloatArray = recorded) -> FloatArray:
            return np.concatenate(
                [(read(centre * scaled) - measured) / NOISE, (scaled - 1.0) / 0.1]
            )

        fit = least_squares(misses, np.ones(3), bounds=(0.3, 3.0))
        errors.append((centre * fit.x - true) / experiment.course.spreads)
    ratios = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ((ratios > 0.5) & (ratios < 2.0)).all()


def test_more_time_never_tells_less_and_information_adds() -> None:
    """At every mark, of parameters and of pairs; a better known plant has less to tell."""
    twins = [lab(known_to(0.2)), lab(known_to(0.1), Ua=0.05)]
    pair = LearningGoal("pair", tuple(map(Contender, twins)), pairs=True)
    for goal in (goal_named("parameters", twins, terms()), pair):
        curve = ExperimentSearch(twins, goal, terms(1e3)).curve(
            Staircase((1.0, 0.2), (0.3, 1.0), 0)
        )
        assert curve is not None
        assert (np.diff(curve) >= -1e-9).all()
        assert curve[-1] > 0.0
    less_known = lab(known_to(0.2))
    better_known = lab(known_to(0.1))
    ends = []
    for twin in (less_known, better_known):
        search = ExperimentSearch(
            [twin], goal_named("parameters", [twin], terms()), terms(1e3)
        )
        curve = search.curve(Staircase((1.0,), (1.0,), 0))
        assert curve is not None
        ends.append(curve[-1])
    assert ends[0] > ends[1]


@pytest.mark.parametrize("level", [40.0, 60.0])
def test_a_weak_drive_and_grown_losses_are_parted(level: float) -> None:
    """At rest they leave one mark: doing nothing tells nothing of them, and the course decides. At 60 °C four
    times the losses could not be held, at 40 °C they could."""
    warm = replace(lab(known_to(0.02)), states=None)
    asked = replace(terms(200.0), before=np.array([level]))
    best = next_experiment([warm], goal_named("fault", [warm], asked), asked)
    assert best.course.bits >= NEARLY * ENOUGH
    assert best.course.within
    assert best.others[-1].name == "nothing"
    assert best.others[-1].bits < 0.01 * ENOUGH


def test_what_cannot_be_asked_is_said() -> None:
    """One line each."""
    exact = lab(None)
    for goal, words in {
        "structure": "all twins have the structure",
        "parameters": "no twin leaves a parameter open",
        "controller": "give --loop FILE",
    }.items():
        with pytest.raises(ControllerError, match=words):
            goal_named(goal, [exact], terms())
    member = lab(known_to(0.2))
    with pytest.raises(ControllerError, match="no course keeps the bands"):
        next_experiment(
            [member], goal_named("parameters", [member], terms(22.0)), terms(22.0)
        )


def test_the_binary_sequence_is_the_maximal_one() -> None:
    np.testing.assert_array_equal(maximal_sequence(), max_len_seq(5)[0])


def test_no_course_of_the_table_is_run_twice_on_all_twins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rated: list[Staircase] = []
    rate = ExperimentSearch.rated

    def recorded(
        search: ExperimentSearch, staircase: Staircase, *, leaders: bool = False
    ) -> RatedCourse | None:
        if not leaders:
            rated.append(staircase)
        return rate(search, staircase, leaders=leaders)

    monkeypatch.setattr(ExperimentSearch, "rated", recorded)
    asked = terms(1e3)
    twins = [lab(known_to(0.2)), lab(known_to(0.1), Ua=0.05)]
    next_experiment(twins, goal_named("parameters", twins, asked), asked)
    table = set(staircases_within(asked))
    of_table = [staircase for staircase in rated if staircase in table]
    assert len(of_table) >= EFFORT.few
    assert len(of_table) == len(set(of_table))


def test_the_root_of_what_is_open_is_computed_once() -> None:
    contender = Contender(lab(known_to(0.2)))
    assert contender.root is contender.root
