"""The top of the page: trust level, leader, forecast, plant health, and what to do."""

from __future__ import annotations

import math

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.description import Quantity
from twinmatch.showing import TrustRange
from twinmatch.showing.page.look import DARK, SIGNS, text
from twinmatch.showing.page.state import DashboardState
from twinmatch.showing.quantities import number
from twinmatch.showing.style import LEVEL_WORDS, LEVELS

__all__ = ["first_screen", "what_to_do"]

_LOOK = ": look at "
"""In a reason of the health monitor: what precedes the place to look at."""


def first_screen(state: DashboardState) -> str:
    """Five answers side by side, each below its question."""
    level = TrustLevel.UNKNOWN if state.verdict is None else state.verdict.level
    dark = " dark" if level in DARK else ""
    badge = (
        f'<div class="level{dark}" style="background:{LEVELS[level]}"><div class="sign">{SIGNS[level]}</div>'
        f'<div><div class="word">{text(level.value)}</div>'
        f'<div class="meaning">{text(LEVEL_WORDS[level])}</div></div></div>'
    )
    shown = [_leader(state), _ahead(state), _health(state)]
    to_do = (
        f'<div class="answer to-do"><div class="label">what to do</div><p>{text(what_to_do(state))}</p></div>'
    )
    return f'<div class="hero">{badge}{"".join(shown)}{to_do}</div>'


def what_to_do(state: DashboardState) -> str:
    """The next thing for the operator to do."""
    said = state.described
    if state.fault:
        return "The output is held at zero. Find the cause and fix it, then clear the fault."
    if state.roster.ended is not None:
        return "Nothing: the replay has ended, and this page shows its final state."
    if state.received_at is None:
        return "Start the plant's nodes, or play a recorded session: its samples appear here automatically."
    if state.verdict is None or state.verdict.level is TrustLevel.UNKNOWN:
        return (
            f"Step the {said.reference.name} and hold it for some minutes (in open loop the "
            f"{said.input.name}): a twin is matched to the plant's response."
        )
    return _advice(state.verdict, said.output)


def _advice(verdict: Verdict, output: Quantity) -> str:
    """What to do after a verdict."""
    if verdict.level is TrustLevel.FAULT:
        _, found, where = verdict.reason.partition(_LOOK)
        first = f"Look at {where}" if found else "Look at drive, sensor and cables"
        return f"{first}. Do not rely on forecasts until the fault is fixed."
    if verdict.level is TrustLevel.DOUBTFUL:
        return (
            "Do not rely on forecasts. If the plant was changed, let it step and settle, so that a twin is "
            "matched again; if not, look at drive and sensor."
        )
    return f"Nothing. Ask the leader what comes next{_proven_range(verdict, output)}."


def _proven_range(verdict: Verdict, output: Quantity) -> str:
    if math.isnan(verdict.held_low):
        return ""
    places = max(0, output.decimals - 2)
    held = TrustRange(verdict.held_low, verdict.held_high, output.unit, places)
    return f"; its forecasts have come true between {held}"


def _answer(question: str, answer: str, more: str) -> str:
    return (
        f'<div class="answer"><div class="label">{text(question)}</div>'
        f'<div class="name">{text(answer)}</div><div class="label">{more}</div></div>'
    )


def _leader(state: DashboardState) -> str:
    verdict = state.verdict
    nominal = "none yet" if verdict is None or not verdict.nominal else verdict.nominal
    name = state.leader or ("" if verdict is None else verdict.nominal or "")
    more = f"nominal, the centre of the family: <b>{text(nominal)}</b>"
    return _answer("leader, the twin to ask what comes next", name or "none yet", more)


def _ahead(state: DashboardState) -> str:
    """The output at the end of the leader's forecast."""
    forecast, output = state.ahead, state.described.output
    if forecast is None or not forecast.time.size:
        return _answer("forecast", "not known yet", "available once there is a leader")
    band = forecast.output
    mean, low, high = (_value(float(v[-1]), output) for v in (band.mean, band.low, band.high))
    share = f"{100 * forecast.confidence:.0f} %"
    return _answer(
        f"{output.name.replace('_', ' ')} in {forecast.time[-1]:g} s",
        f"{mean} {output.unit}".rstrip(),
        text(f"{low} to {high} {output.unit}".rstrip() + f" in {share} of such cases"),
    )


def _health(state: DashboardState) -> str:
    verdict = state.verdict
    if verdict is None:
        return _answer("plant health", "not known yet", "no verdict yet")
    if not verdict.fault:
        return _answer("plant health", "✓ no fault found", "drive and sensor behave as expected")
    name = f"{SIGNS[TrustLevel.FAULT]} {verdict.fault.replace('-', ' ')}"
    since = verdict.fault_since
    at = "" if since is None else f"since {number(since * state.period, 0)} s: "
    return _answer("plant health", name, text(f"{at}{verdict.reason}"))


def _value(value: float, quantity: Quantity) -> str:
    return number(value, max(0, quantity.decimals - 1))
