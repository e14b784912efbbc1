"""The page's texts and tables, as HTML: first screen, verdict in detail, values, family, events, nodes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from itertools import islice

from twinmatch.comparing import (
    ANYWHERE,
    CandidateScore,
    Statements,
    TrustLevel,
    Verdict,
    plant_fault,
)
from twinmatch.description import Quantity, nth
from twinmatch.offline.summary import TrustRange, held_levels, shown_twin
from twinmatch.safety import is_limit
from twinmatch.showing.family import (
    CriterionRow,
    FamilyTable,
    criterion_rows,
    family_table_of,
    outputs_of,
)
from twinmatch.showing.page.health import NodeReports
from twinmatch.showing.page.state import DashboardState, WhatIfAnswer
from twinmatch.showing.page.style import DARK, MARK_INKS, MARK_SIGNS, SIGNS
from twinmatch.showing.quantities import number, with_unit
from twinmatch.showing.style import LEVELS
from twinmatch.showing.verdicts import (
    Event,
    estimate_words,
    row,
    trust_by_signal,
)
from twinmatch.signals import decimals_of_time, point_values

RECENT = 80
"""Events in the table."""
SILENCE = 5.0
"""Periods, but at least seconds, without a sample after which the page reports it."""
IN_WORDS = ("level", "decided", "leader", "nominal", "why")
"""Columns of the terminal's table that the page shows elsewhere."""
DASH = "–"
NO_CANDIDATE = (
    '<p class="quiet">There is no candidate yet: no match has been admitted.</p>'
)
NO_SAMPLE = '<p class="quiet">No sample yet.</p>'
NODE_LEVELS = (
    TrustLevel.TRUSTED,
    TrustLevel.DOUBTFUL,
    TrustLevel.FAULT,
    TrustLevel.UNKNOWN,
)
"""For each level of REP 107, the trust level whose colour it has."""
NODE_WORDS = ("OK", "warning", "error", "silent")
AT_REST = "has ended with the replay"


def first_screen(state: DashboardState) -> str:
    """Five answers side by side, each below its question."""
    trust = state.statements.trust
    level = trust.level
    dark = " dark" if level in DARK else ""
    badge = (
        f'<div class="level{dark}" style="background:{LEVELS[level]}"><div class="sign">{SIGNS[level]}</div>'
        f'<div><div class="word">{escape(level.value)}</div>'
        f'<div class="meaning">{escape(trust.reason)}</div></div></div>'
    )
    answers = f"{_leader(state)}{_forecast(state)}{_health(state)}"
    to_do = f'<div class="label">what to do</div><p>{escape(what_to_do(state))}</p>'
    return f'<div class="hero">{badge}{answers}<div class="answer to-do">{to_do}</div></div>'


def _any_of(quantities: Iterable[Quantity]) -> str:
    """The names of some quantities as alternatives, each once."""
    return " or the ".join(dict.fromkeys(quantity.name for quantity in quantities))


def what_to_do(state: DashboardState) -> str:
    """The next thing for the operator to do."""
    described = state.described
    references, _, inputs = map(_any_of, zip(*described.loops, strict=True))
    if state.fault:
        if is_limit(state.fault):
            return "The drive is limited. Measure what is heated; if the reading is right, clear the fault."
        return "The output is held at zero. Find the cause and fix it, then clear the fault."
    if state.nodes.ended is not None:
        return "Nothing: the replay has ended, and this page shows its final state."
    if state.received_at is None:
        return "Start the plant's nodes, or play a recorded session: its samples appear here automatically."
    statements = state.statements
    if statements.trust.level is TrustLevel.UNKNOWN:
        return (
            f"Step the {references} and hold it for some minutes (in open loop the {inputs}): a twin is "
            "matched to the plant's response."
        )
    twin = shown_twin(state.verdict)
    levels = (
        held_levels(twin.parameters.model.plant, state.tally.held) if twin else None
    )
    return _advice(statements, levels)


def _advice(statements: Statements, levels: TrustRange | None) -> str:
    """What to do after a verdict."""
    level = statements.trust.level
    if level is TrustLevel.FAULT:
        fault = statements.plant_fault
        place = ANYWHERE if fault is None else fault.place
        return f"Look at {place}. Do not rely on forecasts until the fault is fixed."
    if level is TrustLevel.DOUBTFUL:
        return (
            "Do not rely on forecasts. If the plant was changed, let it step and settle, so that a twin is "
            "matched again; if not, look at drive and sensor."
        )
    proven = f"; its forecasts have come true {levels}" if levels else ""
    return f"Nothing. Ask the leader what comes next{proven}."


def _answer(question: str, answer: str, remark: str) -> str:
    return (
        f'<div class="answer"><div class="label">{escape(question)}</div>'
        f'<div class="name">{escape(answer)}</div><div class="label">{remark}</div></div>'
    )


