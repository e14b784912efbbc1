"""The documents of the tabs, without a browser: what they are sent, and that they do not grow."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from bokeh.document import Document
from bokeh.events import ButtonClick
from bokeh.models import Button, ColumnDataSource

from tests.support.colours import contrast
from twinmatch.comparing import Verdict
from twinmatch.forecasting import Band, Forecast
from twinmatch.offline.judging import Judgement
from twinmatch.plants import TCLabBoth
from twinmatch.plants.records import description_of
from twinmatch.safety import LawReport, TrialPhase
from twinmatch.showing.page.charts import POINTS, ChartFeed, stride_for
from twinmatch.showing.page.heatmaps import GapMatrix
from twinmatch.showing.page.state import (
    DashboardState,
    RollingTable,
    TwinRow,
    WhatIfAnswer,
)
from twinmatch.showing.page.tab import Tab, question_form, rig_form
from twinmatch.signals import Sample
from twinmatch.twin.experiment import ExperimentPhase, ExperimentReport


class Nothing:
    """A page that can ask for nothing."""

    control = False

    def what_if(self, level: float, hold: float | None) -> None:
        raise AssertionError(level, hold)

    def next_experiment(self, *, run: bool = False, stop: bool = False) -> None:
        raise AssertionError(run, stop)


def fill(state: DashboardState, first: int, number: int, period: float = 0.1) -> None:
    for k in range(first, first + number):
        temperature = 40.0 + np.sin(k / 100)
        state.push_sample(
            Sample(k, round(k * period * 1e9), 50.0, temperature, k % 7), k * period
        )
        state.push_twin(k, TwinRow(*[float(k % 13)] * len(TwinRow._fields)))


def opened(state: DashboardState, now: float = 0.0) -> tuple[Tab, Document]:
    page = Tab(state, Nothing(), clock=lambda: now)
    document = Document()
    page.build(document)
    return page, document


def source(document: Document, chart: str, renderer: int = 0) -> ColumnDataSource:
    data_source: ColumnDataSource = (
        document.get_model_by_name(chart).renderers[renderer].data_source
    )
    return data_source


@pytest.mark.parametrize("samples", [1, 300, POINTS, POINTS + 1, 12_000, 36_000])
def test_no_line_has_more_points_than_a_screen(samples: int) -> None:
    history = RollingTable(("value",), 36_000)
    feed = ChartFeed(history)
    for k in range(2 * samples):
        history.push(k, (float(k),))
        if k % max(1, samples // 5) == 0:
            feed.update(0.1, samples)
    feed.update(0.1, samples)
    drawn = feed.source.data["t"]
    assert len(drawn) <= POINTS + 2
    stride = stride_for(samples)
    newest = drawn[-1] / 0.1
    oldest = drawn[0] / 0.1
    assert 2 * samples - 1 - stride <= newest <= 2 * samples - 1
    assert samples - 2 * stride <= newest - oldest + 1 <= samples + stride
    assert np.all(np.diff(drawn) > 0)


def fed(number: int, value: float = 1.0) -> tuple[RollingTable, ChartFeed]:
    history = RollingTable(("value",), 1000)
    push(history, number, value)
    return history, ChartFeed(history)


def push(history: RollingTable, number: int, value: float) -> None:
    for _ in range(number):
        history.push(history.count, (value,))


def test_only_what_is_new_is_sent() -> None:
    history, feed = fed(100)
    sent = []
    document = Document()
    document.add_root(feed.source)
    document.on_change(sent.append)
    feed.update(1.0, 500)
    push(history, 1, 100.0)
    feed.update(1.0, 500)
    feed.update(1.0, 500)
    assert [type(event).__name__ for event in sent] == [
        "ColumnDataChangedEvent",
        "ColumnsStreamedEvent",
    ]
    assert sent[1].data["value"].tolist() == [100.0]


def test_a_new_session_or_period_is_drawn_again() -> None:
    history, feed = fed(50)
    feed.update(1.0, 500)
    feed.update(0.5, 500)
    assert feed.source.data["t"][-1] == 24.5
    history.clear()
    push(history, 60, 2.0)
    feed.update(0.5, 500)
    assert set(feed.source.data["value"]) == {2.0}
    assert len(feed.source.data["t"]) == 60


def test_tabs_opened_early_and_late_show_the_same(judged: Judgement) -> None:
    state = DashboardState()
    early, first = opened(state)
    for k, sample in enumerate(judged.samples):
        state.push_sample(sample, 0.0)
        if k % 150 == 0:
            early.update()
    for verdict in judged.verdicts:
        state.push_verdict(verdict)
        early.update()
    _, second = opened(state)
    for chart, renderer in (
        ("output", 0),
        *((name, k) for name in ("matrix", "happened") for k in (0, 1)),
    ):
        data_of_first = source(first, chart, renderer).data
        data_of_second = source(second, chart, renderer).data
        assert {k: list(v) for k, v in data_of_first.items()} == {
            k: list(v) for k, v in data_of_second.items()
        }, chart
    for name in ("first", "reasons", "family", "events", "tiles", "status"):
        assert first.get_model_by_name(name).text == second.get_model_by_name(name).text


def test_every_tab_has_its_own_view_of_the_same() -> None:
    state = DashboardState()
    fill(state, 0, 400, period=1.0)
    near, first = opened(state)
    far, second = opened(state)
    first.get_model_by_name("span").active = 0
    fill(state, 400, 1, period=1.0)
    for page in (near, far):
        page.update()
    # five minutes
    assert list(source(first, "output").data["t"]) == [
        float(k) for k in range(101, 401)
    ]
    assert list(source(second, "output").data["t"]) == [float(k) for k in range(401)]


def matrix_of(verdict: Verdict) -> Any:
    """The chart of a verdict's matrix alone: a whole tab takes half a second to make."""
    matrix = GapMatrix()
    matrix.update(verdict)
    return matrix.figure


