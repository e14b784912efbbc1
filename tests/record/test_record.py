"""Records against what they are made of: messages, the page on the method, and themselves."""

from __future__ import annotations

import json
import math
import re
import struct
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.places import PROJECT
from twinmatch.comparing import (
    CandidateScore,
    ForecastScore,
    OrderScore,
    TrustLevel,
    Verdict,
)
from twinmatch.comparing.criteria import Criteria
from twinmatch.description import Description, Quantity
from twinmatch.fitting import Status
from twinmatch.fitting.match import without_fit
from twinmatch.forecasting import Band, Forecast, WhatIfResult
from twinmatch.forecasting.what_if import Moment, Peak
from twinmatch.health import EstimatedReading
from twinmatch.plants import Peltier
from twinmatch.record import (
    SAMPLED,
    comparable,
    differences,
    documents_of,
    object_of,
    tree_of,
)
from twinmatch.record.fields import Form, RecordError, fields_of, values_name
from twinmatch.safety import LawReport
from twinmatch.signals import Window
from twinmatch.twin import MatchReport, MatchRequest
from twinmatch.twin.experiment import ExperimentReport

METHOD = (PROJECT / "docs" / "method.md").read_text()
RECORDS = {
    "ModelScore": Verdict,
    "Candidate": CandidateScore,
    "ForecastScore": ForecastScore,
    "OrderScore": OrderScore,
    "Criteria": Criteria,
    "Match": MatchReport,
}
SENT = {
    **RECORDS,
    "EstimatedReading": EstimatedReading,
    "ExperimentReport": ExperimentReport,
    "Forecast": Forecast,
    "LawReport": LawReport,
    "MatchRequest": MatchRequest,
    "PlantDescription": Description,
    "Signal": Quantity,
}
OF_THE_MESSAGE = {"header"}
BESIDE = {"PlantDescription": {"period"}}
"""Fields of a message that its record does not have: the period is that of a run, not of a plant."""
CRITERIA = Criteria(100, 90, 10, 0.1, 1.0, 2.0, 3.0, 4.0)
CANDIDATE = CandidateScore(
    name="50 °C",
    operating_point=50.0,
    parameters=Peltier.model().parameters(),
    first=0,
    last=99,
    orders=(
        OrderScore("22221", CRITERIA, CRITERIA, CRITERIA + CRITERIA, math.nan, 1.0),
    ),
    chosen_order="22221",
    nu_gap_sum=0.5,
    newest=None,
    nu_gap_to_plant=None,
    nu_gap_low=(0.0, 0.25),
)
VERDICT = Verdict(
    sample=7,
    first=0,
    last=7,
    level=TrustLevel.DOUBTFUL,
    level_reason="for a reason",
    stands=False,
    nominal="50 °C",
    reason="so it is",
    decimals=2,
    candidates=(
        CANDIDATE,
        replace(CANDIDATE, name="70 °C", newest=CRITERIA, margin=0.25),
    ),
    order=None,
    nu_gap=((0.0, 0.5), (0.5, 0.0)),
    driven_rms_y=1.0,
    closed_rms_u=math.inf,
)


def report() -> MatchReport:
    """One without a fit, so full of NaN, and one direction that is known."""
    window = Window(np.full(9, 50.0), np.full(9, 50.0), np.full(9, 90.0))
    match = without_fit(
        window,
        ("a", "b"),
        Peltier.model().parameters(),
        Status.NO_EXCITATION,
        "nothing moved",
    )
    fitted = replace(
        match,
        starts={"sink": 296.0},
        directions=np.array([[1.0, 2.0], [3.0, 4.0]]),
        believed=("b",),
    )
    return MatchReport(8, 50.0, fitted)


def entries(kind: type) -> set[str]:
    """Names of the fields of the message."""
    names: set[str] = set()
    for field in fields_of(kind):
        if field.form is Form.WORD:
            names |= {field.key, f"{field.key}_name"}
        elif field.form is Form.SPAN:
            names |= {"first", "last"}
        elif field.form is Form.NAMED:
            names |= {field.key, values_name(field.key)}
        elif field.form is Form.BANDS:
            names |= set(field.columns_of_bands.values())
        elif field.form is Form.WINDOW:
            names |= {*SAMPLED, "first", "period", "lost"}
        elif field.form is Form.INLINE:
            names |= {field.key_inside(name) for name in entries(field.kind)}
        else:
            names.add(field.key)
    return names


@pytest.mark.parametrize("name", SENT)
def test_the_message_has_the_fields_of_the_record(name: str) -> None:
    """A field of the one that the other lacks is found here, whichever it is."""
    text = (PROJECT / "src" / "twinmatch_msgs" / "msg" / f"{name}.msg").read_text()
    lines = (line.partition("#")[0].split() for line in text.splitlines())
    field_names = {
        words[1] for words in lines if len(words) == 2 and "=" not in words[1]
    }
    assert field_names - OF_THE_MESSAGE - BESIDE.get(name, set()) == entries(SENT[name])


@pytest.mark.parametrize("name", RECORDS)
def test_the_method_says_how_to_read_every_field(name: str) -> None:
    documented = set(re.findall(r"`(\w+)`", METHOD))
    missing = {
        entry.removesuffix("_name") for entry in entries(RECORDS[name])
    } - documented
    assert not missing, (
        f"docs/method.md does not say how to read {sorted(missing)} of {name}"
    )


def test_an_answer_to_a_question_has_the_fields_of_its_record() -> None:
    text = (
        (PROJECT / "src" / "twinmatch_msgs" / "srv" / "WhatIf.srv")
        .read_text()
        .partition("---")[2]
    )
    field_names = {
        line.split()[1] for line in text.splitlines() if line.partition("#")[0].strip()
    }
    assert field_names - {"success", "message"} == entries(WhatIfResult)