def _leader(state: DashboardState) -> str:
    nominal = (state.verdict and state.verdict.nominal) or "none yet"
    remark = f"nominal, the centre of the family: <b>{escape(nominal)}</b>"
    return _answer(
        "leader, the twin to ask what comes next", state.leader or nominal, remark
    )


def _forecast(state: DashboardState) -> str:
    """The outputs at the end of the leader's forecast."""
    forecast = state.current_forecast
    if forecast is None or not forecast.time.size:
        return _answer("forecast", "not known yet", "available once there is a leader")
    outputs = [output for _, output, _ in state.described.loops]
    means = []
    spans = []
    for output, band in zip(outputs, forecast.outputs, strict=False):
        places = max(0, output.decimals - 1)
        mean, low, high = (
            number(float(v[-1]), places) for v in (band.mean, band.low, band.high)
        )
        means.append(f"{mean} {output.unit}".rstrip())
        spans.append(f"{low} to {high} {output.unit}".rstrip())
    names = ", ".join(output.name.replace("_", " ") for output in outputs[: len(means)])
    share = f"{100 * forecast.confidence:.0f} %"
    return _answer(
        f"{names} in {forecast.time[-1]:g} s",
        "; ".join(means),
        escape(f"{'; '.join(spans)} in {share} of such cases"),
    )


def _health(state: DashboardState) -> str:
    verdict = state.verdict
    if verdict is None:
        return _answer("plant health", "not known yet", "no verdict yet")
    output_named = {output.name: output for output in state.described.outputs}
    estimates = (
        estimate_words(estimate, output_named[estimate.signal], state.period)
        for estimate in state.read_through
    )
    through = "".join(f"<br>{escape(words)}" for words in estimates)
    fault = state.statements.plant_fault
    if fault is None:
        return _answer(
            "plant health",
            "✓ no fault found",
            f"drive and sensor behave as expected{through}",
        )
    begin = fault.begin(state.period)
    evidence = f"{begin}: {fault.reason}" if begin else fault.reason
    name = f"{SIGNS[TrustLevel.FAULT]} {fault.called.replace('-', ' ')}"
    return _answer("plant health", name, escape(evidence) + through)


def reasons(verdict: Verdict | None, period: float, sentence: str = "") -> str:
    """The newest verdict in figures and text, and the session in a sentence."""
    if verdict is None:
        return '<p class="quiet">no verdict yet</p>'
    cells = row(verdict, period)
    further = f"<p><b>{escape(sentence)}</b></p>" if sentence else ""
    further += "".join(f"<p>{escape(words)}</p>" for words in _more(verdict, period))
    if trust_of_signals := trust_by_signal(verdict):
        lines = [
            "".join(f"<td>{escape(cell)}</td>" for cell in signal.values())
            for signal in trust_of_signals
        ]
        further += _table(
            [(head, "", "") for head in trust_of_signals[0]],
            [f"<tr>{line}</tr>" for line in lines],
        )
    figures = _tiles(
        [
            ("judged at / s" if n == "t / s" else n, cell)
            for n, cell in cells.items()
            if n not in IN_WORDS
        ]
    )
    why = f'<p><span class="label">newest verdict:</span> {escape(verdict.reason)}</p>'
    return f'<div class="why">{figures}{why}{further}</div>'


def tiles(state: DashboardState) -> str:
    """Current values of plant and twins."""
    values = (state.plant.newest() or {}) | (state.twin.newest() or {})
    loops = state.described.loops
    rows = []
    for k, (set_point, output, control) in enumerate(loops):
        source = output.name if loops[1:] else "plant"
        y = output.decimals
        u = control.decimals
        shown = (
            (set_point.label, "reference", y),
            (with_unit(source, output.unit), "output", y),
            (with_unit("closed-loop twin", output.unit), "closed_output", y),
            (with_unit("driven twin", output.unit), "driven_output", y),
            (f"plant's {control.label}", "input", u),
            (f"twin's {control.label}", "closed_input", u),
        )
        rows.append(
            [
                (label, number(values.get(nth(name, k)), places))
                for label, name, places in shown
            ]
        )
    if state.drive is not None:
        # The last report of a played session is later than its last sample: the drive has let go.
        applied_word = (
            "applied" if state.nodes.ended is None else "applied after the end"
        )
        for tiles_of_loop, (_, _, control), applied in zip(
            rows, loops, point_values(state.drive.input), strict=False
        ):
            tiles_of_loop.append(
                (
                    with_unit(applied_word, control.unit),
                    number(applied, control.decimals),
                )
            )
        if not math.isnan(state.drive.current):
            rows[0].append(("current / A", number(state.drive.current, 2)))
    return "".join(_tiles(tiles_of_loop, "tiles now") for tiles_of_loop in rows)


