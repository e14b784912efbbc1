"""Which faults the structure of a plant cannot tell apart, from its file alone.

The plant has its typical parameters, every drive steps again and again, and then one of the faults comes for
which its health is watched. The bank of hypotheses (`dynamics.bank`) takes the readings without their noise,
in the filter whose equations err as those of a real rig do. What a hypothesis then saves of their code is
what it is expected to save of noisy ones: free parameters, states and passing offsets absorb what they absorb
beside a running plant.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from twinmatch.adding.trial import middle_of
from twinmatch.dynamics import Parameters, Plant, PlantError, begin, simulate_driven
from twinmatch.dynamics.bank import (
    BankMembers,
    ChangeTraces,
    Reading,
    spawn,
    step,
    unborn,
)
from twinmatch.dynamics.pace import usual_scale
from twinmatch.health.channels import CHANGE, LEAD
from twinmatch.health.evidence import Competition
from twinmatch.health.faults import TRAITS
from twinmatch.health.hypotheses import ChangeRow
from twinmatch.health.mixture import LEVELS
from twinmatch.health.sentences import FaultSentences
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray


class _FaultCourse(Rule):
    """The course of a trial, in s of a plant as fast as the rig."""

    before: float = 600.0
    """The plant is seen for so long before a fault that its parameters may be said to have changed."""
    after: float = 480.0
    """The fault lasts for so long; then the bank forgets when something began."""
    hold: float = 100.0
    """Time between two steps of the first drive."""
    quicker: float = 0.7
    """Time between two steps of a drive, as a share of that of the one before."""


_COURSE: Final = _FaultCourse()


_RIG: Final = int(np.flatnonzero(LEVELS == 1.0)[0])
"""Place of the model error of a real rig."""
_WAYS: Final = {
    False: "even under large steps (a sample every {:g} s)",
    True: "if they come slowly",
}
"""How faults come: at once, or slowly."""
_NINE_IN_TEN: Final = 1.28
_APART: Final = 0.5 * (_NINE_IN_TEN + math.sqrt(_NINE_IN_TEN**2 + 2.0 * LEAD)) ** 2
"""Expected lead of a fault over another, nats, from which on it is named in nine of ten runs: a name needs a
lead of `LEAD`, and noise moves one of n nats by √(2 n), the standard deviation of the log-likelihood ratio of
two normal distributions that are n apart. It is 9.6."""
_NOT_NAMED: Final = frozenset(
    fault for fault, traits in TRAITS.items() if traits.unnamed
)
"""The unknown is nobody's rival; what passes has passed when it counts."""


def confusions(plant: type[Plant], period: float | None = None) -> list[str]:
    """Sentences on the faults that a plant's health cannot tell apart, and on those that it cannot see.

    Args:
        plant: the plant; one loop is watched from its file on if that has typical parameters.
        period: sampling period, s; at least, and by default, a hundredth of the plant's time constant.
    """
    model = plant.model(plant.followed or next(iter(plant.structures)))
    watched = plant.typical or len(plant.outputs) + len(plant.drives) > 2
    if not watched or model.structure.external is not None:
        return []
    period = max(period or 0.0, usual_scale(plant))
    try:
        trial = FaultTrial(model.typical(), period)
        rivals = [(fault, trial.rivals(fault)) for fault in trial.rows]
    except PlantError:  # the other checks report it
        return []
    sentences = []
    for slowly, way in _WAYS.items():
        pairs = [
            " and ".join(sorted((trial.called[fault.number], trial.called[rival])))
            for fault, rivals_of_fault in rivals
            if bool(fault.slowly) == slowly
            for rival in rivals_of_fault or []
        ]
        if pairs:
            listed = "; ".join(dict.fromkeys(pairs))
            sentences.append(
                f"faults that cannot be told apart, {way.format(period)}: {listed}"
            )
    too_small = [
        trial.called[fault.number]
        for fault, rivals_of_fault in rivals
        if rivals_of_fault is None and not fault.slowly
    ]
    if too_small:
        listed = ", ".join(too_small)
        sentences.append(
            f"faults too small to show beside such steps, at their usual size: {listed}"
        )
    return sentences