def test_an_answer_names_what_happens_first_by_its_own_name_and_a_single_level_in_a_list() -> (
    None
):
    band = Band(np.array([1.0, 2.0]), np.array([0.5, 1.5]), np.array([1.5, 2.5]))
    forecast = Forecast(
        7,
        "c",
        "s",
        0.9,
        np.array([1.0, 2.0]),
        np.array([3.0, 3.0]),
        (band, band),
        (band,),
    )
    answer = WhatIfResult(
        forecast,
        2.0,
        0.5,
        Moment(1.0, None, 2.0),
        Moment(2.0, 2.0, None),
        Peak(2.0, 2.0, 1.5, 2.5),
    )
    tree = tree_of(answer)
    assert (
        tree["level"],
        tree["reach"],
        tree["reach_latest"],
        tree["largest_input_most"],
    ) == (
        [2.0],
        1.0,
        2.0,
        2.5,
    )
    assert math.isnan(tree["reach_earliest"])
    assert tree["forecast"]["output_low"] == [0.5, 0.5, 1.5, 1.5], "sample by sample"
    assert repr(object_of(WhatIfResult, tree)) == repr(answer)


def test_records_survive_their_trees() -> None:
    assert repr(object_of(Verdict, tree_of(VERDICT))) == repr(VERDICT)
    read_back = object_of(MatchReport, tree_of(report()))
    assert repr(read_back) == repr(report())
    assert read_back.match.directions.shape == (2, 2)
    assert read_back.match.intervals.shape == (2, 2)


def described(record: Verdict | MatchReport) -> dict[str, Any]:
    (document,) = documents_of([record])
    return document


def test_what_is_absent_is_null_in_json() -> None:
    entry = json.loads(json.dumps(described(VERDICT), allow_nan=False))
    first, second = entry["candidates"]
    assert entry["level"] == "doubtful"
    assert entry["nu_gap"] == [[0.0, 0.5], [0.5, 0.0]]
    absent = (entry["order"], entry["closed_rms_u"], first["newest"], first["margin"])
    assert {*absent, first["orders"][0]["aic_difference"]} == {None}
    assert second["newest"]["gain"] == 10
    match = described(report())
    assert (match["first"], match["last"], match["fit_y"]) == (0, 8, None)
    assert match["directions"] == [[1.0, 2.0], [3.0, 4.0]]
    assert match["standard_errors"] == [None, None]
    assert match["starts"] == {"sink": 296.0}
    assert match["parameters"]["ambient"] == 296.0


def test_what_several_records_hold_is_described_once_and_what_is_equal_apart() -> None:
    later = replace(VERDICT, sample=VERDICT.sample + 50)
    equal = replace(VERDICT, candidates=tuple(map(replace, VERDICT.candidates)))
    documents = documents_of([VERDICT, later, equal])
    assert documents == [described(VERDICT), described(later), described(equal)]
    first, second, third = (document["candidates"][0] for document in documents)
    assert first is second
    assert first is not third


def test_a_record_of_another_version_is_refused() -> None:
    tree = tree_of(VERDICT)
    with pytest.raises(
        RecordError, match="a Verdict lacks reason; it was recorded by another version"
    ):
        object_of(
            Verdict, {name: value for name, value in tree.items() if name != "reason"}
        )
    with pytest.raises(
        RecordError,
        match="'certain' is unknown; expected one of unknown, trusted, doubtful, fault",
    ):
        object_of(Verdict, tree | {"level_name": "certain"})


def test_a_type_that_is_not_recorded_is_refused() -> None:
    @dataclass
    class Odd:
        when: complex

    with pytest.raises(RecordError, match=r"Odd\.when is of type"):
        fields_of(Odd)


def test_what_an_older_version_recorded_is_compared_as_far_as_both_know_it() -> None:
    tree = comparable(tree_of(VERDICT))
    older = {**tree, "residual_y": tree["driven_rms_y"], "gone": 1}
    del older["driven_rms_y"], older["certainty"]
    apart: set[str] = set()
    assert not list(differences(comparable(older), tree, apart=apart))
    assert apart == {"gone", "certainty"}
    older["residual_y"] += 1.0
    assert [
        place for place, _, _ in differences(comparable(older), tree, apart=set())
    ] == ["driven_rms_y"]


def test_every_bit_counts() -> None:
    tree = tree_of(VERDICT)
    changed = tree_of(VERDICT)
    assert not list(differences(tree, changed))
    was = changed["candidates"][1]["orders"][0]["total"]["bic"]
    changed_bic = float(np.nextafter(was, np.inf))
    changed["candidates"][1]["orders"][0]["total"]["bic"] = changed_bic
    assert list(differences(tree, changed)) == [
        ("candidates[1].orders[0].total.bic", was, changed_bic)
    ]


@given(st.floats(), st.floats())
def test_floats_are_compared_by_their_bits(first: float, second: float) -> None:
    has_same_bits = struct.pack("<d", first) == struct.pack("<d", second) or (
        math.isnan(first) and math.isnan(second)
    )
    assert (not list(differences({"a": [first]}, {"a": [second]}))) is has_same_bits


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ({"a": 1}, {"b": 1}, [("a", 1, None), ("b", None, 1)]),
        ([1], [1, 2], [("", [1], [1, 2])]),
    ],
)
def test_missing_fields_are_differences(first: Any, second: Any, expected: Any) -> None:
    assert list(differences(first, second)) == expected