def status(state: DashboardState, now: float) -> str:
    """One line: newest sample, state of a player, state of the nodes."""
    pills = [_sample_pill(state, now)]
    player = state.nodes.player
    ended = state.nodes.ended
    if ended is not None:
        pills.append(_pill(None, f"the replay has ended: {ended.position}"))
    elif player is not None:
        rate = (
            "as fast as possible"
            if player.rate == 0
            else f"{player.rate:g} × recorded speed"
        )
        pills.append(
            _pill(
                None,
                f"{'paused' if player.paused else 'playing'}: {player.position}, {rate}",
            )
        )
    reports = state.nodes.reports
    to_attend = [
        name
        for name in reports
        if not state.nodes.at_rest(name) and state.nodes.level(name, now)
    ]
    if to_attend:
        pills.append(
            _pill(
                TrustLevel.DOUBTFUL,
                f"{len(to_attend)} of {len(reports)} nodes need attention",
            )
        )
    elif reports and ended is None:
        fine = "1 node is OK" if len(reports) == 1 else f"{len(reports)} nodes are OK"
        pills.append(_pill(TrustLevel.TRUSTED, fine))
    return f'<div class="status">{"".join(pills)}</div>'


def _sample_pill(state: DashboardState, now: float) -> str:
    if state.received_at is None:
        return _pill(TrustLevel.UNKNOWN, "waiting for the first sample")
    quiet = now - state.received_at
    sample_time = (state.sample or 0) * state.period
    newest = (
        f"sample {state.sample}, {number(sample_time, 0 if state.period >= 1 else 1)} s"
    )
    if quiet > SILENCE * max(1.0, state.period) and state.nodes.ended is None:
        return _pill(TrustLevel.DOUBTFUL, f"no sample for {quiet:.0f} s after {newest}")
    return _pill(TrustLevel.TRUSTED, newest)


def alarm(state: DashboardState) -> str:
    """The fault that limits the output or holds it at zero; empty without one."""
    fault = state.statements.drive_fault
    if fault is None:
        return ""
    title = escape(f"{fault.called[0].upper()}{fault.called[1:]}")
    why = escape(fault.reason)
    sign = SIGNS[TrustLevel.FAULT]
    return f'<div class="alarm" role="alert"><b>{sign} {title}</b><br>{why}</div>'


def family_table(verdict: Verdict | None, *, all_orders: bool) -> str:
    """The candidates with their criteria for both outputs together.

    A candidate has a row for each of its orders if `all_orders`, else one for the chosen order.
    """
    if verdict is None or not verdict.family:
        return NO_CANDIDATE
    table = family_table_of(verdict)
    orders = [("order", "", "")] if verdict.modelled else []
    columns = [*table.criteria, *table.figures]
    head = [
        ("candidate", "", ""),
        *orders,
        *((c.name, c.unit, c.meaning) for c in columns),
    ]
    head += [(q.symbol, q.unit, q.words) for q in table.parameters]
    lines: list[str] = []
    for candidate in table.candidates:
        is_nominal = candidate.name == verdict.nominal
        lines += _candidate_rows(
            candidate, table, is_nominal=is_nominal, all_orders=all_orders
        )
    return _table(head, lines)


def _candidate_rows(
    candidate: CandidateScore,
    table: FamilyTable,
    *,
    is_nominal: bool,
    all_orders: bool,
) -> Iterator[str]:
    """The rows of a candidate: one for each order, or only that of the chosen one; without models one row."""
    # both outputs together; in open loop the output alone
    both, _ = outputs_of(candidate.orders)[-1]
    every_row = criterion_rows(candidate, table.criteria)
    of_orders = [of_order for of_order in every_row if of_order.output == both]
    if not of_orders:
        yield _chosen_row(candidate, table, "", is_nominal=is_nominal)
    columns_of_figures = len(table.figures) + len(table.parameters)
    for of_order in of_orders:
        cells = _order_cells(of_order)
        if of_order.chosen:
            yield _chosen_row(candidate, table, cells, is_nominal=is_nominal)
        elif all_orders:
            empty = "<td></td>" * columns_of_figures
            yield f'<tr class="faded"><td></td>{cells}{empty}</tr>'


def _chosen_row(
    candidate: CandidateScore, table: FamilyTable, of_order: str, *, is_nominal: bool
) -> str:
    """A candidate's name, the cells of its chosen order, and its figures."""
    tag = '<span class="tag">nominal</span>' if is_nominal else ""
    figures = [column.text(candidate) for column in table.figures]
    figures += [table.parameter(candidate, q) for q in table.parameters]
    cells = "".join(f"<td>{escape(figure)}</td>" for figure in figures)
    kind = "nominal-row" if is_nominal else ""
    return f'<tr class="{kind}"><td>{escape(candidate.name)}{tag}</td>{of_order}{cells}</tr>'