def cells_of(chart: Any, renderer: int) -> Any:
    """What one of its renderers draws, by columns."""
    return chart.renderers[renderer].data_source.data


def test_the_matrix_has_its_gaps_sums_and_intervals(judged: Judgement) -> None:
    last = judged.verdicts[-1]
    count = len(last.candidates)
    low = tuple(0.1 * k for k in range(count))
    high = tuple(0.1 * k + 0.05 for k in range(count))
    sure = replace(
        last,
        candidates=tuple(
            replace(c, nu_gap_low=low, nu_gap_high=high) for c in last.candidates
        ),
    )
    for verdict, interval in ((sure, "0.100 to 0.150"), (last, None)):
        chart = matrix_of(verdict)
        cells = cells_of(chart, 0)
        sums = cells_of(chart, 2)
        nominal = str(
            1 + [c.name for c in verdict.candidates].index(verdict.nominal or "")
        )
        assert cells["gap"] == [gap for line in verdict.nu_gap for gap in line]
        assert sums["gap"] == [c.nu_gap_sum for c in verdict.candidates]
        assert [
            sums["column"][k] for k, s in enumerate(sums["style"]) if s == "bold"
        ] == [nominal]
        assert interval is None or cells["interval"][1] == interval


def test_any_number_of_candidates_with_long_names_has_room_in_the_matrix(
    judged: Judgement,
) -> None:
    """Columns bear numbers, rows the names on two lines at most; tooltips say all of it."""
    verdict = judged.verdicts[-1]
    name = "sink with mass, free ambient, free ripple, sensor lag"
    eight = tuple(replace(verdict.candidates[0], name=f"{name}, {k}") for k in range(8))
    places = np.arange(8.0)
    distances = np.abs(places[:, None] - places) / 10
    gaps = tuple(map(tuple, distances.tolist()))
    chart = matrix_of(
        replace(verdict, candidates=eight, nominal=eight[2].name, nu_gap=gaps)
    )
    cells = cells_of(chart, 0)
    assert chart.x_range.factors == [str(k) for k in range(1, 9)]
    assert len(set(chart.y_range.factors)) == 9
    for row in chart.y_range.factors:
        assert row.count("\n") <= 1
        assert max(len(line) for line in row.split("\n")) <= 24
    assert chart.height >= 9 * 30
    assert cells["pair"][1] == f"{eight[0].name} and {eight[1].name}"
    assert set(cells["ink"]) == {"#FFFFFF", "#000000"}


