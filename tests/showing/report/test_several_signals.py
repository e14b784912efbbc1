"""The report on a plant with two loops: every signal by its name, each in charts and tables of its own."""

from __future__ import annotations

import re

import pytest

from tests.showing.conftest import LIES_FROM
from tests.showing.report.conftest import Element, grid, parse, tables_of
from tests.support.exchanging import Heaters
from tests.twin.test_several_signals import LAW, closed
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.sessions import samples_of
from twinmatch.showing.figures.session import draw_health, draw_session
from twinmatch.showing.quantities import number, percent
from twinmatch.showing.report.report import SessionReport
from twinmatch.showing.report.words import plain_words, session_facts
from twinmatch.showing.verdicts import trust_by_signal
from twinmatch.twin import TwinSettings

T1 = "temperature T1"
T2 = "temperature T2"


@pytest.fixture(scope="module")
def document(kit_report: SessionReport) -> Element:
    return parse(kit_report.html())


def test_every_signal_has_a_chart_with_its_name(kit_report: SessionReport) -> None:
    named = {
        name: "".join(re.findall(r"<!-- (.*?) -->", p.svg))
        for name, p in kit_report.pictures.items()
    }
    for name in ("session", "responses", "uncertainty"):
        for signal in (f"{T1} / °C", f"{T2} / °C", "heater 1 / %", "heater 2 / %"):
            assert signal in named[name], (name, signal)
    assert f"{T1}" in named["health"]
    assert f"{T2}" in named["health"]
    for k, signal in enumerate((T1, T2)):
        ending = "_second_temperature" if k else ""
        for name in ("forecasts", "leader_forecasts"):
            assert f"{signal} / °C" in named[f"{name}{ending}"]
            assert kit_report.pictures[f"{name}{ending}"].title.endswith(f": {signal}")
    # of models that a plant with two loops does not have
    assert "criteria" not in kit_report.pictures
    assert f"{T2} / °C" in named["estimates"]


def test_its_facts_are_those_of_each_signal(document: Element, two: Judgement) -> None:
    facts = {
        row[0].text: row[1].text
        for row in grid(tables_of(document)["The session in numbers"])
    }
    for k, signal in enumerate((T1, T2)):
        readings = [sample.outputs[k] for sample in two.samples]
        assert (
            facts[signal]
            == f"{number(min(readings), 1)} to {number(max(readings), 1)} °C"
        )
        (fit,) = (
            value for name, value in facts.items() if name.endswith(f", {signal}")
        )
        assert two.summary.fits is not None
        assert fit.startswith(f"fit {percent(two.summary.fits.outputs[k])} %")
        inputs = [sample.inputs[k] for sample in two.samples]
        ends = (
            f"{number(min(inputs), 0)} to {number(max(inputs), 0)} % (limits 0 to 100)"
        )
        assert facts[f"heater {k + 1}"] == ends


def test_trust_has_a_row_for_each_signal(document: Element, two: Judgement) -> None:
    rows = grid(
        tables_of(document)["How far to trust the leader's forecasts of each signal"]
    )
    assert [row[0].text for row in rows] == [T1, T2]
    for row, score in zip(rows, two.verdicts[-1].signals, strict=True):
        assert row[2].text == ", ".join(percent(share, 0) for share in score.coverage)
        assert row[5].text == number(score.miss)
    assert [row[1].text for row in rows] == ["10, 60 and 300", "60 and 300"]


def test_each_output_is_compared_with_its_measurements(
    document: Element, kit_report: SessionReport
) -> None:
    tests = kit_report.judged.tests
    assert [test.name for test in tests] == [
        "kit, temperature",
        "kit, second_temperature",
    ]
    text = document.text
    for signal, tested in zip((T1, T2), tests, strict=True):
        card = next(
            card
            for card in tested.cards
            if (card.who, card.horizon) == ("leader", 60.0)
        )
        assert f"60 s ahead, the leader's {signal} was off by less than" in text
        assert card.median < next(
            c.median
            for c in tested.cards
            if (c.who, c.horizon) == ("persistence", 60.0)
        )
        assert f"At the end the forecasts of {signal} pass the test of trust" in text


def test_the_family_is_listed_without_models(document: Element, two: Judgement) -> None:
    tables = tables_of(document)
    last = two.verdicts[-1]
    family = grid(tables["Parameters of the family, with 95 % intervals"])
    assert [row[0].text for row in family] == [
        candidate.name for candidate in last.candidates
    ]
    assert all(re.fullmatch(r"\d+ to \d+", row[1].text) for row in family)
    assert (
        "Box–Jenkins models, their orders and the criteria of the paper are for one loop"
        in document.text
    )
    assert "No models were identified." in document.text


def test_a_sensor_that_is_read_through_is_said_and_drawn(
    document: Element, two: Judgement
) -> None:
    (course,) = two.estimates
    assert (course.text, course.last) == (T2, two.samples[-1].index)
    assert (
        f"The twin reads through {T2} from {course.first} to {course.last} s"
        in document.text
    )
    assert f"fault: sensor-drift of {T2}" in document.text
    assert (
        f"The plant had a fault: sensor-drift of {T2} since {LIES_FROM} s"
        in document.text
    )
    errors = [
        value - (reading - 5.0)
        for value, reading in zip(course.values, course.readings, strict=True)
    ]
    assert max(map(abs, errors)) < 2.5  # the sensor that lies is 5 °C off


def test_in_a_known_loop_its_commands_are_shown_likewise() -> None:
    judged = judge_samples(
        "loops",
        samples_of(closed().part(0, 260)),
        TwinSettings.of(Heaters, period=2.0, law=LAW),
    )
    four = ["first", "second", "first power", "second power"]
    assert [row["signal"] for row in trust_by_signal(judged.verdicts[-1])] == four
    health = draw_health(
        judged.samples, judged.matches, judged.verdicts, judged.settings
    )
    assert [axes.get_ylabel().split("\n")[0] for axes in health.axes[1:-1]] == four
    session = draw_session(
        judged.samples, judged.verdicts, judged.settings, judged.stretches
    )
    labels = [axes.get_ylabel() for axes in session.axes]
    difference_labels = ["plant − twin / °C", "plant − twin / %"]
    assert labels == [
        "first / °C",
        "first power / %",
        *difference_labels,
        "second / °C",
        "second power / %",
        *difference_labels,
    ]
    facts = dict(session_facts(judged))
    fits = judged.summary.fits
    assert fits is not None
    for name, share in zip(four, (*fits.outputs, *fits.inputs), strict=True):
        (fit_text,) = (
            fact
            for title, fact in facts.items()
            if title.startswith("closed-loop") and title.endswith(f", {name}")
        )
        assert fit_text.startswith(f"fit {percent(share)} %")
    assert {"set-point of first", "set-point of second"} <= set(facts)
    words = " ".join(plain_words(judged))
    assert "was controlled to set-points from" in words
    assert (
        "its first and second and the control (first_power and second_power) were recorded"
        in words
    )