def _order_cells(of_order: CriterionRow) -> str:
    """An order, marked if it is chosen, and its criteria, the best of each marked."""
    mark = " ✓" if of_order.chosen else ""
    cells = [f'<td class="left">{escape(of_order.order)}{mark}</td>']
    for cell in of_order.cells:
        kind = ' class="best"' if cell.best else ""
        cells.append(f"<td{kind}>{cell.text}</td>")
    return "".join(cells)


def events_table(events: Iterable[Event], session: int, period: float) -> str:
    """The newest events, newest first."""
    lines = []
    for event in islice(events, RECENT):
        when = event.time(period)
        begin = DASH if when is None else number(when, decimals_of_time(period))
        if event.session != session:
            begin = f"session {event.session}: {begin}"
        lines.append(
            f'<tr><td class="number">{escape(begin)}</td><td class="wide">'
            f'<span class="mark" style="color:{MARK_INKS[event.mark]}">{MARK_SIGNS[event.mark]}</span>'
            f"<b>{escape(event.title)}</b>"
            f'<div class="quiet">{escape(event.why)}</div></td></tr>'
        )
    if not lines:
        return '<p class="quiet">Nothing has happened yet.</p>'
    return _table([("t", "s", ""), ("what and why", "", "")], lines, "events")


def nodes(reports: NodeReports, now: float) -> str:
    """Every reporting node with its report."""
    shown = []
    for name in sorted(reports.reports):
        at_rest = reports.at_rest(name)
        level = reports.level(name, now)
        colour = LEVELS[TrustLevel.UNKNOWN if at_rest else NODE_LEVELS[level]]
        shown.append(
            f'<div><span class="dot" style="background:{colour}"></span><b>'
            f"{escape(name.removesuffix(': health'))}</b> {AT_REST if at_rest else NODE_WORDS[level]}"
            f'<div class="quiet">{escape(reports.message(name))}</div></div>'
        )
    if not shown:
        return '<p class="quiet">No node has reported yet.</p>'
    return f'<div class="roster">{"".join(shown)}</div>'


def what_if(answer: WhatIfAnswer | None) -> str:
    """The newest what-if question and its answer."""
    if answer is None:
        return ""
    lines = "".join(f"<p>{escape(line)}</p>" for line in answer.lines)
    return f'<div class="answered"><b>{escape(answer.question)}</b>{lines}</div>'


def goal(state: DashboardState) -> str:
    """When the level that is asked for is reached, and when to begin."""
    if state.goal is None:
        return ""
    words = state.goal.lines(state.described.output.unit, state.period)
    lines = "".join(f"<p>{escape(line)}</p>" for line in words)
    return f'<div class="answered"><b>When is it there?</b>{lines}</div>'


def notice(state: DashboardState) -> str:
    """The result of the last request."""
    newest = state.notice
    if newest is None:
        return ""
    return f'<p class="{"good" if newest.done else "bad"}">{escape(newest.text)}</p>'


def _more(verdict: Verdict, period: float) -> list[str]:
    """Further statements of a verdict: fault, certainty, structure."""
    fault = plant_fault(verdict)
    shows = f"the plant shows {fault.with_begin(period)}" if fault is not None else ""
    structure = (
        verdict.structure and f"structure that the samples justify: {verdict.structure}"
    )
    return [line for line in (shows, verdict.certainty, structure) if line]


def _tiles(entries: Sequence[tuple[str, str]], kind: str = "tiles") -> str:
    """Values, each below its name with the unit."""
    shown = [
        f'<div><div class="label">{escape(name)}</div><div class="value">{escape(value)}</div></div>'
        for name, value in entries
    ]
    return f'<div class="{kind}">{"".join(shown)}</div>'


def _pill(level: TrustLevel | None, words: str) -> str:
    dot = (
        ""
        if level is None
        else f'<span class="dot" style="background:{LEVELS[level]}"></span>'
    )
    return f'<span class="pill">{dot}{escape(words)}</span>'


def _table(
    head: Sequence[tuple[str, str, str]], lines: Sequence[str], kind: str = ""
) -> str:
    """A table: `head` has name, unit and meaning of each column, `lines` are its rows as HTML."""
    names = "".join(
        f'<th{" class=left" if k == 1 else ""} title="{escape(meaning)}">{escape(name)}'
        f"<small>{escape(unit)}</small></th>"
        for k, (name, unit, meaning) in enumerate(head)
    )
    return (
        f'<div class="scroll" tabindex="0"><table class="{kind}"><thead><tr>{names}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )
