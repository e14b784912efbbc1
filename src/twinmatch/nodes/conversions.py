"""Between the objects of the core and the messages, without losing a bit.

What is absent (`None`) in the core is NaN or an empty text in a message; counts of characters are whole
numbers in float64. Everything else is carried over as it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from twinmatch.discrimination import Criteria, OrderScore, TrustLevel, Verdict
from twinmatch.discrimination.verdict import CandidateScore
from twinmatch.dynamics import Parameters, PlantError
from twinmatch.matching import Fit, Match, Status
from twinmatch.nodes.sample_messages import stamp_header
from twinmatch.plants.named import named, parameters_of
from twinmatch.signals import FloatArray
from twinmatch.twin import MatchReport, MirrorState
from twinmatch_msgs import msg as messages

__all__ = [
    "candidate_message",
    "match_from",
    "match_message",
    "parameters_from",
    "parameters_if_any",
    "parameters_message",
    "score_message",
    "state_message",
    "verdict_from",
]

NAN = float("nan")

STATUSES = {status: getattr(messages.Match, status.name) for status in Status}
LEVELS = {level: getattr(messages.ModelScore, level.name) for level in TrustLevel}
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
COUNTS = ("trivial_length", "model_length", "gain")
FRACTIONS = ("explanation", "naic", "bic", "mdl", "two_part_length")


def state_message(state: MirrorState, nominal: str) -> messages.TwinState:
    """Where the twins are, as `TwinState`; `nominal` names the candidate whose parameters they have."""
    message = messages.TwinState(
        index=state.sample.index,
        nominal=nominal,
        reference=[state.sample.reference],
        closed_states=list(state.closed_states),
        driven_states=list(state.driven_states),
        **{name: [getattr(state, name)] for name in STATE_FIGURES},
    )
    stamp_header(message.header, state.sample.stamp)
    return message


def match_message(report: MatchReport, stamp: int) -> messages.Match:
    """A match as `Match`; `stamp` (ns) is that of the sample that set it off."""
    match = report.match
    message = messages.Match(
        sample=report.sample,
        first=match.samples[0],
        last=match.samples[1],
        operating_point=report.operating_point,
        status=STATUSES[match.status],
        status_name=match.status.value,
        reason=match.reason,
        parameters=parameters_message(match.parameters),
        starts=list(match.starts),
        start_values=list(match.starts.values()),
        free=list(match.free),
        covariance=match.covariance.ravel().tolist(),
        standard_errors=match.standard_errors.tolist(),
        fisher=match.fisher.ravel().tolist(),
        eigenvalues=match.eigenvalues.tolist(),
        condition=match.condition,
        bounds_hit=list(match.bounds_hit),
        directions=match.directions.ravel().tolist(),
        intervals=match.intervals.ravel().tolist(),
        believed=list(match.believed),
        determined=match.determined,
        suggestion=match.suggestion,
        fit_y=match.fit.y,
        fit_u=match.fit.u,
        held_back_fit_y=match.held_back.y,
        held_back_fit_u=match.held_back.u,
        chi2=match.chi2,
    )
    stamp_header(message.header, stamp)
    return message


def match_from(message: messages.Match) -> MatchReport:
    """A match from `Match`."""
    match = Match(
        parameters=parameters_from(message.parameters),
        free=tuple(message.free),
        starts=dict(zip(message.starts, message.start_values, strict=True)),
        covariance=_square(message.covariance),
        fisher=_square(message.fisher),
        eigenvalues=np.array(message.eigenvalues, dtype=np.float64),
        condition=message.condition,
        bounds_hit=tuple(message.bounds_hit),
        fit=Fit(message.fit_y, message.fit_u),
        held_back=Fit(message.held_back_fit_y, message.held_back_fit_u),
        chi2=message.chi2,
        samples=(message.first, message.last),
        status=_key(STATUSES, message.status),
        reason=message.reason,
        directions=_square(message.directions),
        intervals=np.array(message.intervals, dtype=np.float64).reshape(-1, 2),
        believed=tuple(message.believed),
        determined=message.determined,
        suggestion=message.suggestion,
    )
    return MatchReport(message.sample, message.operating_point, match)


def score_message(verdict: Verdict, stamp: int) -> messages.ModelScore:
    """A verdict as `ModelScore`; `stamp` (ns) is that of the sample that set it off."""
    message = messages.ModelScore(
        sample=verdict.sample,
        first=verdict.first,
        last=verdict.last,
        level=LEVELS[verdict.level],
        level_name=verdict.level.value,
        stands=verdict.stands,
        nominal=verdict.nominal or "",
        reason=verdict.reason,
        match=verdict.match,
        dismissed=list(verdict.dismissed),
        decided=verdict.decided,
        certainty=verdict.certainty,
        fault=verdict.fault,
        fault_since=-1 if verdict.fault_since is None else verdict.fault_since,
        structure=verdict.structure,
        structure_parameters=parameters_message(verdict.structure_parameters),
        decimals=verdict.decimals,
        candidates=[candidate_message(verdict, row) for row in range(len(verdict.candidates))],
        order=verdict.order or "",
        nu_gap=[value for row in verdict.nu_gap for value in row],
        driven_rms_y=verdict.driven_rms_y,
        closed_rms_u=verdict.closed_rms_u,
    )
    stamp_header(message.header, stamp)
    return message


def verdict_from(message: messages.ModelScore) -> Verdict:
    """A verdict from `ModelScore`."""
    return Verdict(
        sample=message.sample,
        first=message.first,
        last=message.last,
        level=_key(LEVELS, message.level),
        stands=message.stands,
        nominal=message.nominal or None,
        reason=message.reason,
        decimals=message.decimals,
        candidates=tuple(_candidate_from(candidate) for candidate in message.candidates),
        order=message.order or None,
        nu_gap=tuple(tuple(row) for row in _square(message.nu_gap).tolist()),
        driven_rms_y=message.driven_rms_y,
        closed_rms_u=message.closed_rms_u,
        match=message.match,
        dismissed=tuple(message.dismissed),
        decided=message.decided,
        certainty=message.certainty,
        fault=message.fault,
        fault_since=None if message.fault_since < 0 else message.fault_since,
        structure=message.structure,
        structure_parameters=parameters_if_any(message.structure_parameters),
    )


def candidate_message(verdict: Verdict, row: int) -> messages.Candidate:
    """One candidate of a verdict as `Candidate`, with its row of the ν-gap matrix."""
    candidate = verdict.candidates[row]
    return messages.Candidate(
        name=candidate.name,
        operating_point=candidate.operating_point,
        parameters=parameters_message(candidate.parameters),
        first=candidate.first,
        last=candidate.last,
        orders=[
            messages.OrderScore(
                order=score.order,
                y=_criteria_message(score.y),
                u=_criteria_message(score.u),
                total=_criteria_message(score.total),
                aic_difference=score.aic_difference,
                weight=score.weight,
            )
            for score in candidate.orders
        ],
        chosen_order=candidate.chosen_order,
        nu_gap=list(verdict.nu_gap[row]) if verdict.nu_gap else [],
        nu_gap_sum=candidate.nu_gap_sum,
        nu_gap_low=list(candidate.nu_gap_low),
        nu_gap_high=list(candidate.nu_gap_high),
        nu_gap_sum_low=candidate.nu_gap_sum_low,
        nu_gap_sum_high=candidate.nu_gap_sum_high,
        nominal_probability=candidate.nominal_probability,
        margin=_or_nan(candidate.margin),
        plant_gap_to_nominal=_or_nan(candidate.plant_gap_to_nominal),
        newest=_criteria_message(candidate.newest),
        nu_gap_to_plant=_or_nan(candidate.nu_gap_to_plant),
    )


def _candidate_from(message: messages.Candidate) -> CandidateScore:
    absent = math.isnan(message.newest.trivial_length)
    return CandidateScore(
        name=message.name,
        operating_point=message.operating_point,
        parameters=parameters_from(message.parameters),
        first=message.first,
        last=message.last,
        orders=tuple(
            OrderScore(
                s.order,
                _criteria_from(s.y),
                _criteria_from(s.u),
                _criteria_from(s.total),
                s.aic_difference,
                s.weight,
            )
            for s in message.orders
        ),
        chosen_order=message.chosen_order,
        nu_gap_sum=message.nu_gap_sum,
        newest=None if absent else _criteria_from(message.newest),
        nu_gap_to_plant=_unless_nan(message.nu_gap_to_plant),
        margin=_unless_nan(message.margin),
        plant_gap_to_nominal=_unless_nan(message.plant_gap_to_nominal),
        nu_gap_low=tuple(message.nu_gap_low),
        nu_gap_high=tuple(message.nu_gap_high),
        nu_gap_sum_low=message.nu_gap_sum_low,
        nu_gap_sum_high=message.nu_gap_sum_high,
        nominal_probability=message.nominal_probability,
    )


def parameters_from(message: messages.Parameters) -> Parameters:
    """The parameters in a `Parameters`.

    Raises:
        PlantError: there are none, or those of another plant, or values no rig has.
    """
    parameters = parameters_of(message.plant, message.structure, message.names, message.values)
    if parameters is None:
        raise PlantError("parameters: the message holds none")
    return parameters


def parameters_if_any(message: messages.Parameters) -> Parameters | None:
    """The parameters in a `Parameters`, or None where there are none."""
    return parameters_of(message.plant, message.structure, message.names, message.values)


def parameters_message(parameters: Parameters | None) -> messages.Parameters:
    """Parameters as `Parameters`; of None one without names."""
    held = named(parameters)
    return messages.Parameters(
        plant=held.plant,
        structure=held.structure,
        names=list(held.names),
        values=list(held.values),
        units=list(held.units),
    )


def _criteria_message(criteria: Criteria | None) -> messages.Criteria:
    names = (*COUNTS, *FRACTIONS)
    if criteria is None:
        return messages.Criteria(**dict.fromkeys(names, NAN))
    return messages.Criteria(**{name: float(getattr(criteria, name)) for name in names})


def _criteria_from(message: messages.Criteria) -> Criteria:
    counts = {name: int(getattr(message, name)) for name in COUNTS}
    return Criteria(**counts, **{name: getattr(message, name) for name in FRACTIONS})


def _square(values: Any) -> FloatArray:
    flat = np.array(values, dtype=np.float64)
    side = math.isqrt(flat.size)
    return flat.reshape(side, side)


def _or_nan(value: float | None) -> float:
    return NAN if value is None else value


def _unless_nan(value: float) -> float | None:
    return None if math.isnan(value) else value


def _key(table: dict[Any, int], value: int) -> Any:
    return next(key for key, number in table.items() if number == value)
