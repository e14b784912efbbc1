"""What an experiment is to tell: a structure, parameters, what a law hangs on, or one of two faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from twinmatch.controllers.answer import ControllerAnswer, ControllerError
from twinmatch.controllers.courses import ExperimentTerms
from twinmatch.controllers.members import TriedTwin
from twinmatch.controllers.stability import UNBOUNDED, MemberStability
from twinmatch.dynamics import PlantError
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

LEAD: Final = 5.0
"""Nats by which a structure has to lead to be decided: twice as much is twice the logarithm of the odds from
which on the other has no support (Burnham and Anderson 2002)."""
_NINE_IN_TEN: Final = 1.2816
ENOUGH: Final = (
    0.5 * (_NINE_IN_TEN + math.sqrt(_NINE_IN_TEN**2 + 2.0 * LEAD)) ** 2 / math.log(2.0)
)
"""Expected bits after which nine of ten runs decide: noise moves a lead of n nats by √(2 n)."""


class _ConfusedFaults(Rule):
    """A weak drive and grown losses that leave one mark.

    Where losses that have grown to their most need less than the drive lacks, the drive is as weak as they
    allow, but not so little that a twin which is right could be meant.
    """

    share: float = 0.8
    """What a drive does that has become weak, as a share."""
    growth: float = 4.0
    """The largest factor by which losses may have grown."""
    right: float = 0.9
    """Share of a command about which a twin is right."""
    near: float = 0.01
    """Difference of commands that leave the same mark, as a share."""
    unsure: float = 0.25
    """Standard deviation of a fault's size, as a share of what it changes."""


FAULTS: Final = _ConfusedFaults()


@dataclass(frozen=True, eq=False)
class Contender:
    """A twin that may be the plant, with drives that do a share of what they are given."""

    twin: TriedTwin
    share: float = 1.0

    @cached_property
    def root(self) -> FloatArray:
        """A root of the covariance of what is open, shape (n, n)."""
        if self.twin.covariance is None:
            return np.zeros((0, 0))
        values, modes = np.linalg.eigh(self.twin.covariance)
        return np.asarray(modes * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, eq=False)
class LearningGoal:
    """What is to be known."""

    name: str
    contenders: tuple[Contender, ...]
    pairs: bool = False
    """Whether the contenders are to be told apart; else the open parameters of each are to be known."""
    directions: tuple[FloatArray, ...] = ()
    """If not empty, one combination of each contender's open parameters is to be known: its derivatives by
    these, shape (n,)."""

    def label(self, k: int) -> str:
        """A contender by what it is suspected of."""
        twin = self.contenders[k].twin
        return (
            twin.parameters.model.structure_name
            if self.name == "structure"
            else twin.name
        )

    @property
    def most(self) -> float:
        """Bits from which on more is not needed."""
        return ENOUGH if self.pairs else math.inf


def goal_named(
    name: str | None,
    members: Sequence[TriedTwin],
    terms: ExperimentTerms,
    answer: ControllerAnswer | None = None,
) -> LearningGoal:
    """A goal by its name, by default the first that is undecided; "controller" takes a law's `answer`.

    Raises:
        ControllerError: there is nothing to decide.
    """
    if not members:
        raise ControllerError("experiment: there is no twin to predict its courses")
    for goal_name in ("structure", "parameters") if name is None else (name,):
        goal_or_reason = GOALS[goal_name](members, terms, answer)
        if isinstance(goal_or_reason, LearningGoal):
            return goal_or_reason
    raise ControllerError(f"experiment: {goal_or_reason}")


def _structure(members: Sequence[TriedTwin], *_: Any) -> LearningGoal | str:
    first_twins = {
        twin.parameters.model.structure_name: Contender(twin)
        for twin in reversed(members)
    }
    if len(first_twins) < 2:
        return f"all twins have the structure {next(iter(first_twins))}; choose --for parameters"
    return LearningGoal("structure", tuple(first_twins.values()), pairs=True)


def _parameters(members: Sequence[TriedTwin], *_: Any) -> LearningGoal | str:
    contenders = tuple(
        Contender(twin) for twin in members if twin.free and twin.covariance is not None
    )
    if not contenders:
        return "no twin leaves a parameter open; record more samples"
    return LearningGoal("parameters", contenders)


