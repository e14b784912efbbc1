"""Convert between the objects of the core and messages, without losing a bit.

`twinmatch.record` describes the recorded form of verdicts and matches; this module fills the messages.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from twinmatch.comparing import ForecastScore, Verdict
from twinmatch.comparing.verdict import CandidateScore
from twinmatch.dynamics import Parameters, PlantError
from twinmatch.nodes.sample_messages import stamp_header
from twinmatch.record import (
    fill,
    object_of,
    parameters_of,
    parameters_tree,
    tree_of,
    tree_of_message,
)
from twinmatch.twin import MatchReport, MirrorState
from twinmatch_msgs import msg as messages

__all__ = [
    "candidate_message",
    "leader_message",
    "match_from",
    "match_message",
    "parameters_from",
    "parameters_if_any",
    "parameters_message",
    "score_message",
    "state_message",
    "verdict_from",
]

STATE_FIGURES = (
    "closed_output",
    "closed_input",
    "driven_output",
    "closed_residual_y",
    "closed_residual_u",
    "driven_residual_y",
    "closed_rms_y",
    "closed_rms_u",
    "driven_rms_y",
)


def state_message(state: MirrorState, leader: str, states: Iterable[str]) -> messages.TwinState:
    """The states of the twins as `TwinState`.

    Args:
        state: the twins at one tick.
        leader: name of the candidate whose parameters they use.
        states: names of all states of the plant, in the order of its description.
    """
    order = list(states)
    message = messages.TwinState(
        index=state.sample.index,
        leader=leader,
        reference=[state.sample.reference],
        closed_states=[state.closed_states.get(name, math.nan) for name in order],
        driven_states=[state.driven_states.get(name, math.nan) for name in order],
        **{name: [getattr(state, name)] for name in STATE_FIGURES},
    )
    stamp_header(message.header, state.sample.stamp)
    return message


def match_message(report: MatchReport, stamp: int) -> messages.Match:
    """A match as `Match`; `stamp` (ns) is that of the sample that triggered it."""
    return _filled(messages.Match(), report, stamp)


def match_from(message: messages.Match) -> MatchReport:
    """A match from `Match`."""
    return object_of(MatchReport, tree_of_message(message))


def score_message(verdict: Verdict, stamp: int) -> messages.ModelScore:
    """A verdict as `ModelScore`; `stamp` (ns) is that of the sample that triggered it."""
    return _filled(messages.ModelScore(), verdict, stamp)


def verdict_from(message: messages.ModelScore) -> Verdict:
    """A verdict from `ModelScore`."""
    return object_of(Verdict, tree_of_message(message))


def candidate_message(candidate: CandidateScore) -> messages.Candidate:
    """A candidate of a verdict as `Candidate`."""
    return fill(messages.Candidate(), tree_of(candidate), _part)


def leader_message(score: ForecastScore) -> messages.ForecastScore:
    """The leader's score as `ForecastScore`."""
    return fill(messages.ForecastScore(), tree_of(score), _part)


def _filled(message: Any, record: Any, stamp: int) -> Any:
    fill(message, tree_of(record), _part)
    stamp_header(message.header, stamp)
    return message


def _part(kind: str) -> Any:
    return getattr(messages, kind)()


def parameters_from(message: messages.Parameters) -> Parameters:
    """The parameters in a `Parameters`.

    Raises:
        PlantError: the message has none, they are those of another plant, or values are out of range.
    """
    found = parameters_if_any(message)
    if found is None:
        raise PlantError("parameters: the message holds none")
    return found


def parameters_if_any(message: messages.Parameters) -> Parameters | None:
    """The parameters in a `Parameters`, or None where there are none."""
    return parameters_of(tree_of_message(message))


def parameters_message(parameters: Parameters | None) -> messages.Parameters:
    """Parameters as `Parameters`; for None a message without names."""
    return fill(messages.Parameters(), parameters_tree(parameters), _part)
