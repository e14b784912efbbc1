"""A law that has run: what the twins of earlier sessions predict for that session, beside its readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from twinmatch.controllers import (
    ControllerAnswer,
    ControllerError,
    ControllerQuestion,
    Holding,
    LawComparison,
    TriedTwin,
    as_linear,
    compared,
)
from twinmatch.controllers.reproduction import Reproduction, reproduced
from twinmatch.dynamics import Law, LinearLaw, TwoLevel, begin
from twinmatch.memory import digest_of
from twinmatch.offline.controllers import VISITED, Ground, recorded_profile
from twinmatch.offline.judging import judge
from twinmatch.signals import FloatArray

MIN_REPRODUCED = 0.95
"""Least share of the recorded commands that a law has to give if it is to be the one that ran."""


class _RecordedRows(NamedTuple):
    """The signals of every period of a session, those of the last recorded one where a sample is lost."""

    references: FloatArray
    """Shape (N, r)."""
    outputs: FloatArray
    """Shape (N, o)."""
    inputs: FloatArray
    """Shape (N, m)."""
    is_recorded: FloatArray
    """1 where a sample was recorded, 0 where it is lost, shape (N,)."""


@dataclass(frozen=True, eq=False)
class LawThatRan:
    """A session in which a law ran, beside the answers from earlier ones.

    Raises:
        ControllerError: the session has no set-points, or another law ran there.
    """

    ground: Ground
    law: Law
    law_name: str

    def __post_init__(self) -> None:
        recorded_profile(self.ground.session)
        share = self._reproduction.share
        if share < MIN_REPRODUCED:
            raise ControllerError(
                f"session {self.ground.session.name}: {self.law_name} gives only {100 * share:.0f} % of its "
                "commands to within 1 % of their range, so another law ran there; give that one"
            )

    @cached_property
    def _rows(self) -> _RecordedRows:
        samples = [sample for sample in self.ground.session.samples if sample.usable]
        index = np.array([sample.index for sample in samples])
        periods = np.arange(index[0], index[-1] + 1)
        newest = np.searchsorted(index, periods, side="right") - 1
        return _RecordedRows(
            references=np.array(
                [sample.references for sample in samples], dtype=np.float64
            )[newest],
            outputs=np.array([sample.outputs for sample in samples], dtype=np.float64)[
                newest
            ],
            inputs=np.array([sample.inputs for sample in samples], dtype=np.float64)[
                newest
            ],
            is_recorded=(index[newest] == periods).astype(np.float64),
        )

    @property
    def _law_as_run(self) -> LinearLaw | TwoLevel:
        """The law in the form in which controllers are tried."""
        return self.law if isinstance(self.law, TwoLevel) else as_linear(self.law)

    @cached_property
    def _reproduction(self) -> Reproduction:
        """What the law gives on the recorded signals, beside the recorded commands."""
        return reproduced(
            self._law_as_run,
            self._rows.references,
            self._rows.outputs,
            self._rows.inputs,
        )

    @property
    def faulty(self) -> bool:
        """Whether the session, judged by itself, shows a fault; without verdicts it does not."""
        session = self.ground.session
        terms = self.ground.terms
        return terms is not None and any(
            verdict.fault for verdict in judge(session, terms).verdicts
        )

    def question(self, holding: Holding, draws: int) -> ControllerQuestion:
        """The law over the set-points of the session, from its beginning."""
        references = self._rows.references
        state = None if self._begins_at_rest else self._reproduction.state
        return ControllerQuestion(
            self._law_as_run, references, references[0], holding, draws, state=state
        )

    @property
    def _begins_at_rest(self) -> bool:
        """Whether it begins with its outputs at their set-points."""
        rows = self._rows
        deviations = np.abs(rows.outputs[0] - rows.references[0])
        return bool((deviations <= VISITED * self.ground.noise).all())

    def begun(self, twins: Sequence[TriedTwin]) -> list[TriedTwin]:
        """The twins where the session begins: at rest at its set-points, or at its first readings."""
        if self._begins_at_rest:
            return [replace(twin, states=None) for twin in twins]
        y = self._rows.outputs[0]
        u = self._rows.inputs[0]
        return [
            replace(twin, states=begin(twin.parameters, y), inputs=u) for twin in twins
        ]

    def comparison(
        self, answer: ControllerAnswer, learned: Sequence[Ground], rig: str
    ) -> LawComparison:
        """Its readings beside the answer to its question, from what these sessions have taught."""
        session = self.ground.session
        return LawComparison(
            session=digest_of(session.samples),
            name=session.name,
            plant=self.ground.plant.name,
            rig=rig,
            law=self.law_name,
            learned=", ".join(ground.session.name for ground in learned),
            **compared(
                answer, self._rows.outputs, self._rows.is_recorded, self.ground.noise
            ),
        )