def forecast(sample: int) -> Forecast:
    time = np.array([1.0, 10.0, 60.0, 75.0, 90.0, 300.0])
    level = 40.0 + time / 100
    bands = [
        (Band(level, level - 1.0, level + 1.0),),
        (Band(time, time - 9.0, time + 9.0),),
    ]
    return Forecast(
        sample, "50 °C", "held sink", 0.9, time, np.full(time.size, 50.0), *bands
    )


def test_what_comes_is_drawn_as_far_as_the_span_has_room() -> None:
    """A quarter of five minutes is 75 s; of twenty, all of it. The axis reaches as much further."""
    state = DashboardState()
    page, document = opened(state)
    fill(state, 0, 400, period=1.0)
    time = document.get_model_by_name("output").x_range
    page.update()
    assert (list(source(document, "output", 3).data["t"]), time.follow_interval) == (
        [],
        1200.0,
    )
    state.push_forecast(forecast(399))
    page.update()
    drawn = source(document, "output", 3).data
    assert list(drawn["t"]) == [400.0, 409.0, 459.0, 474.0, 489.0, 699.0]
    assert list(drawn["output_low"]) == list(drawn["output"] - 1.0)
    assert source(document, "control", 2) is source(document, "output", 3)
    assert time.follow_interval == 1500.0
    document.get_model_by_name("span").active = 0
    page.update()
    assert list(source(document, "output", 3).data["t"]) == [400.0, 409.0, 459.0, 474.0]
    assert time.follow_interval == 375.0


def test_an_answer_stays_until_the_next_and_goes_with_the_session() -> None:
    state = DashboardState()
    page, document = opened(state)
    fill(state, 0, 400, period=1.0)
    state.answer(
        WhatIfAnswer("set-point <b>60</b> °C", ("so <i>it</i> is",), forecast(350))
    )
    page.update()
    text = document.get_model_by_name("answer").text
    assert "set-point &lt;b&gt;60&lt;/b&gt; °C" in text
    assert "so &lt;i&gt;it&lt;/i&gt; is" in text
    assert source(document, "output", 6).data["t"][0] == 351.0
    state.answer(WhatIfAnswer("set-point 400 °C", ("no",)))
    page.update()
    assert len(source(document, "output", 6).data["t"]) == 0
    state.push_forecast(forecast(399))
    assert state.current_forecast is not None
    assert state.leader == "50 °C"
    fill(state, 0, 2, period=1.0)
    page.update()
    assert document.get_model_by_name("answer").visible is False
    state.push_forecast(forecast(400))  # one of the session before that came late
    page.update()
    assert state.current_forecast is None
    assert len(source(document, "output", 3).data["t"]) == 0


def test_the_form_asks_what_is_entered() -> None:
    heard: list[tuple[float, float | None]] = []
    asked: list[tuple[bool, bool]] = []
    continued: list[bool] = []

    class Asked(Nothing):
        def what_if(self, level: float, hold: float | None) -> None:
            heard.append((level, hold))

        def next_experiment(self, *, run: bool = False, stop: bool = False) -> None:
            asked.append((run, stop))

        def continue_profile(self) -> None:
            continued.append(True)

        def law_back(self) -> None: ...

        def clear_fault(self) -> None: ...

        def stop(self) -> None: ...

    document = Document()

    def press(button: Button) -> None:
        document.callbacks.trigger_event(ButtonClick(button))

    form = question_form(Asked(), "set-point / °C")
    document.add_root(form)
    level, time, button = form.children
    press(button)
    assert heard == []  # nothing was entered
    for hold in (None, 90.0):
        level.value = 55.0
        time.value = hold
        press(button)
    assert heard == [(55.0, None), (55.0, 90.0)]
    commands = rig_form(Asked(), "")
    document.add_root(commands)
    for button in commands.children[:4]:
        press(button)
    assert asked == [(False, False), (True, False), (False, True)]
    assert continued == [True]


