"""The controls: time span, player of a session, what-if question, and with `--control` the rig."""

from __future__ import annotations

from collections.abc import Callable
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


def _button(label: str, width: int, kind: str, on_click: Callable[[], None]) -> Button:
    made = Button(label=label, width=width, button_type=kind, stylesheets=[BUTTONS])
    made.on_click(on_click)
    return made


def _entry(title: str, width: int, **limits: float) -> NumericInput:
    return NumericInput(title=title, mode="float", width=width, stylesheets=[BUTTONS], **limits)


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
        self._pause = _button("Pause", 100, "primary", self._on_pause)
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
        self._level = _entry(label, 110)
        self._hold = _entry("for / s (empty: it stays)", 150, low=0.001)
        ask = _button("Ask", 70, "primary", self._on_ask)
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
        self._input = _entry(label, 110)
        buttons = (
            _button("Set", 70, "primary", self._on_ask),
            _button("Clear fault", 110, "warning", requests.clear_fault),
            _button("Output off", 110, "danger", requests.stop),
        )
        self.root = Row(self._input, *buttons, name="rig", spacing=8, styles=_AT_END)

    def _on_ask(self) -> None:
        if self._input.value is not None:
            self._requests.set_point(float(self._input.value))
