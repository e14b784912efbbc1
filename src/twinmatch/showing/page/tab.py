"""The document of one browser tab: built once, then updated a few times a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from bokeh.document import Document
from bokeh.models import CustomJS, Div, Toggle

from twinmatch.comparing import TrustLevel
from twinmatch.showing.page import panels
from twinmatch.showing.page.charts import ChartFeed, TimeCharts, bands, seconds_ahead
from twinmatch.showing.page.heatmaps import GapMatrix, ThermalImage
from twinmatch.showing.page.state import DashboardState
from twinmatch.showing.page.style import FONT, THEME, panel
from twinmatch.showing.page.widgets import PlayerButtons, QuestionForm, RigButtons, SpanButtons
from twinmatch.showing.style import LEVELS, TEXT

if TYPE_CHECKING:
    from twinmatch.showing.page.requests import Requests

REFRESH = 350
"""Milliseconds between two updates of a tab."""
_COME_BACK = """
const come_back = async () => {
    try {
        if ((await fetch(location.href, {cache: "no-store"})).ok) { location.reload(); return }
    } catch { /* the server is not back yet */ }
    setTimeout(come_back, 2000)
}
setTimeout(come_back, 1000)
"""
"""In the browser, when the connection is lost: reload the page as soon as the server is back."""
_TEMPLATE = Path(__file__).with_name("page.html")


class Tab:
    """One tab. Nothing in it grows: charts drop their oldest points, texts are replaced."""

    def __init__(
        self, state: DashboardState, requests: Requests, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Show a state; `clock` is the one that its times are taken from."""
        self._state, self._clock = state, clock
        self._plant = ChartFeed(state.plant)
        self._twin = ChartFeed(state.twin, bands)
        self._described = described = state.described
        self._charts = TimeCharts(self._plant.source, self._twin.source, described)
        self._matrix, self._thermal = GapMatrix(), ThermalImage()
        names = (
            *("status", "alarm", "first", "reasons", "tiles", "family", "events", "nodes"),
            *("matrix_note", "chart_note", "answer"),
        )
        self._texts: dict[str, Div] = {name: panel(name) for name in names}
        self._every = Toggle(label="all orders", name="every", width=110)
        self._span = SpanButtons()
        self._player = PlayerButtons(requests)
        self._question = QuestionForm(requests, described.reference.label)
        self._rig = RigButtons(requests, described.reference.label) if requests.control else None
        if self._rig is not None:
            self._texts["notice"] = panel("notice")
        self._seen: dict[str, object] = {}

    def build(self, document: Document) -> None:
        """Make the document, and keep it up to date for as long as its tab is open."""
        roots = [
            *self._charts.figures,
            self._matrix.figure,
            self._thermal.root,
            *self._texts.values(),
            self._every,
            self._span.root,
            self._player.root,
            self._question.root,
        ]
        if self._rig is not None:
            roots.append(self._rig.root)
        with document.models.freeze():  # otherwise every root scans the whole document again
            for root in roots:
                document.add_root(root)
        title = self._described.title
        document.title = f"twinmatch: {title}" if title else "twinmatch"
        self._texts["status"].js_on_change("tags", CustomJS(code="location.reload()"))
        document.theme = THEME
        document.template = _TEMPLATE.read_text(encoding="utf-8")
        document.template_variables.update(
            control=self._rig is not None,
            plant_title=title,
            font=FONT,
            ink=TEXT,
            good=LEVELS[TrustLevel.TRUSTED],
            fault=LEVELS[TrustLevel.FAULT],
        )
        document.config.reconnect_session = False  # a restarted server does not know the old session
        document.js_on_event("document_ready", self._charts.fit_to_narrow)
        document.js_on_event("connection_lost", CustomJS(code=_COME_BACK))
        self.update()
        document.add_periodic_callback(self.update, REFRESH)

    def update(self) -> None:
        """Update whatever has changed."""
        state, now = self._state, self._clock()
        with state.lock:
            state.nodes.expire(now)
            span = self._span.samples(state.period, state.plant.capacity)
            self._plant.update(state.period, span)
            self._twin.update(state.period, span)
            self._draw_forecast(span * state.period)
            self._update_texts(now)
            if self._changed("happened", (state.verdicts, state.event_count, state.period)):
                mine = [e for e in reversed(state.events) if e.session == state.session]
                self._charts.draw_events(state.trust, mine, state.period)
                events = panels.events_table(reversed(state.events), state.session, state.period)
                self._show("events", events)
            if self._changed("family", (state.verdicts, self._every.active)):
                self._matrix.update(state.verdict)
                none_yet = state.verdict is None or not state.verdict.candidates
                self._matrix.figure.visible = not none_yet
                self._show("matrix_note", panels.NO_CANDIDATE if none_yet else "")
                self._show("family", panels.family_table(state.verdict, every=bool(self._every.active)))
            if self._changed("image", state.images) and state.image is not None:
                self._thermal.update(state.image)
            self._player.update(state.nodes.player)
            if self._changed("described", state.described) and state.described != self._described:
                self._texts["status"].tags = [state.described.plant]  # reloads the page, with these names

    def _draw_forecast(self, span: float) -> None:
        """Show the newest `span` seconds, and the forecast after them."""
        state, forecast = self._state, self._state.current_forecast
        if self._changed("forecast", (span, state.forecast_changes, state.period, forecast is None)):
            most = seconds_ahead(span)
            what_if = None if state.what_if is None else state.what_if.forecast
            self._charts.forecasts.update(forecast, what_if, state.period, most)
            self._charts.span(span if forecast is None else span + most)
            self._show("answer", panels.what_if(state.what_if))

    def _update_texts(self, now: float) -> None:
        state = self._state
        self._show("status", panels.status(state, now))
        self._show("alarm", panels.alarm(state))
        self._show("first", panels.first_screen(state))
        self._show("reasons", panels.reasons(state.verdict, state.period, state.sentence))
        self._show("tiles", panels.tiles(state))
        self._show("nodes", panels.nodes(state.nodes, now))
        self._charts.show(measured=state.plant.count > 0, mirrored=state.twin.count > 0)
        self._show("chart_note", "" if state.plant.count else panels.NO_SAMPLE)
        if self._rig is not None:
            self._show("notice", panels.notice(state))

    def _show(self, name: str, html: str) -> None:
        place = self._texts[name]
        if place.text != html:
            place.text = html
        if place.visible != bool(html):
            place.visible = bool(html)

    def _changed(self, name: str, value: object) -> bool:
        if self._seen.get(name) == value:
            return False
        self._seen[name] = value
        return True
