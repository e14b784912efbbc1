"""The page of a plant with two loops: a column of charts, figures and trust for each of its signals."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from bokeh.document import Document

from tests.showing.page.test_page import opened, source
from twinmatch.forecasting import Band, Forecast
from twinmatch.health import EstimatedReading
from twinmatch.offline.judging import Judgement
from twinmatch.plants.records import description_of
from twinmatch.plants.tclab import TCLabBoth
from twinmatch.showing.page import panels
from twinmatch.showing.page.state import (
    DashboardState,
    DriveReport,
    TwinRow,
    update_sentence,
)
from twinmatch.showing.summary import sentence
from twinmatch.showing.verdicts import trust_by_signal
from twinmatch.twin import Mirror

T1 = "temperature T1"
T2 = "temperature T2"
KINDS = ("output", "control", "residual", "control_residual")


@pytest.fixture(scope="module")
def state(two: Judgement) -> DashboardState:
    """After the whole session."""
    state = DashboardState()
    mirror = Mirror(two.settings.start, two.settings.law)
    state.push_sample(two.samples[0], 0.0)
    assert state.sample is None  # nobody has said yet what plant this is
    state.describe(description_of(TCLabBoth))
    for sample in two.samples:
        state.push_sample(sample, 0.0)
        twin = mirror.push(sample)
        state.push_twin(
            sample.index, TwinRow(*(getattr(twin, name) for name in TwinRow._fields))
        )
    for verdict in two.verdicts:
        state.push_verdict(verdict)
    (course,) = two.estimates
    last = {
        "value": course.values[-1],
        "band": course.bands[-1],
        "reading": course.readings[-1],
    }
    course_fields = {"since": course.first, "wide": course.wide, "good": course.good}
    state.push_estimate(
        EstimatedReading(course.last, course.signal, **last, **course_fields)
    )
    update_sentence(state, two.settings)
    return state


@pytest.fixture(scope="module")
def document(state: DashboardState) -> Document:
    return opened(state)[1]


def test_every_signal_is_drawn_in_a_column_of_its_own(
    document: Document, two: Judgement
) -> None:
    rows = document.template_variables["charts"]
    assert rows == [[kind, f"{kind}_2"] for kind in KINDS]
    labels = [
        document.get_model_by_name(name).yaxis[0].axis_label
        for name in (*rows[0], *rows[1])
    ]
    beside = [document.get_model_by_name(name) for row in rows for name in row]
    # One axis below all of them would line up with neither column.
    assert {chart.xaxis[0].major_label_text_font_size for chart in beside} == {"12px"}
    # Nothing can be asked of several loops, so nothing is said of an answer.
    assert "what if" not in [
        item.label.value for chart in beside for item in chart.legend[0].items
    ]
    assert labels == [f"{T1} / °C", f"{T2} / °C", "heater 1 / %", "heater 2 / %"]
    shown = two.samples[-1200:]  # twenty minutes
    for k, ending in enumerate(("", "_2")):
        drawn = source(document, f"output{ending}").data
        assert drawn[f"output{ending}"].tolist() == [
            sample.outputs[k] for sample in shown
        ]
        assert drawn[f"reference{ending}"].tolist() == [
            sample.references[k] for sample in shown
        ]
        assert source(document, f"control{ending}").data[f"input{ending}"].tolist() == [
            s.inputs[k] for s in shown
        ]
        twin = source(document, f"residual{ending}").data
        difference = (
            twin[f"driven_residual_y{ending}"]
            - [s.outputs[k] for s in shown]
            + twin[f"driven_output{ending}"]
        )
        assert np.abs(difference).max() < 1e-9
        assert (
            twin[f"driven_rms_y{ending}_high"] == 2.0 * twin[f"driven_rms_y{ending}"]
        ).all()


def test_each_forecast_is_drawn_on_its_signals_charts(state: DashboardState) -> None:
    time = np.arange(1.0, 61.0)
    made_at_sample = state.sample
    assert made_at_sample is not None
    signals = [
        Band(np.full(60, float(k)), np.full(60, k - 1.0), np.full(60, k + 1.0))
        for k in range(4)
    ]
    asked = np.tile([50.0, 40.0], (60, 1))
    outputs = tuple(signals[:2])
    inputs = tuple(signals[2:])
    state.push_forecast(
        Forecast(made_at_sample, "twin", "", 0.9, time, asked, outputs, inputs)
    )
    _, document = opened(state)
    for k, ending in enumerate(("", "_2")):
        drawn = [
            r.data_source.data
            for r in document.get_model_by_name(f"output{ending}").renderers
        ]
        (ahead,) = {
            id(data): data for data in drawn if len(data.get("output_low", ())) == 60
        }.values()
        assert (ahead["output"][0], ahead["output_high"][0], ahead["input"][0]) == (
            k,
            k + 1.0,
            k + 2.0,
        )
        assert ahead["reference"][0] == asked[0, k]
    text = panels.first_screen(state)
    assert f"{T1}, {T2} in 60 s" in text
    assert re.search(r"\b0\.0* °C; 1\.0* °C", text)


def test_its_texts_name_signals_trust_and_what_a_sensor_should_read(
    state: DashboardState, two: Judgement
) -> None:
    first = panels.first_screen(state)
    tiles = panels.tiles(state)
    (course,) = two.estimates
    reading_sentence = f"the twin reads through {T2}: {course.values[-1]:.1f} ± {course.bands[-1]:.1f} °C"
    assert reading_sentence in first
    assert f"sensor drift of {T2}" in first
    for words in (
        f"set-point of {T1} / °C",
        f"{T1} / °C",
        f"{T2} / °C",
        "plant&#x27;s heater 2 / %",
    ):
        assert words in tiles
    reasons = panels.reasons(two.verdicts[-1], 1.0, state.sentence)
    for row in trust_by_signal(two.verdicts[-1]):
        assert "".join(f"<td>{cell}</td>" for cell in row.values()) in reasons
    assert state.sentence == sentence(two.summary)
    family = panels.family_table(two.verdicts[-1], all_orders=False)
    assert all(candidate.name in family for candidate in two.verdicts[-1].candidates)
    assert "order" not in family


def test_the_health_of_the_plant_is_what_was_said_when_the_fault_was_named(
    two: Judgement,
) -> None:
    named_at = next(k for k, verdict in enumerate(two.verdicts) if verdict.fault)
    named, *after = two.verdicts[named_at:]
    assert after
    # of other things
    assert all(verdict.fault and verdict.reason != named.reason for verdict in after)
    whole = DashboardState(described=description_of(TCLabBoth))
    late = DashboardState(described=description_of(TCLabBoth))
    for verdict in two.verdicts:
        whole.push_verdict(verdict)
    late.push_verdict(two.verdicts[-1])
    late.push_plant_report(f"{named.named_fault}: {named.reason}")
    for state in (whole, late):
        words = panels.first_screen(state)
        assert f"since {named.fault_since} s: {named.reason}" in words
        assert two.verdicts[-1].reason not in words
    # of a verdict that is yet to be received
    whole.push_plant_report("drive-lost: the drive does nothing")
    assert whole.fault_reason == named.reason
    whole.push_verdict(replace(two.verdicts[-1], fault="", fault_signal=""))
    assert whole.fault_reason == ""


def test_what_was_applied_after_a_played_session_is_not_shown_beside_its_last_sample(
    two: Judgement,
) -> None:
    state = DashboardState(described=description_of(TCLabBoth))
    state.push_sample(two.samples[0], 0.0)
    state.push_drive(DriveReport((0.0, 0.0), math.nan, ""))
    assert "applied / %" in panels.tiles(state)
    position = {"rate": "50", "paused": "False", "position": "13.0 s of 13.0 s"}
    state.push_health("player", 0, "ended", {**position, "ended": "True"}, 1.0)
    assert "applied / %" not in panels.tiles(state)
    assert "applied after the end / %" in panels.tiles(state)


def test_an_estimate_goes_when_it_is_over(two: Judgement) -> None:
    state = DashboardState(described=description_of(TCLabBoth))
    for sample in two.samples[:20]:
        state.push_sample(sample, 0.0)
        if sample.index < 10:
            good = {"since": 0, "wide": 1.2, "good": 60.0}
            state.push_estimate(
                EstimatedReading(sample.index, "temperature", 41.0, 0.5, 46.0, **good)
            )
        assert bool(state.read_through) is (sample.index <= 14)