def test_experiments_and_laws_on_trial_are_events() -> None:
    """The page says what was proposed, what runs and why it ended."""
    state = DashboardState()
    fill(state, 0, 2, period=1.0)
    page, document = opened(state)
    running = ExperimentReport(
        1,
        ExperimentPhase.RUNNING,
        "structure",
        0,
        9.0,
        2.0,
        (30.0, 25.0),
        (60.0, 1.0),
        "…",
    )
    state.push_experiment(running)
    assert state.notice is None
    state.push_experiment(
        replace(
            running,
            phase=ExperimentPhase.DECIDED,
            levels=(),
            holds=(),
            reason="held sink",
        )
    )
    assert state.notice == (True, "decided: held sink")
    state.push_law(
        LawReport(1, TrialPhase.BACK, 1, reason="output 1 is 90, not 39 to 41")
    )
    page.update()
    events = document.get_model_by_name("events").text
    for words in (
        "running, for structure: 2 of 9 bits; hold 30 for 60 s",
        "law on trial: back",
        "is 90, not",
    ):
        assert words in events


def test_without_control_the_document_has_no_button_for_it() -> None:
    _, document = opened(DashboardState())
    assert document.get_model_by_name("rig") is None
    assert document.template_variables["control"] is False


def test_an_open_page_takes_no_more_room_however_long(judged: Judgement) -> None:
    state = DashboardState(capacity=500)
    page, _ = opened(state)
    state.push_verdict(judged.verdicts[-1])

    def run(first: int, number: int) -> int:
        for k in range(first, first + number, 25):
            fill(state, k, 25)
            page.update()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    run(0, 750)
    tracemalloc.start()
    settled = run(750, 250)
    grown = run(1_000, 1_000) - settled
    tracemalloc.stop()
    assert grown < 100_000, f"{grown} bytes more"


def test_letters_in_the_charts_can_be_read(judged: Judgement) -> None:
    """The browser's check sees text of the page only; titles, ticks, legends and labels are drawn."""
    # the WCAG's own example
    assert contrast("#777777", "#FFFFFF") == pytest.approx(4.48, abs=0.01)
    state = DashboardState()
    for verdict in judged.verdicts:
        state.push_verdict(verdict)
    fill(state, 0, 300)
    _, document = opened(state, 30.0)
    looked_at = set()
    for model in document.models:
        for name in model.properties():
            colour = getattr(model, name) if name.endswith("text_color") else None
            if isinstance(colour, str) and colour.startswith("#"):
                looked_at.add(name)
                assert contrast(colour, "#FFFFFF") >= 4.5, (model, name, colour)
    assert looked_at >= {
        "text_color",
        "axis_label_text_color",
        "major_label_text_color",
        "label_text_color",
    }


def test_a_tab_asks_to_be_reloaded_until_it_is() -> None:
    """A browser that takes the document after the first time sees a change all the same."""
    state = DashboardState()
    page, document = opened(state)
    status = document.get_model_by_name("status")
    page.update()
    assert status.tags == []
    state.describe(description_of(TCLabBoth))
    asked = []
    for _ in range(3):
        page.update()
        asked.append(list(status.tags))
    assert [plant for plant, _ in asked] == [TCLabBoth.name] * 3
    assert len({number for _, number in asked}) == 3
    _, reloaded = opened(state)
    assert reloaded.get_model_by_name("status").tags == []


def test_a_tab_is_sent_one_thermal_image_a_second() -> None:
    now = [0.0]
    state = DashboardState()
    page = Tab(state, Nothing(), clock=lambda: now[0])
    document = Document()
    page.build(document)
    drawn = {}
    for tenth in range(25):
        now[0] = tenth / 10
        state.push_image(np.full((4, 5), 20.0 + tenth, dtype=np.float32))
        page.update()
        drawn[tenth] = float(source(document, "thermal").data["image"][0][0, 0]) - 20.0
    assert set(drawn.values()) == {0.0, 10.0, 20.0}
    assert (drawn[9], drawn[10], drawn[24]) == (0.0, 10.0, 20.0)