def _controller(*asked: Any) -> LearningGoal | str:
    """What the largest eigenvalue hangs on: its slopes by the open parameters, from the draws."""
    answer: ControllerAnswer | None = asked[-1]
    if answer is None:
        return "--for controller needs the law in question; give --loop FILE"
    contenders = []
    directions = []
    for loop in answer.stability:
        if (
            not loop.sound
            and loop.member.free
            and len(loop.drawn) > len(loop.member.free)
        ):
            contenders.append(Contender(loop.member))
            directions.append(_eigenvalue_slopes(loop))
    if not contenders:
        return f"the law is not undecided for its stability ({answer.sentence})"
    return LearningGoal("controller", tuple(contenders), directions=tuple(directions))


def _eigenvalue_slopes(loop: MemberStability) -> FloatArray:
    """Derivatives of the largest eigenvalue by the open parameters, from the draws, shape (n,)."""
    rows = []
    for draw in loop.drawn:
        rows.append([draw[name] for name in loop.member.free])
    values = np.array(rows)
    sizes = np.where(np.isfinite(loop.eigenvalues), loop.eigenvalues, UNBOUNDED)
    slopes = np.linalg.lstsq(
        values - values.mean(axis=0), sizes - sizes.mean(), rcond=None
    )[0]
    return np.asarray(slopes)


def _fault(
    members: Sequence[TriedTwin], terms: ExperimentTerms, _: Any
) -> LearningGoal | str:
    """A weak drive, and losses that have grown until they need the same command where the plant is held now:
    there they leave one mark."""
    leader = members[0]
    parameters = leader.parameters
    declared = parameters.model.declared
    before = terms.before.tolist()
    losses = next(
        (name for name in leader.free if declared[name].role == "losses"), None
    )
    if losses is None:
        return "the plant file has no open parameter with role='losses', with which a weak drive is confused"

    def command(growth: float) -> float | None:
        """What grown losses need, from rest on; None where they cannot be held."""
        grown = parameters.replace(**{losses: growth * parameters[losses]})
        try:
            rest_point = terms.holding.linear(grown, before).rest
        except PlantError:
            return None
        return float(rest_point.inputs[0] - parameters.model.rest[0])

    usual_command = command(1.0) or 0.0
    most_command = command(FAULTS.growth)
    if not usual_command:
        return f"{leader.name} needs no command at {before}, or is not held there; begin at another level"
    most_by = math.inf if most_command is None else most_command / usual_command
    if FAULTS.right * most_by <= 1.0:
        return (
            f"at {before} the {FAULTS.growth:g}-fold {losses} needs a command {most_by:.3g} times as large: "
            "a drive weaker than that is not confused with it"
        )
    share = max(FAULTS.share, 1.0 / most_by)

    def excess(growth: float) -> float:
        """By how much grown losses need more than the weak drive lacks, as a share; 1 where not held."""
        needed = command(growth)
        return 1.0 if needed is None else needed * share / usual_command - 1.0

    growth = FAULTS.growth
    if share <= FAULTS.share:
        from scipy.optimize import brentq  # noqa: PLC0415

        growth = float(brentq(excess, 1.0, FAULTS.growth, xtol=1e-6))
    if abs(excess(growth)) > FAULTS.near:
        return f"a weak drive does not hold {leader.name} at {before}; begin at another level"
    grown_losses = _with_grown_losses(leader, losses, growth)
    weak_drive = replace(leader, name="weak drive", states=None)
    return LearningGoal(
        "fault", (Contender(weak_drive, share), Contender(grown_losses)), pairs=True
    )


def _with_grown_losses(leader: TriedTwin, losses: str, growth: float) -> TriedTwin:
    """The twin if the parameter `losses` has grown by about this factor."""
    parameters = leader.parameters.replace(
        **{losses: growth * leader.parameters[losses]}
    )
    size = len(leader.free)
    covariance = np.array(
        np.zeros((size, size)) if leader.covariance is None else leader.covariance
    )
    place = leader.free.index(losses)
    covariance[place, place] += (FAULTS.unsure * parameters[losses]) ** 2
    return replace(
        leader,
        name="grown losses",
        parameters=parameters,
        covariance=covariance,
        states=None,
    )


GOALS: Final[dict[str, Callable[..., LearningGoal | str]]] = {
    "structure": _structure,
    "parameters": _parameters,
    "controller": _controller,
    "fault": _fault,
}
"""What can be asked; a text says why there is nothing to decide."""
