"""The controls: time span, player of a session, what-if question, and with `--control` the rig."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bokeh.models import Button, NumericInput, RadioButtonGroup, Row

from twinmatch.showing.page.health import PlayerState
from twinmatch.showing.page.style import BUTTONS

if TYPE_CHECKING:
    from twinmatch.showing.page.requests import Requests

SPANS = (("5 min", 300.0), ("20 min", 1200.0), ("1 h", 3600.0), ("all", 0.0))
"""Labels and seconds; 0: everything that is kept."""
DEFAULT_SPAN = 1
RATES = (1.0, 10.0, 50.0, 200.0, 0.0)
"""Speeds on the page, recorded seconds per second; 0: as fast as possible."""


_AT_END = {"align-items": "flex-end", "flex-wrap": "wrap"}


class SpanButtons:
    """Selects how much time the charts show."""

    def __init__(self) -> None:
        """Start with twenty minutes."""
        names = [name for name, _ in SPANS]
        self.root = RadioButtonGroup(name="span", labels=names, active=DEFAULT_SPAN, stylesheets=[BUTTONS])

    def samples(self, period: float, most: int) -> int:
        """The selected span as a number of samples; at most `most`."""
        seconds = SPANS[self.root.active if self.root.active is not None else DEFAULT_SPAN][1]
        return min(most, max(1, round(seconds / period))) if seconds else most


class PlayerButtons:
    """Pause and speed of a session being played; hidden when there is none."""

    def __init__(self, requests: Requests) -> None:
        """Pass clicks on to `requests`."""
        self._requests = requests
        self._player: PlayerState | None = None
        self._pause = Button(label="Pause", width=100, button_type="primary", stylesheets=[BUTTONS])
        self._pause.on_click(self._on_pause)
        names = ["max" if rate == 0 else f"{rate:g} ×" for rate in RATES]
        self._rate = RadioButtonGroup(labels=names, active=None, stylesheets=[BUTTONS])
        self._rate.on_change("active", self._on_rate)
        styles = {"flex-wrap": "wrap"}
        self.root = Row(self._pause, self._rate, name="player", spacing=8, visible=False, styles=styles)

    def update(self, player: PlayerState | None) -> None:
        """Show the state that the player reports."""
        if player == self._player and self.root.visible == (player is not None):
            return
        self._player = player
        self.root.visible = player is not None
        if player is not None:
            self._pause.label = "Continue" if player.paused else "Pause"
            self._rate.active = RATES.index(player.rate) if player.rate in RATES else None

    def _on_pause(self) -> None:
        if self._player is not None:
            self._requests.pause(not self._player.paused)

    def _on_rate(self, _name: str, _old: Any, new: int | None) -> None:
        if self._player is not None and new is not None and RATES[new] != self._player.rate:
            self._requests.rate(RATES[new])


class QuestionForm:
    """The what-if question: a forecast for another set-point. Asking does not move the plant."""

    def __init__(self, requests: Requests, label: str) -> None:
        """Pass questions on to `requests`; `label` names the set-point."""
        self._requests = requests
        self._level = NumericInput(title=label, mode="float", width=110, stylesheets=[BUTTONS])
        self._hold = NumericInput(
            title="for / s (empty: it stays)", mode="float", low=0.001, width=150, stylesheets=[BUTTONS]
        )
        ask = Button(label="Ask", width=70, button_type="primary", stylesheets=[BUTTONS])
        ask.on_click(self._on_ask)
        self.root = Row(self._level, self._hold, ask, name="question", spacing=8, styles=_AT_END)

    def _on_ask(self) -> None:
        if self._level.value is not None:
            hold = None if self._hold.value is None else float(self._hold.value)
            self._requests.what_if(float(self._level.value), hold)


class RigButtons:
    """Set-point, clearing a fault and stop, for a page that may control."""

    def __init__(self, requests: Requests, label: str) -> None:
        """Pass clicks on to `requests`; `label` names the set-point."""
        self._requests = requests
        self._input = NumericInput(title=label, mode="float", width=110, stylesheets=[BUTTONS])
        ask = Button(label="Set", width=70, button_type="primary", stylesheets=[BUTTONS])
        ask.on_click(self._on_ask)
        clear = Button(label="Clear fault", width=110, button_type="warning", stylesheets=[BUTTONS])
        clear.on_click(requests.clear_fault)
        stop = Button(label="Output off", width=110, button_type="danger", stylesheets=[BUTTONS])
        stop.on_click(requests.stop)
        self.root = Row(self._input, ask, clear, stop, name="rig", spacing=8, styles=_AT_END)

    def _on_ask(self) -> None:
        if self._input.value is not None:
            self._requests.set_point(float(self._input.value))
