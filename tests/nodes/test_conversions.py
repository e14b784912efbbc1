"""Messages carry the core's objects whole: there and back, serialised in between, nothing differs."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from tests.support.exchanging import Heaters
from twinmatch.comparing import ADMITTED, REFUSED, OrderScore, TrustLevel, Verdict
from twinmatch.comparing.criteria import Criteria
from twinmatch.comparing.verdict import CandidateScore
from twinmatch.description import Quantity
from twinmatch.dynamics import Parameters, PlantError
from twinmatch.fitting import Match, Status
from twinmatch.fitting.match import Fit
from twinmatch.forecasting import Band, Forecast
from twinmatch.nodes.expected import check
from twinmatch.nodes.fields import MessageError
from twinmatch.nodes.messages import (
    description_message,
    message_of,
    parameters_from,
    parameters_message,
    record_of,
    sample_from,
    sample_message,
    state_message,
)
from twinmatch.plants import Peltier
from twinmatch.plants.records import description_of
from twinmatch.record import object_of, tree_of_message
from twinmatch.signals import Sample, SignalError, Window
from twinmatch.twin import MatchReport, MatchRequest, MirrorState
from twinmatch_msgs import msg as messages

# NaN stands for "absent" in two fields, so it is left out of those alone.
NUMBERS = st.floats(allow_nan=False)
ANY = st.floats()
INDICES = st.integers(0, 2**63 - 1)
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=20)
COUNTS = st.integers(-(2**53), 2**53)
POSITIVE = st.floats(1e-6, 1e6)

SIGNALS = [
    st.lists(ANY, min_size=least, max_size=3).map(tuple) for least in (1, 1, 1, 0)
]
SAMPLES = st.builds(Sample, INDICES, STAMPS, *SIGNALS)


@st.composite
def parameters(draw: st.DrawFn) -> Parameters:
    """Of the rig in any structure, anywhere within the bounds of a search."""
    model = Peltier.model(draw(st.sampled_from(sorted(Peltier.structures))))
    names = draw(st.sets(st.sampled_from(model.names), max_size=4))
    return model.parameters(
        **{
            name: draw(st.floats(*model.declared[name].bounds))
            for name in sorted(names)
        }
    )


PARAMETERS = parameters()
CRITERIA = st.builds(Criteria, COUNTS, COUNTS, COUNTS, ANY, ANY, ANY, ANY, ANY)
ORDERS = st.builds(OrderScore, TEXTS, CRITERIA, CRITERIA, CRITERIA, ANY, ANY)
ROWS = st.lists(ANY, max_size=3).map(tuple)
CANDIDATES = st.builds(
    CandidateScore,
    name=TEXTS,
    operating_point=ANY,
    parameters=PARAMETERS,
    first=INDICES,
    last=st.integers(-1, 2**63 - 1),
    orders=st.lists(ORDERS, max_size=2).map(tuple),
    chosen_order=TEXTS,
    nu_gap_sum=ANY,
    newest=st.none() | CRITERIA,
    nu_gap_to_plant=st.none() | NUMBERS,
    margin=st.none() | NUMBERS,
    plant_gap_to_nominal=st.none() | NUMBERS,
    nu_gap_low=ROWS,
    nu_gap_high=ROWS,
    nu_gap_sum_low=ANY,
    nu_gap_sum_high=ANY,
    nominal_probability=ANY,
    identified_gap_sum=ANY,
    identified_gap_to_plant=st.none() | NUMBERS,
)


def there_and_back(message: Any) -> Any:
    return deserialize_message(serialize_message(message), type(message))


def same(converted: Any, expected: Any) -> None:
    """Equal field by field, arrays by value and shape, NaN equal to NaN."""
    assert type(converted) is type(expected)
    for field in dataclasses.fields(expected):
        value = getattr(converted, field.name)
        wanted = getattr(expected, field.name)
        if isinstance(wanted, np.ndarray):
            np.testing.assert_array_equal(value, wanted, strict=True)
        else:
            assert repr(value) == repr(wanted), field.name


@given(SAMPLES)
def test_a_sample_survives_its_message(sample: Sample) -> None:
    message = there_and_back(sample_message(sample, "rig"))
    assert message.header.frame_id == "rig"
    assert repr(sample_from(message)) == repr(sample)


@st.composite
def reports(draw: st.DrawFn) -> MatchReport:
    size = draw(st.integers(0, 4))
    square = st.lists(ANY, min_size=size * size, max_size=size * size)
    pairs = st.lists(ANY, min_size=2 * size, max_size=2 * size)
    names = draw(st.lists(TEXTS, min_size=size, max_size=size))
    with np.errstate(invalid="ignore"):
        match = Match(
            parameters=draw(PARAMETERS),
            free=tuple(names),
            starts=draw(st.dictionaries(TEXTS, ANY, max_size=2)),
            covariance=np.array(draw(square), dtype=np.float64).reshape(size, size),
            fisher=np.array(draw(square), dtype=np.float64).reshape(size, size),
            eigenvalues=np.array(draw(st.lists(ANY, max_size=4)), dtype=np.float64),
            condition=draw(ANY),
            bounds_hit=tuple(draw(st.lists(TEXTS, max_size=2))),
            fit=Fit(draw(ANY), draw(ANY)),
            held_back=Fit(draw(ANY), draw(ANY)),
            chi2=draw(ANY),
            samples=(draw(INDICES), draw(INDICES)),
            status=draw(st.sampled_from(Status)),
            reason=draw(TEXTS),
            directions=np.array(draw(square), dtype=np.float64).reshape(size, size),
            intervals=np.array(draw(pairs), dtype=np.float64).reshape(size, 2),
            believed=tuple(draw(st.lists(TEXTS, max_size=2))),
            determined=draw(TEXTS),
            suggestion=draw(TEXTS),
        )
    return MatchReport(draw(INDICES), draw(ANY), match)


@given(report=reports(), stamp=STAMPS)
@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt:RuntimeWarning")
def test_a_match_survives_its_message_with_status_and_stamp(
    report: MatchReport, stamp: int
) -> None:
    message = there_and_back(message_of(report, stamp))
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    assert message.status_name == report.match.status.value
    assert len(message.standard_errors) == len(report.match.free)
    converted = record_of(message)
    assert repr(converted[:2]) == repr(report[:2])
    same(converted.match, report.match)


@st.composite
def requests(draw: st.DrawFn) -> MatchRequest:
    size = draw(st.integers(1, 5))
    wide = draw(st.integers(0, 2))
    finite = st.floats(allow_nan=False, allow_infinity=False)
    row = st.lists(finite, min_size=size, max_size=size)
    disturbances = draw(st.lists(finite, min_size=size * wide, max_size=size * wide))
    window = Window(
        np.array(draw(row)),
        np.array(draw(row)),
        np.array(draw(row)),
        first=draw(INDICES),
        period=draw(POSITIVE),
        disturbances=np.array(disturbances).reshape(size, wide),
    )
    return MatchRequest(
        draw(INDICES), draw(ANY), window, draw(PARAMETERS), draw(st.none() | PARAMETERS)
    )


@given(request=requests(), stamp=STAMPS)
def test_a_request_for_a_match_survives_its_message_with_its_window(
    request: MatchRequest, stamp: int
) -> None:
    message = there_and_back(message_of(request, stamp))
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    converted = record_of(message)
    same(converted.window, request.window)
    assert repr(converted._replace(window=None)) == repr(request._replace(window=None))


@st.composite
def verdicts(draw: st.DrawFn) -> Verdict:
    candidates = draw(st.lists(CANDIDATES, max_size=3))
    row = st.lists(ANY, min_size=len(candidates), max_size=len(candidates)).map(tuple)
    return Verdict(
        sample=draw(INDICES),
        first=draw(INDICES),
        last=draw(INDICES),
        level=draw(st.sampled_from(TrustLevel)),
        level_reason=draw(TEXTS),
        stands=draw(st.booleans()),
        nominal=draw(st.none() | TEXTS.filter(bool)),
        reason=draw(TEXTS),
        decimals=draw(st.integers(0, 9)),
        candidates=tuple(candidates),
        order=draw(st.none() | TEXTS.filter(bool)),
        nu_gap=tuple(draw(row) for _ in candidates),
        nu_gap_points=draw(ROWS),
        identified_gap=tuple(draw(row) for _ in candidates),
        driven_rms_y=draw(ANY),
        closed_rms_u=draw(ANY),
        match=draw(st.sampled_from(["", ADMITTED, REFUSED])),
        dismissed=tuple(draw(st.lists(TEXTS, max_size=2))),
        decided=draw(st.booleans()),
        certainty=draw(TEXTS),
        fault=draw(TEXTS),
        fault_since=draw(st.none() | INDICES),
        structure=draw(TEXTS),
        structure_parameters=draw(st.none() | PARAMETERS),
    )


@given(verdict=verdicts(), stamp=STAMPS)
def test_a_verdict_survives_its_message_with_level_and_stamp(
    verdict: Verdict, stamp: int
) -> None:
    message = there_and_back(message_of(verdict, stamp))
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    assert message.level_name == verdict.level.value
    same(record_of(message), verdict)


@given(CANDIDATES)
def test_a_candidate_survives_its_message(candidate: CandidateScore) -> None:
    message = there_and_back(message_of(candidate))
    same(object_of(CandidateScore, tree_of_message(message)), candidate)


NAMES = ("plate", "sink", "sensor")
STATES = st.dictionaries(st.sampled_from(NAMES), ANY)


@given(
    st.builds(
        MirrorState,
        **dict.fromkeys(
            (field.name for field in dataclasses.fields(MirrorState)), SIGNALS[0]
        )
        | {"sample": SAMPLES, "closed_states": STATES, "driven_states": STATES},
    )
)
def test_every_figure_of_the_mirror_is_in_the_message_under_its_name(
    state: MirrorState,
) -> None:
    message = there_and_back(state_message(state, "50 °C", NAMES))
    assert (message.index, message.leader) == (state.sample.index, "50 °C")
    assert repr(list(message.reference)) == repr(list(state.sample.references))
    for field in dataclasses.fields(state):
        value = getattr(state, field.name)
        if field.name.endswith("_states"):
            values = [value.get(name, math.nan) for name in NAMES]
            assert repr(list(getattr(message, field.name))) == repr(values)
        elif field.name != "sample":
            assert repr(tuple(getattr(message, field.name))) == repr(value)


@pytest.mark.parametrize(
    ("spoil", "message_part"),
    [
        ({"plant": "fridge"}, "plant 'fridge': not known; choose from peltier"),
        (
            {"names": ["seebeck", "mass"], "values": [0.1, 1.0]},
            "no parameter 'mass' in this structure",
        ),
        ({"structure": "two sinks"}, "no structure 'two sinks'; it has held sink, "),
        ({"values": [0.1]}, "9 names with 1 values"),
        ({"plant": "", "names": [], "values": []}, "the message holds none"),
    ],
)
def test_parameters_of_another_plant_are_refused(
    spoil: dict[str, Any], message_part: str
) -> None:
    message = parameters_message(Peltier.model().parameters())
    for name, value in spoil.items():
        setattr(message, name, value)
    with pytest.raises(PlantError, match=message_part):
        parameters_from(message)


def test_parameters_come_with_their_units() -> None:
    message = parameters_message(Peltier.model("sink with mass").parameters())
    assert (
        dict(zip(message.names, message.units, strict=True))["sink_convection"] == "W/K"
    )
    assert (message.plant, message.structure) == ("peltier", "sink with mass")


def test_a_description_is_carried_whole() -> None:
    whole = replace(
        description_of(Peltier), disturbances=(Quantity("room", "air", "°C"),)
    )
    message = there_and_back(description_message(whole, 0.5))
    assert message.period == 0.5
    assert record_of(message) == whole
    two = description_of(Heaters)
    assert [y.name for y in two.outputs] == ["first", "second"]
    assert [r.name for r in two.references] == [
        "set-point of first",
        "set-point of second",
    ]
    assert record_of(there_and_back(description_message(two, 0.5))) == two
    with pytest.raises(SignalError, match="output: there are 2 of them"):
        _ = two.output
    message.input = []
    with pytest.raises(MessageError, match="input is empty; a plant has at least one"):
        check(message)


def test_a_forecast_of_several_signals_is_carried_sample_by_sample() -> None:
    rows = np.arange(24.0).reshape(6, 4)
    bands = [Band(row, row - 0.5, row + 1.5) for row in rows]
    foretold = Forecast(
        3,
        "c",
        "s",
        0.9,
        np.arange(1.0, 5.0),
        rows[:2].T,
        tuple(bands[:2]),
        tuple(bands[2:5]),
    )
    message = there_and_back(message_of(foretold, 5))
    check(message)
    assert list(message.output) == [0.0, 4.0, 1.0, 5.0, 2.0, 6.0, 3.0, 7.0]
    assert repr(record_of(message)) == repr(foretold)
    part = record_of(message_of(foretold.at((1, 4)), 5))
    assert [band.low.tolist() for band in part.outputs] == [[-0.5, 2.5], [3.5, 6.5]]
    # of a twin whose loop is not known
    driven = replace(foretold, references=np.full((4, 2), np.nan))
    message = there_and_back(message_of(driven, 5))
    check(message)
    assert repr(record_of(message)) == repr(driven)
    message.reference[0] = math.inf
    with pytest.raises(MessageError, match="reference is inf; expected"):
        check(message)
    message = there_and_back(message_of(foretold, 5))
    message.output = [1.0] * 7
    with pytest.raises(
        MessageError,
        match="output has 7 values for its times; expected 4, or that of each",
    ):
        check(message)
    message.output = [1.0] * 4
    with pytest.raises(
        MessageError, match="output_low has 8 values for its means; expected 4"
    ):
        check(message)


@pytest.mark.parametrize("kind", [messages.Match, messages.ModelScore])
def test_every_word_has_a_number_of_its_own(kind: Any) -> None:
    words: Any = {messages.Match: Status, messages.ModelScore: TrustLevel}[kind]
    assert sorted(getattr(kind, word.value.upper()) for word in words) == list(
        range(len(words))
    )


def test_a_words_number_is_beside_it() -> None:
    verdict = Verdict(
        0, 0, 0, TrustLevel.DOUBTFUL, "", True, None, "", 2, (), None, (), 0.0, 0.0
    )
    message = message_of(verdict, 0)
    assert (message.level, message.level_name) == (
        messages.ModelScore.DOUBTFUL,
        "doubtful",
    )