class FaultTrial:
    """A plant under steps of its drives, and what each of its hypotheses says of a fault."""

    def __init__(self, parameters: Parameters, period: float) -> None:
        """See the healthy plant.

        Raises:
            PlantError: it cannot be simulated at this sampling period (s).
        """
        self.parameters = parameters
        self._period = period
        model = parameters.model
        self._competition = Competition(parameters, period)
        healthy = self._competition.healthy
        words = FaultSentences(model, period)
        named = [row for row in self._competition.rows if _is_of_one_number(row)]
        self.called = {row.number: words.called(row.cause) for row in named}
        """The numbers that may change, in words."""
        self.rows = _least_of_each_number(named)
        """The faults: of each number the one of the least usual size."""
        pace = min(self._competition.second, 1.0)
        before = round(_COURSE.before * pace)
        after = round(_COURSE.after * pace)
        inputs = _steps(parameters, before + after, _COURSE.hold * pace)
        states = begin(parameters, middle_of(model), input=inputs[0])
        run = simulate_driven(parameters, inputs[:before], states=states, period=period)
        shown = model.kernels.slopes_at(
            parameters.vector, states, inputs[0], model.disturbances
        )[6]
        if shown.any():
            raise PlantError(
                f"{model.title}: an output shows a drive at once, which no hypothesis expects"
            )
        self.healthy = run.outputs
        self.inputs = inputs
        self.states = run.states[-1]
        healthy.open(run.outputs[0], inputs[0], model.disturbances)
        self._members = BankMembers(*(array[[_RIG]] for array in healthy.members))
        self._members.error[:] = LEVELS[_RIG]
        self._follow(
            self._members, unborn(0, len(healthy.numbers)), run.outputs, inputs
        )

    def rivals(self, fault: ChangeRow) -> list[str] | None:
        """The numbers whose changes are not told apart from a fault; None if it is too small for a report."""
        members = BankMembers(*(array.copy() for array in self._members))
        rows = self._competition.rows
        table = self._competition.table
        traces = unborn(len(rows), members.at.shape[1])
        usual = np.zeros(self.inputs.shape[1])
        spawn(traces, table, members.at, np.zeros(1), -1.0, usual, len(self.inputs), 0)
        saved = self._follow(
            members, traces, self.readings(fault), self.inputs[len(self.healthy) :]
        )
        saved += np.log(table.mass)
        numbers = np.array(
            [row.number if _is_of_one_number(row) else "" for row in rows]
        )
        savings_by_number = {
            name: saved[:, numbers == name].max(axis=1) for name in self.called
        }
        savings_of_fault = savings_by_number.pop(fault.number)
        reported = savings_of_fault >= CHANGE
        if not reported.any():
            return None
        return [
            name
            for name, savings in savings_by_number.items()
            if (savings_of_fault - savings)[reported].max() < _APART
        ]

    def readings(self, fault: ChangeRow) -> FloatArray:
        """What is read from its beginning on, without noise, shape (N, o)."""
        parameters = self.parameters
        inputs = self.inputs[len(self.healthy) :].copy()
        size = size_of(fault)
        model = parameters.model
        healthy = self._competition.healthy
        time = np.arange(len(inputs)) * self._period / healthy.scale
        change = size * (time / fault.slowly if fault.slowly else np.ones_like(time))
        offsets = np.zeros((len(inputs), model.noise.size))
        kind, _, place = fault.number.partition(" ")
        if kind == "share":
            inputs[:, int(place)] += (
                inputs[:, int(place)] - model.rest[int(place)]
            ) * change
        elif kind == "offset":
            offsets[:, int(place)] = change
        else:
            value = parameters[kind]
            value = value * (1.0 + size) if fault.is_relative else value + size
            parameters = parameters.replace(**{kind: value})
        return (
            simulate_driven(
                parameters, inputs, states=self.states, period=self._period
            ).outputs
            + offsets
        )

    def _follow(
        self, members: BankMembers, traces: ChangeTraces, ys: FloatArray, us: FloatArray
    ) -> FloatArray:
        """Nats that each hypothesis has saved, shape (N, R); the filter and the traces are moved on."""
        healthy = self._competition.healthy
        model = self.parameters.model
        table = self._competition.table
        noise = model.noise
        zeros = np.zeros(model.noise.size)
        saved = []
        is_read = zeros == 0.0
        for k, (y, u) in enumerate(zip(ys, us, strict=False)):
            # What has no noise has no last digit either.
            reading = Reading(
                y,
                is_read,
                zeros,
                noise,
                1e-3 * noise,
                zeros,
                healthy.inputs.take(u, healthy.arriving(u)),
                healthy.inputs.crossing,
                model.disturbances,
            )
            step(
                model.kernels.code, healthy.fixed, members, traces, table, 1, reading, k
            )
            saved.append(traces.now - members.gained.sum())
        if not members.alive.all():
            raise PlantError(f"{model.title}: its filter is not finite")
        return np.cumsum(saved, axis=0)


def _least_of_each_number(rows: list[ChangeRow]) -> list[ChangeRow]:
    """The rows of the least usual size: of each number that comes at once, and of each that comes slowly."""
    least = {}
    for row in sorted(rows, key=lambda row: -abs(size_of(row))):
        if _is_tried(row):
            least[row.number, bool(row.slowly)] = row
    return list(least.values())


def _is_of_one_number(row: ChangeRow) -> bool:
    """Whether a row has a name and changes one number; what several drives share changes two."""
    return row.cause[0] not in _NOT_NAMED and not row.also


def _is_tried(row: ChangeRow) -> bool:
    """A drive that does more has no name; other numbers creep for longer than a change is followed."""
    if row.number.startswith("share"):
        return size_of(row) < 0.0
    return row.number.startswith("offset") or not row.slowly


def size_of(fault: ChangeRow) -> float:
    """Its usual size, as the row has it; a drive does less."""
    return fault.shift or (
        -fault.spread if fault.number.startswith("share") else fault.spread
    )


def _steps(parameters: Parameters, count: int, holds: float) -> FloatArray:
    """Commands that step up and down over most of each drive's range, every drive in a time of its own, shape
    (N, m)."""
    k = np.arange(count)
    columns = []
    for j, drive in enumerate(parameters.model.plant.drives.values()):
        low, high = drive.limits
        samples_held = max(round(holds * _COURSE.quicker**j), 1)
        columns.append(low + (high - low) * np.where(k // samples_held % 2, 0.9, 0.1))
    return np.stack(columns, axis=1)
