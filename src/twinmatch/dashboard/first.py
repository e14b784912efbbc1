"""What stands first on the page: how far to trust, whom to ask, what comes next, health, and what to do."""

from __future__ import annotations

import math

from twinmatch.dashboard.look import DARK, SIGNS, text
from twinmatch.dashboard.state import DashboardState
from twinmatch.description import Quantity
from twinmatch.discrimination import TrustLevel, Verdict
from twinmatch.views import TrustRange
from twinmatch.views.quantities import number
from twinmatch.views.style import LEVEL_WORDS, LEVELS

__all__ = ["first_screen", "what_to_do"]

_LOOK = ": look at "
"""What the monitor of the plant's health says before where to look."""


def first_screen(state: DashboardState) -> str:
    """Five answers side by side, each with the question above it."""
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
    """The next thing to do for whoever looks at the page."""
    said = state.described
    if state.fault:
        return "The output is held at zero. Find out why, mend it, then clear the fault."
    if state.roster.ended is not None:
        return "Nothing: the replay has ended, and this is how it stood at its end."
    if state.heard_at is None:
        return "Start the plant's nodes, or play a recorded session: its samples appear here by themselves."
    if state.verdict is None or state.verdict.level is TrustLevel.UNKNOWN:
        return (
            f"Let the {said.reference.name} step and stay for some minutes (in open loop the "
            f"{said.input.name}): a twin is matched to what the plant makes of it."
        )
    return _upon(state.verdict, said.output)


def _upon(verdict: Verdict, output: Quantity) -> str:
    """What a verdict asks for."""
    if verdict.level is TrustLevel.FAULT:
        _, found, where = verdict.reason.partition(_LOOK)
        first = f"Look at {where}" if found else "Look at drive, sensor and cables"
        return f"{first}. Do not rely on what is foretold until that is mended."
    if verdict.level is TrustLevel.DOUBTFUL:
        return (
            "Do not rely on what is foretold. If the plant was changed, let it step and settle, so that a "
            "twin is matched anew; if not, look at drive and sensor."
        )
    return f"Nothing needs doing. Ask the leader what comes next{_between(verdict, output)}."


def _between(verdict: Verdict, output: Quantity) -> str:
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
    """Where the output is foretold to be at the end of what the leader foretells."""
    forecast, output = state.ahead, state.described.output
    if forecast is None or not forecast.time.size:
        return _answer("what comes", "not known yet", "once there is a leader it foretells")
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
        return _answer("health of the plant", "not known yet", "no verdict has come yet")
    if not verdict.fault:
        return _answer("health of the plant", "✓ no fault seen", "drive and sensor do what they should")
    name = f"{SIGNS[TrustLevel.FAULT]} {verdict.fault.replace('-', ' ')}"
    since = verdict.fault_since
    at = "" if since is None else f"since {number(since * state.period, 0)} s: "
    return _answer("health of the plant", name, text(f"{at}{verdict.reason}"))


def _value(value: float, quantity: Quantity) -> str:
    return number(value, max(0, quantity.decimals - 1))
