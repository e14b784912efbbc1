"""The page's texts and tables: status, verdict in detail, current values, family, events, nodes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.showing import COLUMNS, row
from twinmatch.showing.criteria import computed, criterion_rows
from twinmatch.showing.page.events import Event
from twinmatch.showing.page.look import MARK_INKS, MARK_SIGNS, SIGNS, text
from twinmatch.showing.page.roster import Roster
from twinmatch.showing.page.state import Answered, DashboardState
from twinmatch.showing.quantities import number, quantity
from twinmatch.showing.style import LEVELS
from twinmatch.showing.words import with_unit

__all__ = [
    "NO_CANDIDATE",
    "NO_SAMPLE",
    "alarm",
    "answer",
    "events_table",
    "family_table",
    "nodes",
    "notice",
    "reasons",
    "status",
    "tiles",
]

RECENT = 80
"""Events in the table."""
SILENCE = 5.0
"""Periods, but at least seconds, without a sample after which the page reports it."""
IN_WORDS = ("level", "leader", "nominal", "why")
"""Columns of the terminal's table that the page shows elsewhere."""
CALLED = {"t / s": "judged at / s", "gain": "gain / characters"}
"""Names of columns that differ from those in the terminal."""
DASH = "–"
NO_CANDIDATE = '<p class="quiet">There is no candidate yet: no match has been admitted.</p>'
NO_SAMPLE = '<p class="quiet">No sample yet.</p>'
NODE_LEVELS = (TrustLevel.TRUSTED, TrustLevel.DOUBTFUL, TrustLevel.FAULT, TrustLevel.UNKNOWN)
"""Colours of the levels of REP 107."""
NODE_WORDS = ("OK", "warning", "error", "silent")
AT_REST = "has ended with the replay"


def reasons(verdict: Verdict | None, period: float, sentence: str = "") -> str:
    """The newest verdict in figures and text, and the session in a sentence."""
    if verdict is None:
        return '<p class="quiet">no verdict yet</p>'
    cells = dict(zip(COLUMNS, row(verdict, period), strict=True))
    more = f"<p><b>{text(sentence)}</b></p>" if sentence else ""
    more += "".join(f"<p>{text(words)}</p>" for words in _more(verdict))
    figures = _tiles([(CALLED.get(n, n), cell) for n, cell in cells.items() if n not in IN_WORDS])
    why = f'<p><span class="label">newest verdict:</span> {text(verdict.reason)}</p>'
    return f'<div class="why">{figures}{why}{more}</div>'


def tiles(state: DashboardState) -> str:
    """Current values of plant and twins."""
    now, described = state.plant.newest() or {}, state.described
    twin, y, u = state.twin.newest() or {}, described.output.decimals, described.input.decimals
    entries = [
        (described.reference.label, number(now.get("reference"), y)),
        (with_unit("plant", described.output.unit), number(now.get("output"), y)),
        (with_unit("closed-loop twin", described.output.unit), number(twin.get("closed_output"), y)),
        (with_unit("driven twin", described.output.unit), number(twin.get("driven_output"), y)),
        (f"plant's {described.input.label}", number(now.get("input"), u)),
        (f"twin's {described.input.label}", number(twin.get("closed_input"), u)),
    ]
    if state.drive is not None:
        entries.append((with_unit("applied", described.input.unit), number(state.drive.input, u)))
        if not math.isnan(state.drive.current):
            entries.append(("current / A", number(state.drive.current, 2)))
    return _tiles(entries, "tiles now")


def status(state: DashboardState, now: float) -> str:
    """One line: newest sample, state of a player, state of the nodes."""
    pills = [_sample_pill(state, now)]
    player, ended = state.roster.player, state.roster.ended
    if ended is not None:
        pills.append(_pill(None, f"the replay has ended: {ended.position}"))
    elif player is not None:
        rate = "as fast as possible" if player.rate == 0 else f"{player.rate:g} × recorded speed"
        pills.append(_pill(None, f"{'paused' if player.paused else 'playing'}: {player.position}, {rate}"))
    standing = state.roster.standing
    worst = [n for n, s in standing.items() if not state.roster.at_rest(n) and state.roster.level(n, now)]
    if worst:
        pills.append(_pill(TrustLevel.DOUBTFUL, f"{len(worst)} of {len(standing)} nodes need attention"))
    elif standing and ended is None:
        fine = "1 node is OK" if len(standing) == 1 else f"{len(standing)} nodes are OK"
        pills.append(_pill(TrustLevel.TRUSTED, fine))
    return f'<div class="status">{"".join(pills)}</div>'


def _sample_pill(state: DashboardState, now: float) -> str:
    if state.received_at is None:
        return _pill(TrustLevel.UNKNOWN, "waiting for the first sample")
    quiet, patience = now - state.received_at, SILENCE * max(1.0, state.period)
    if quiet > patience and state.roster.ended is None:
        return _pill(TrustLevel.DOUBTFUL, f"no sample for {quiet:.0f} s")
    at = (state.sample or 0) * state.period
    return _pill(TrustLevel.TRUSTED, f"sample {state.sample}, {number(at, _digits(state.period))} s")


def alarm(state: DashboardState) -> str:
    """The fault that holds the output at zero; empty without one."""
    if not state.fault:
        return ""
    kind, _, why = state.fault.partition(": ")
    return (
        f'<div class="alarm" role="alert"><b>{SIGNS[TrustLevel.FAULT]} Output held at zero: '
        f"{text(kind.replace('_', ' '))}</b><br>{text(why)}</div>"
    )


