"""Tables that hold more when more is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tests.support.rig import rig
from twinmatch.comparing import REFUSED, CandidateScore, Verdict
from twinmatch.showing.report.report import SessionReport
from twinmatch.showing.report.tables import (
    gap_table,
    match_table,
    nominal_table,
    order_table,
)
from twinmatch.showing.report.words import duration

from .conftest import grid, parse, tables_of

RIG = rig("sink with mass", seebeck=0.06, sink_heat_capacity=250.0, sink_convection=6.0)


def verdict_of(report: SessionReport) -> Verdict:
    return report.judged.judgement.verdicts[-1]


def silent_candidate(candidate: CandidateScore) -> CandidateScore:
    orders = [
        replace(order, weight=math.nan, aic_difference=math.nan)
        for order in candidate.orders
    ]
    return replace(
        candidate,
        margin=None,
        plant_gap_to_nominal=None,
        nu_gap_sum_low=math.nan,
        nu_gap_sum_high=math.nan,
        nominal_probability=math.nan,
        orders=tuple(orders),
    )


def silent(verdict: Verdict) -> Verdict:
    """The verdict with nothing said of how sure it is."""
    candidates = tuple(map(silent_candidate, verdict.candidates))
    return replace(
        verdict,
        candidates=candidates,
        certainty="",
        structure="",
        structure_parameters=None,
    )


def telling_candidate(candidate: CandidateScore, number: int) -> CandidateScore:
    weights = (0.7, 0.2, 0.1, 0.0)
    differences = (0.0, 2.5, 3.9, 40.0)
    orders = [
        replace(order, weight=weight, aic_difference=difference)
        for order, weight, difference in zip(
            candidate.orders, weights, differences, strict=True
        )
    ]
    return replace(
        candidate,
        margin=0.31 + 0.01 * number,
        plant_gap_to_nominal=0.05 * number,
        nu_gap_sum_low=candidate.nu_gap_sum / 2,
        nu_gap_sum_high=candidate.nu_gap_sum + 0.2,
        nominal_probability=0.25,
        orders=tuple(orders),
    )


def telling(verdict: Verdict) -> Verdict:
    candidates = tuple(
        telling_candidate(c, number) for number, c in enumerate(verdict.modelled)
    )
    return replace(
        verdict,
        candidates=candidates,
        nu_gap=tuple(
            row[: len(candidates)] for row in verdict.nu_gap[: len(candidates)]
        ),
        certainty="the choice is certain",
        structure="sink with mass",
        structure_parameters=RIG,
    )


def test_columns_without_a_figure_are_left_out(shipped: SessionReport) -> None:
    quiet = silent(verdict_of(shipped))
    assert order_table(quiet) is None
    assert not {"90 % of Σ", "P(nominal)", "margin"} & set(gap_table(quiet).columns)


def test_what_is_known_of_the_uncertainty_is_shown(shipped: SessionReport) -> None:
    table = gap_table(telling(verdict_of(shipped)))
    row = dict(zip(table.columns, (c.text for c in table.rows[1]), strict=True))
    total = verdict_of(shipped).candidates[1].nu_gap_sum
    assert row["90 % of Σ"] == f"{total / 2:.3f} to {total + 0.2:.3f}"
    assert row["P(nominal)"] == "0.25"
    assert row["margin"] == "0.320"
    weights = order_table(telling(verdict_of(shipped)))
    assert weights is not None
    assert [c.text for c in weights.rows[0]][1:] == [
        "0.700", "0.200", "0.100", "0.000", "0.0", "2.5", "3.9", "40.0",
    ]  # fmt: skip
    assert [c.best for c in weights.rows[0]][1:5] == [True, False, False, False]


def test_certainty_structure_and_weights_are_on_the_page(
    shipped: SessionReport,
) -> None:
    judgement = shipped.judged.judgement
    telling_judgement = replace(
        judgement, verdicts=(*judgement.verdicts[:-1], telling(verdict_of(shipped)))
    )
    text = replace(
        shipped, judged=replace(shipped.judged, judgement=telling_judgement)
    ).html()
    document = parse(text)
    assert "The choice is certain." in text
    rows = {
        row[0].text: row[2].text
        for row in grid(
            tables_of(document)["Peltier rig with the structure “sink with mass”"]
        )
    }
    assert rows["C_S"] == "250"
    assert "Akaike weights of the orders" in tables_of(document)


def test_a_given_candidate_has_no_intervals(shipped: SessionReport) -> None:
    score = verdict_of(shipped).candidates[0]
    rows = {row[0].text: row for row in nominal_table(score, None).rows}
    assert rows["α"][2].text == f"{1000 * score.parameters['seebeck']:.1f}"
    assert rows["α"][6].text == "candidate file"
    assert rows["α"][5].text == "–"


def test_open_intervals_are_shown_as_open(shipped: SessionReport) -> None:
    nominal = shipped.nominal
    assert nominal is not None
    assert nominal.match is not None
    place = nominal.match.free.index("conductance")
    ends = np.array([[0.0, 1.0]] * len(nominal.match.free))
    ends[place] = (-np.inf, 0.6)
    open_ended = replace(nominal.match, intervals=ends, believed=("seebeck",))
    rows = {row[0].text: row for row in nominal_table(nominal.score, open_ended).rows}
    assert rows["K"][5].text == "−∞ to 0.600"
    assert rows["K"][6].text == "fitted, poorly determined"
    assert rows["α"][6].text == "fitted, well determined"


def test_a_refused_match_is_reported_with_its_reason(shipped: SessionReport) -> None:
    report = shipped.judged.judgement.matches[0]
    unfitted = replace(report.match, chi2=math.nan, reason="nothing moved")
    table = match_table([report._replace(match=unfitted)], [], 1.0)
    assert table.rows[0][-1].text == "nothing moved"
    assert {c.text for c in table.rows[0][3:-3]} == {"–"}


def test_a_window_that_was_refused_unfitted_is_among_the_matches(
    shipped: SessionReport,
) -> None:
    judgement = shipped.judged.judgement
    reason = "not matched: sensor-drift since sample 5"
    refused = replace(judgement.verdicts[0], sample=3, match=REFUSED, reason=reason)
    table = match_table(judgement.matches, [refused, *judgement.verdicts], 2.0)
    assert table is not None
    assert len(table.rows) == len(judgement.matches) + 1
    first = [cell.text for cell in table.rows[0]]
    assert (first[0], first[2], first[-1]) == ("6", REFUSED, reason)
    assert {first[1], *first[3:-1]} == {"–"}
    alone = match_table([], [refused], 2.0)
    assert alone is not None
    assert alone.rows[0][-1].text == reason
    assert match_table([], judgement.verdicts[:1], 2.0) is None


def test_spans_of_time_read_well() -> None:
    assert [duration(s) for s in (0.5, 59, 60, 3599, 3601)] == [
        "0.5 s",
        "59 s",
        "1 min",
        "59 min 59 s",
        "1 h 1 s",
    ]
