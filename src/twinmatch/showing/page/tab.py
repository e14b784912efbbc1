"""The document of one browser tab, built once, then updated a few times a second, and its controls."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bokeh.document import Document
from bokeh.models import (
    Button,
    CustomJS,
    Div,
    NumericInput,
    RadioButtonGroup,
    Row,
    Toggle,
)

from twinmatch.comparing import TrustLevel
from twinmatch.showing.page import panels
from twinmatch.showing.page.charts import (
    ChartFeed,
    TimeCharts,
    bands,
    draw_in_view,
    seconds_ahead,
)
from twinmatch.showing.page.health import PlayerState
from twinmatch.showing.page.heatmaps import GapMatrix, ThermalImage
from twinmatch.showing.page.state import DashboardState
from twinmatch.showing.page.style import BUTTONS, FONT, THEME, panel
from twinmatch.showing.style import LEVELS, TEXT

if TYPE_CHECKING:
    from twinmatch.showing.page.requests import Requests


SPANS = (("5 min", 300.0), ("20 min", 1200.0), ("1 h", 3600.0), ("all", 0.0))
"""Labels and seconds; 0: everything that is kept."""
DEFAULT_SPAN = 1
"""Place of the span that is shown first."""
RATES = (1.0, 10.0, 50.0, 200.0, 0.0)
"""Speeds that the page offers, recorded seconds per second; 0: as fast as possible."""


_FORM_STYLES = {"align-items": "flex-end", "flex-wrap": "wrap"}


def _button(label: str, width: int, kind: str, on_click: Callable[[], None]) -> Button:
    button = Button(label=label, width=width, button_type=kind, stylesheets=[BUTTONS])
    button.on_click(on_click)
    return button


def _number_field(title: str, width: int, **limits: float) -> NumericInput:
    return NumericInput(
        title=title, mode="float", width=width, stylesheets=[BUTTONS], **limits
    )


class PlayerButtons:
    """Pause and speed of a session being played; hidden when there is none."""

    def __init__(self, requests: Requests) -> None:
        """Pass clicks on to `requests`."""
        self._requests = requests
        self._player: PlayerState | None = None
        self._pause = _button("Pause", 100, "primary", self._on_pause)
        names = ["max" if rate == 0 else f"{rate:g} ×" for rate in RATES]
        self._rate = RadioButtonGroup(labels=names, active=None, stylesheets=[BUTTONS])
        self._rate.on_change("active", self._on_rate)
        styles = {"flex-wrap": "wrap"}
        self.root = Row(
            self._pause,
            self._rate,
            name="player",
            spacing=8,
            visible=False,
            styles=styles,
        )

    def update(self, player: PlayerState | None) -> None:
        """Show the state that the player reports."""
        if player == self._player and self.root.visible == (player is not None):
            return
        self._player = player
        self.root.visible = player is not None
        if player is not None:
            self._pause.label = "Continue" if player.paused else "Pause"
            self._rate.active = (
                RATES.index(player.rate) if player.rate in RATES else None
            )

    def _on_pause(self) -> None:
        if self._player is not None:
            self._requests.pause(not self._player.paused)

    def _on_rate(self, _name: str, _old: Any, new: int | None) -> None:
        if (
            self._player is not None
            and new is not None
            and RATES[new] != self._player.rate
        ):
            self._requests.rate(RATES[new])


def question_form(requests: Requests, label: str) -> Row:
    """The what-if question: a forecast for another set-point, named by `label`. Nothing is moved."""
    level = _number_field(label, 110)
    hold = _number_field("for / s (empty: it stays)", 150, low=0.001)

    def ask() -> None:
        if level.value is not None:
            requests.what_if(
                float(level.value), None if hold.value is None else float(hold.value)
            )

    return Row(
        level,
        hold,
        _button("Ask", 70, "primary", ask),
        name="question",
        spacing=8,
        styles=_FORM_STYLES,
    )


def rig_form(requests: Requests, label: str) -> Row:
    """The controls of a page that may command: set-point, experiments, law, clearing a fault, stop.

    `label` names the set-point; it is empty if there are several, which cannot be set here.
    """
    level = _number_field(label, 110)

    def ask() -> None:
        if level.value is not None:
            requests.set_point(float(level.value))

    buttons = (
        _button("Set", 70, "primary", ask),
        _button(
            "What next?", 110, "default", lambda: requests.next_experiment(run=False)
        ),
        _button(
            "Run what is next",
            140,
            "warning",
            lambda: requests.next_experiment(run=True),
        ),
        _button("Stop it", 80, "default", lambda: requests.next_experiment(stop=True)),
        _button("Profile on", 110, "default", requests.continue_profile),
        _button("Law before", 110, "default", requests.law_back),
        _button("Clear fault", 110, "warning", requests.clear_fault),
        _button("Output off", 110, "danger", requests.stop),
    )
    shown = (level, *buttons) if label else buttons[1:]
    return Row(*shown, name="rig", spacing=8, styles=_FORM_STYLES)


REFRESH = 350
"""Milliseconds between two updates of a tab."""
IMAGE_EVERY = 1.0
"""Least seconds between two thermal images of a tab; a camera sends nine a second."""
_RELOAD_WHEN_BACK = """
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
        self,
        state: DashboardState,
        requests: Requests,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Show a state; `clock` is the one that its times are taken from."""
        self._state = state
        self._clock = clock
        with state.lock:  # tables and description of the same plant
            self._plant = ChartFeed(state.plant)
            self._twin = ChartFeed(state.twin, bands)
            self._described = described = state.described
        self._charts = TimeCharts(self._plant.source, self._twin.source, described)
        self._matrix = GapMatrix()
        self._thermal = ThermalImage()
        names = (
            "status",
            "alarm",
            "first",
            "reasons",
            "tiles",
            "family",
            "events",
            "nodes",
            "matrix_note",
            "chart_note",
            "answer",
        )
        self._texts: dict[str, Div] = {name: panel(name) for name in names}
        self._all_orders = Toggle(label="all orders", name="every", width=110)
        spans: Any = {"labels": [label for label, _ in SPANS], "active": DEFAULT_SPAN}
        self._span = RadioButtonGroup(name="span", stylesheets=[BUTTONS], **spans)
        self._player = PlayerButtons(requests)
        has_one_loop = described.loops[1:] == ()
        label = described.reference.label if has_one_loop else ""
        self._forms = [question_form(requests, label)] if has_one_loop else []
        self._control = requests.control
        if self._control:
            self._forms.append(rig_form(requests, label))
            self._texts["notice"] = panel("notice")
        self._seen: dict[str, object] = {}
        self._image_drawn_at = -math.inf  # by the clock, s
        self._reloads_asked = 0

    def build(self, document: Document) -> None:
        """Make the document, and keep it up to date for as long as its tab is open."""
        roots = [
            *self._charts.figures,
            self._matrix.figure,
            self._thermal.root,
            *self._texts.values(),
        ]
        roots += [self._all_orders, self._span, self._player.root, *self._forms]
        with document.models.freeze():
            # otherwise every root scans the whole document again
            for root in roots:
                document.add_root(root)
        title = self._described.title
        document.title = f"twinmatch: {title}" if title else "twinmatch"
        self._texts["status"].js_on_change("tags", CustomJS(code="location.reload()"))
        document.theme = THEME
        document.template = _TEMPLATE.read_text(encoding="utf-8")
        colours = {
            "ink": TEXT,
            "good": LEVELS[TrustLevel.TRUSTED],
            "fault": LEVELS[TrustLevel.FAULT],
        }
        shown = {
            "control": self._control,
            "plant_title": title,
            "font": FONT,
            **colours,
        }
        shown |= {"charts": self._charts.rows, "asks": len(self._charts.rows[0]) == 1}
        document.template_variables.update(shown)
        # a restarted server does not know the old session
        document.config.reconnect_session = False
        document.js_on_event("document_ready", self._charts.fit_to_narrow)
        unseen = [*self._charts.outside_time, self._matrix.figure, self._thermal.figure]
        document.js_on_event("document_ready", draw_in_view(unseen))
        document.js_on_event("connection_lost", CustomJS(code=_RELOAD_WHEN_BACK))
        self.update()
        document.add_periodic_callback(self.update, REFRESH)

    def update(self) -> None:
        """Update whatever has changed."""
        state = self._state
        now = self._clock()
        with state.lock:
            state.nodes.expire(now)
            span = self._samples_shown()
            self._plant.update(state.period, span)
            self._twin.update(state.period, span)
            self._draw_forecast(span * state.period)
            self._update_texts(now)
            self._update_happened()
            self._update_family()
            self._draw_image(now)
            self._player.update(state.nodes.player)
            if state.described != self._described:
                self._ask_to_reload(state.described.plant)

    def _ask_to_reload(self, plant: str) -> None:
        """Have the browser reload the page, which then has this plant's charts.

        It is asked at every update until it has: to one that takes the document only now, what was said before is
        how the document is, and no change.
        """
        self._reloads_asked += 1
        self._texts["status"].tags = [plant, self._reloads_asked]

    def _samples_shown(self) -> int:
        """How many of the newest samples the charts show."""
        state = self._state
        _, seconds = SPANS[
            DEFAULT_SPAN if self._span.active is None else self._span.active
        ]
        if not seconds:
            return state.plant.capacity
        return min(state.plant.capacity, max(1, round(seconds / state.period)))

    def _update_happened(self) -> None:
        """Show the events, as marks and in a table."""
        state = self._state
        has_begun = state.sample is not None
        if not self._changed(
            "happened", (state.verdicts, state.event_count, state.period, has_begun)
        ):
            return
        of_session = [
            event for event in reversed(state.events) if event.session == state.session
        ]
        self._charts.draw_events(state.tally.stretches, of_session, state.period)
        self._show(
            "events",
            panels.events_table(reversed(state.events), state.session, state.period),
        )

    def _update_family(self) -> None:
        """Show the ν-gaps and the table of the candidates."""
        verdict = self._state.verdict
        all_orders = self._all_orders.active
        if not self._changed("family", (self._state.verdicts, all_orders)):
            return
        self._matrix.update(verdict)
        has_candidates = verdict is not None and bool(verdict.candidates)
        self._matrix.figure.visible = has_candidates
        self._show("matrix_note", "" if has_candidates else panels.NO_CANDIDATE)
        self._show("family", panels.family_table(verdict, all_orders=bool(all_orders)))

    def _draw_forecast(self, span: float) -> None:
        """Show the newest `span` seconds, and the forecast after them."""
        state = self._state
        forecast = self._state.current_forecast
        if self._changed(
            "forecast", (span, state.forecast_changes, state.period, forecast is None)
        ):
            most = seconds_ahead(span)
            what_if = None if state.what_if is None else state.what_if.forecast
            self._charts.draw_forecasts(forecast, what_if, state.period, most)
            self._charts.span(span if forecast is None else span + most)
            self._show("answer", panels.goal(state) + panels.what_if(state.what_if))

    def _draw_image(self, now: float) -> None:
        """Show the newest thermal image, unless the one before has only just been drawn."""
        image = self._state.image
        if image is None or now < self._image_drawn_at + IMAGE_EVERY:
            return
        if self._changed("image", self._state.images):
            self._thermal.update(image)
            self._image_drawn_at = now

    def _update_texts(self, now: float) -> None:
        state = self._state
        self._show("status", panels.status(state, now))
        self._show("alarm", panels.alarm(state))
        self._show("first", panels.first_screen(state))
        self._show(
            "reasons", panels.reasons(state.verdict, state.period, state.sentence)
        )
        self._show("tiles", panels.tiles(state))
        self._show("nodes", panels.nodes(state.nodes, now))
        self._charts.show(measured=state.plant.count > 0, mirrored=state.twin.count > 0)
        self._show("chart_note", "" if state.plant.count else panels.NO_SAMPLE)
        if self._control:
            self._show("notice", panels.notice(state))

    def _show(self, name: str, html: str) -> None:
        """Put a text in its place, which is hidden while empty; one that has not changed is not sent
        again."""
        place = self._texts[name]
        if place.text != html:
            place.text = html
        if place.visible != bool(html):
            place.visible = bool(html)

    def _changed(self, name: str, value: object) -> bool:
        """Whether a value differs from that of the last call with this name."""
        if self._seen.get(name) == value:
            return False
        self._seen[name] = value
        return True