def family_table(verdict: Verdict | None, *, every: bool) -> str:
    """The candidates with their criteria for both outputs together: `every` order, or the chosen one."""
    if verdict is None or not verdict.candidates:
        return NO_CANDIDATE
    criteria = computed(verdict.candidates)
    head = [("candidate", ""), ("order", ""), *((c.name, c.unit) for c in criteria)]
    head += [("Σ ν-gap", ""), ("90 % of Σ", ""), ("P(nominal)", ""), ("ν-gap now", ""), ("margin", "b(P, C)")]
    of = verdict.candidates[0].parameters.model
    matched = [quantity(of.plant, name) for name in of.structure.free]
    head += [(q.symbol, q.unit) for q in matched]
    lines = []
    for candidate in verdict.candidates:
        nominal = candidate.name == verdict.nominal
        tag = '<span class="tag">nominal</span>' if nominal else ""
        rest = [
            number(candidate.nu_gap_sum, 3),
            _span(candidate.nu_gap_sum_low, candidate.nu_gap_sum_high),
            number(candidate.nominal_probability, 2),
            number(candidate.nu_gap_to_plant, 3),
            number(candidate.margin, 3),
            *(q.text(candidate.parameters.get(q.name, math.nan)) for q in matched),
        ]
        for line in criterion_rows(candidate, criteria):
            if line.output != "total" or not (every or line.chosen):
                continue
            cells = [f"<td>{text(candidate.name)}{tag}</td>" if line.chosen else "<td></td>"]
            cells.append(f'<td class="left">{text(line.order)}{" ✓" if line.chosen else ""}</td>')
            cells += [
                f'<td class="best">{c.text}</td>' if c.best else f"<td>{c.text}</td>" for c in line.cells
            ]
            cells += [f"<td>{text(value)}</td>" for value in (rest if line.chosen else [""] * len(rest))]
            kind = "nominal-row" if nominal and line.chosen else "" if line.chosen else "faded"
            lines.append(f'<tr class="{kind}">{"".join(cells)}</tr>')
    return _table(head, lines)


def events_table(events: Sequence[Event], session: int, period: float) -> str:
    """The newest events, newest first."""
    if not events:
        return '<p class="quiet">Nothing has happened yet.</p>'
    lines = []
    for event in events[:RECENT]:
        at = DASH if event.sample is None else f"{event.sample * period:.0f}"
        if event.session != session:
            at = f"session {event.session}: {at}"
        lines.append(
            f'<tr><td class="number">{text(at)}</td><td class="wide">'
            f'<span class="mark" style="color:{MARK_INKS[event.mark]}">{MARK_SIGNS[event.mark]}</span>'
            f"<b>{text(event.title)}</b>"
            f'<div class="quiet">{text(event.text)}</div></td></tr>'
        )
    return _table([("t", "s"), ("what and why", "")], lines, "events")


def nodes(roster: Roster, now: float) -> str:
    """Every reporting node with its report."""
    shown = []
    for name in sorted(roster.standing):
        rest = roster.at_rest(name)
        level = roster.level(name, now)
        colour = LEVELS[TrustLevel.UNKNOWN if rest else NODE_LEVELS[level]]
        shown.append(
            f'<div><span class="dot" style="background:{colour}"></span><b>'
            f"{text(name.removesuffix(': health'))}</b> {AT_REST if rest else NODE_WORDS[level]}"
            f'<div class="quiet">{text(roster.message(name))}</div></div>'
        )
    if not shown:
        return '<p class="quiet">No node has reported yet.</p>'
    return f'<div class="roster">{"".join(shown)}</div>'


def answer(answered: Answered | None) -> str:
    """The newest what-if question and its answer."""
    if answered is None:
        return ""
    lines = "".join(f"<p>{text(line)}</p>" for line in answered.lines)
    return f'<div class="answered"><b>{text(answered.question)}</b>{lines}</div>'


def notice(state: DashboardState) -> str:
    """The result of the last request."""
    if state.notice is None:
        return ""
    kind = "good" if state.notice.done else "bad"
    return f'<p class="{kind}">{text(state.notice.text)}</p>'


def _more(verdict: Verdict) -> list[str]:
    """Further statements of a verdict: fault, certainty, structure."""
    lines = []
    if verdict.fault:
        since = "" if verdict.fault_since is None else f" since sample {verdict.fault_since}"
        lines.append(f"the plant shows {verdict.fault}{since}")
    if verdict.certainty:
        lines.append(verdict.certainty)
    if verdict.structure:
        lines.append(f"structure that the samples justify: {verdict.structure}")
    return lines


def _span(low: float, high: float) -> str:
    return DASH if math.isnan(low) or math.isnan(high) else f"{number(low, 2)} to {number(high, 2)}"


def _tiles(entries: Sequence[tuple[str, str]], kind: str = "tiles") -> str:
    """Names with their units, each above its value."""
    shown = [
        f'<div><div class="label">{text(name)}</div><div class="value">{text(value)}</div></div>'
        for name, value in entries
    ]
    return f'<div class="{kind}">{"".join(shown)}</div>'


def _pill(level: TrustLevel | None, words: str) -> str:
    dot = "" if level is None else f'<span class="dot" style="background:{LEVELS[level]}"></span>'
    return f'<span class="pill">{dot}{text(words)}</span>'


def _digits(period: float) -> int:
    return 0 if period >= 1 else 1


def _table(head: Sequence[tuple[str, str]], lines: Sequence[str], kind: str = "") -> str:
    names = "".join(
        f"<th{' class=left' if k == 1 else ''}>{text(name)}<small>{text(unit)}</small></th>"
        for k, (name, unit) in enumerate(head)
    )
    body = "".join(lines)
    return (
        f'<div class="scroll" tabindex="0"><table class="{kind}"><thead><tr>{names}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )
