"""The family: criteria, ν-gaps, parameters of every match, and responses of twins and models."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Plant, Response, channels
from twinmatch.dynamics.simulation import SKIPPED
from twinmatch.fitting import Match
from twinmatch.showing.family import Member, interval, value_of
from twinmatch.showing.figures.drawing import (
    align_labels,
    columns,
    draw_inputs,
    draw_outputs,
    empty,
    name_signals,
    new_figure,
    panel,
    stack,
    styled,
)
from twinmatch.showing.quantities import ParameterFormat, parameter_format, signal_names
from twinmatch.showing.style import (
    CLOSED,
    FAMILY_MAP,
    MATRIX_MAP,
    MODEL,
    ORDERS,
    PLANT,
    SET_POINT,
    SIDE_BY_SIDE,
    TEXT,
)
from twinmatch.signals import FloatArray, Window
from twinmatch.twin import MatchReport, response_on

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from twinmatch.showing.figures.elements.panel import Panel


_CROWDED = 6
"""With more candidates, the numbers in the cells are smaller."""

_PANELS = (
    ("gain", "information gain / characters", "larger is better"),
    ("naic", "nAIC above the best", "0 is best"),
    ("bic", "BIC above the best", "0 is best"),
    ("mdl", "MDL over the best − 1", "0 is best"),
)


@styled
def draw_criteria(verdict: Verdict) -> Figure:
    """The four criteria, both outputs together, for every candidate and order."""
    figure = new_figure(10, 4.8)
    grid = figure.add_gridspec(2, 2)
    for k, (attribute, name, hint) in enumerate(_PANELS):
        axes = panel(figure, grid[k // 2, k % 2])
        _draw_bars(axes, verdict, attribute)
        axes.set_title(f"{name} ({hint})")
        if k == 0:
            named = axes.get_legend_handles_labels()
            title = "order; a black frame marks the chosen one"
            figure.legend(
                *named,
                loc="outside upper right",
                ncols=len(ORDERS),
                title=title,
                title_fontsize=8,
            )
    return figure


def draw_gains(axes: Panel, verdict: Verdict) -> None:
    """Information gain of every candidate and order."""
    _draw_bars(axes, verdict, "gain")
    axes.set_ylabel("information gain / characters")
    axes.set_title("Family and orders (framed: chosen)")
    axes.legend(ncols=4, loc="upper left")
    axes.margins(y=0.2)


def _draw_bars(axes: Panel, verdict: Verdict, attribute: str) -> None:
    candidates = verdict.modelled
    orders = [o.order for o in candidates[0].orders]
    places = np.arange(len(candidates), dtype=np.float64)
    width = 0.8 / len(orders)
    rows = [
        [getattr(order.total, attribute) for order in candidate.orders]
        for candidate in candidates
    ]
    table = _above_best(np.array(rows, dtype=float), attribute)
    for k, order in enumerate(orders):
        begin = places + (k - len(orders) / 2) * width
        is_chosen = [candidate.chosen_order == order for candidate in candidates]
        colour = ORDERS[k % len(ORDERS)]
        _draw_row(axes, begin, width, table[:, k], is_chosen, color=colour, label=order)
    axes.autoscale_view()
    axes.below.name_ticks(places, [c.name for c in candidates])
    axes.grid(visible=False, axis="x")


def _draw_row(
    axes: Axes,
    begin: FloatArray,
    width: float,
    heights: FloatArray,
    is_framed: Sequence[bool],
    *,
    color: str,
    label: str,
) -> None:
    """Bars of these heights from 0 on, some with a black frame, as one artist."""
    from matplotlib.collections import PolyCollection  # noqa: PLC0415

    end = begin + width
    zero = np.zeros_like(heights)
    corners = [[begin, zero], [begin, heights], [end, heights], [end, zero]]
    bars = PolyCollection(
        list(np.array(corners).transpose(2, 0, 1)),
        facecolors=color,
        edgecolors=["black" if framed else "none" for framed in is_framed],
        linewidths=[1.6 if framed else 0.0 for framed in is_framed],
        joinstyle="miter",
        label=label,
    )
    # no margin below bars
    bars.sticky_edges.y.append(0.0)
    axes.add_collection(bars)


def _above_best(table: FloatArray, attribute: str) -> FloatArray:
    """Gains unchanged; other criteria, which are only comparable, relative to the candidate's best."""
    if attribute == "gain":
        return table
    best = np.min(table, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        above = table / best - 1 if attribute == "mdl" else table - best
    return np.asarray(np.nan_to_num(above, nan=0.0, posinf=0.0, neginf=0.0))


@styled
def draw_matrix(verdict: Verdict) -> Figure:
    """The ν-gaps between all candidates as a heat map, and their sums."""
    size = 1.2 + 0.55 * len(verdict.candidates)
    figure = new_figure(size + 2.6, size)
    fill_matrix(figure.add_subplot(), verdict)
    return figure


def fill_matrix(axes: Axes, verdict: Verdict) -> None:
    """The heat map itself."""
    matrix = np.array(verdict.nu_gap)
    top = max(float(matrix.max()), 1e-12)
    image: Any = axes.imshow(matrix, cmap=MATRIX_MAP, vmin=0, vmax=top)
    _write_values(axes, image, matrix)
    names = [c.name for c in verdict.candidates]
    rows = [f"{c.name}  Σ {c.nu_gap_sum:.2f}" for c in verdict.candidates]
    axes.set_xticks(range(len(names)), names, rotation=45 if len(names) > 4 else 0)
    axes.set_yticks(range(len(names)), rows)
    for label, name in zip(axes.get_yticklabels(), names, strict=True):
        label.set_fontweight("bold" if name == verdict.nominal else "normal")
    axes.set_title("ν-gap between the plants\n(smallest Σ: nominal, bold)")
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.figure.colorbar(
        image, ax=axes, shrink=0.8, label="ν-gap (0: the same, 1: entirely different)"
    )


def _write_values(axes: Axes, image: Any, matrix: FloatArray) -> None:
    """Write each value into its cell of the image."""
    size = 7 if len(matrix) > _CROWDED else 8
    for (row, column), value in np.ndenumerate(matrix):
        colour = "white" if _is_dark(image, float(value)) else TEXT
        text = axes.text(
            column,
            row,
            f"{value:.2f}",
            ha="center",
            va="center",
            fontsize=size,
            color=colour,
        )
        text.set_in_layout(False)  # it lies within its cell


def _is_dark(image: Any, value: float) -> bool:
    """Whether the colour of a value is nearer to black than to white: by its luma (ITU-R BT.601)."""
    red, green, blue, _ = image.cmap(image.norm(value))
    return bool(0.299 * red + 0.587 * green + 0.114 * blue < 0.5)


@styled
def draw_parameters(
    matches: Sequence[MatchReport],
    admitted_at: Collection[int],
    nominal: Match | None,
    period: float,
) -> Figure:
    """Value and 95 % interval of every parameter over the session; refused matches hollow.

    `admitted_at` holds the samples of the matches admitted to the family.
    """
    fitted = [m for m in matches if np.isfinite(m.match.chi2)]
    names = fitted[0].match.free if fitted else ()
    figure = new_figure(10, max(1.75 * len(names), 1.5) + 0.4)
    if not names:
        empty(panel(figure), "no match was made")
        return figure
    plant = fitted[0].match.parameters.model.plant
    axes = stack(figure, [1.0] * len(names))
    groups = {
        "refused": [m for m in fitted if m.sample not in admitted_at],
        "admitted": [
            m for m in fitted if m.sample in admitted_at and m.match is not nominal
        ],
        "nominal": [m for m in fitted if m.match is nominal],
    }
    for parameter_axes, name in zip(axes, names, strict=True):
        _draw_parameter(parameter_axes, groups, parameter_format(plant, name), period)
    axes[-1].set_xlabel("time since the session began / s")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3
    )
    align_labels(axes)
    return figure


def _bars(
    matches: Sequence[Match], shown: ParameterFormat, values: FloatArray
) -> FloatArray:
    """Lengths of the bars below and above the values, shape (2, N): none to an unbounded or unknown end."""
    intervals = np.array([interval(match, shown.name)[:2] for match in matches])
    ends = (intervals * shown.factor + shown.offset).T
    lengths = np.abs(np.where(np.isfinite(ends), ends, values) - values)
    return np.asarray(lengths, dtype=np.float64)


def _draw_parameter(
    axes: Axes,
    groups: Mapping[str, Sequence[MatchReport]],
    shown: ParameterFormat,
    period: float,
) -> None:
    axes.set_ylabel(shown.label)
    styles: dict[str, dict[str, Any]] = {
        "refused": {"color": SET_POINT, "marker": "o", "mfc": "white", "ms": 4},
        "admitted": {"color": PLANT, "marker": "o", "ms": 4},
        "nominal": {"color": CLOSED, "marker": "D", "ms": 7},
    }
    all_values: list[float] = []
    for name, group in groups.items():
        points = {
            m.sample * period: m.match for m in group if shown.name in m.match.free
        }
        if not points:
            continue
        values = np.array(
            [shown.shown(value_of(match, shown.name)) for match in points.values()]
        )
        bars = _bars(list(points.values()), shown, values)
        axes.errorbar(
            list(points),
            values,
            bars,
            ls="",
            lw=1,
            capsize=2,
            label=name,
            **styles[name],
        )
        all_values += values.tolist()
    low = min(all_values)
    high = max(all_values)
    margin = 0.25 * (high - low) + 0.05 * abs(high) + 1e-9
    axes.set_ylim(max(low - margin, 0.0) if low >= 0 else low - margin, high + margin)


@styled
def draw_responses(members: Sequence[Member]) -> Figure:
    """For every candidate its measured window, and the responses of its twin and Box–Jenkins model."""
    loops = channels(members[0].settings.plant)
    panels = [(member, k) for member in members for k in range(len(loops))]
    beside = 2 if len(loops) == 1 else min(len(loops), SIDE_BY_SIDE)
    rows = -(-len(panels) // beside)
    figure = new_figure(max(10, 5 * beside), 2.7 * rows + 0.3)
    grids = figure.add_gridspec(rows, beside, wspace=0.04, hspace=0.06)
    for place, (member, k) in enumerate(panels):
        upper, control = stack(figure, (3, 2), grids[place // beside, place % beside])
        _draw_member(upper, control, member, k)
        if place % beside == 0 or loops[1:]:
            signals = signal_names(loops[k])
            upper.set_ylabel(signals.output.label)
            control.set_ylabel(signals.input.label)
        if place + beside >= len(panels):
            control.set_xlabel("time / s")
        if place == 0:
            named = upper.get_legend_handles_labels()
            figure.legend(*named, loc="outside upper right", ncols=4, borderaxespad=0)
    return figure


def _draw_member(upper: Axes, control: Axes, member: Member, k: int) -> None:
    """The k-th output and input of a candidate's window, with the responses of its twin and its model."""
    window = member.window.alone(k)
    order = member.score.chosen_order
    twin = member.quiet_twin.alone(k)
    model = member.simulated(order) if member.modelled else None
    time = window.time[SKIPPED:]
    closed = member.settings.law is not None
    draw_outputs(upper, window, closed=closed, lw=1.4)
    upper.plot(time, twin.output, color=CLOSED, lw=1, label="twin")
    if model is not None:
        upper.plot(
            time,
            model.output,
            color=MODEL,
            lw=0.9,
            ls=(0, (1, 1.2)),
            label="Box–Jenkins B/F",
        )
    draw_inputs(control, window, 0.9)
    if closed:
        control.plot(time, twin.input, color=CLOSED, lw=0.9)
    if closed and model is not None:
        control.plot(time, model.input, color=MODEL, lw=0.8, ls=(0, (1, 1.2)))
    mark = (
        f"{f', order {order}' if order else ''}{', nominal' if member.nominal else ''}"
    )
    upper.set_title(
        f"{member.score.name}{mark}", weight="bold" if member.nominal else None
    )
    upper.margins(x=0.01)


@styled
def draw_uncertainty(members: Sequence[Member]) -> Figure:
    """The twins of all candidates on the nominal one's window; their spread is the uncertainty."""
    nominal = next((m for m in members if m.nominal), members[0])
    window = nominal.window
    answers = [response_on(m.score.parameters, window, m.settings.law) for m in members]
    loops = channels(nominal.settings.plant)
    figure, stacks = columns(10, 7.4, (3, 2, 2, 2), len(loops))
    for k, (axes, loop) in enumerate(zip(stacks, loops, strict=True)):
        _draw_answers(
            axes,
            loop,
            window.alone(k),
            [answer.alone(k) for answer in answers],
            members,
        )
        align_labels(axes)
    named = stacks[0][0].get_legend_handles_labels()
    figure.legend(*named, loc="outside upper center", ncols=min(5, len(members) + 2))
    return figure


def _draw_answers(
    axes: Sequence[Axes],
    plant: type[Plant],
    window: Window,
    answers: Sequence[Response],
    members: Sequence[Member],
) -> None:
    """One output and one input of all twins, and how far they are from the nominal one."""
    time = window.time[SKIPPED:]
    draw_outputs(axes[0], window, closed=members[0].settings.law is not None, lw=2)
    draw_inputs(axes[1], window, 1.6)
    for member, answer, colour in zip(
        members, answers, family_colours(len(members)), strict=True
    ):
        line: dict[str, Any] = {"color": colour, "lw": 0.9, "zorder": 2}
        if member.nominal:
            line = {"color": CLOSED, "lw": 1.4, "zorder": 3}
        name = f"twin of {member.score.name}{' (nominal)' if member.nominal else ''}"
        axes[0].plot(time, answer.output, label=name, **line)
        axes[1].plot(time, answer.input, **line)
    _draw_spread(
        axes[2], time, np.stack([answer.output for answer in answers]), members
    )
    _draw_spread(axes[3], time, np.stack([answer.input for answer in answers]), members)
    name_signals(axes, signal_names(plant), "minus nominal")
    axes[-1].set_xlabel("time since the session began / s")
    axes[0].margins(x=0.005)


def _draw_spread(
    axes: Axes, time: FloatArray, table: FloatArray, members: Sequence[Member]
) -> None:
    """Difference of every twin of the family from the nominal one, and the band they span."""
    nominal = next((k for k, m in enumerate(members) if m.nominal), 0)
    difference = table - table[nominal]
    low = np.min(difference, axis=0)
    high = np.max(difference, axis=0)
    axes.fill_between(time, low, high, color=CLOSED, alpha=0.2, lw=0)
    for k, colour in enumerate(family_colours(len(members))):
        if k != nominal:
            axes.plot(time, difference[k], color=colour, lw=0.9)
    axes.axhline(0, color=CLOSED, lw=1.2)


def family_colours(count: int) -> list[tuple[float, ...]]:
    """A colour for every candidate, coldest operating point first."""
    from matplotlib import colormaps  # noqa: PLC0415

    return [
        tuple(c)
        for c in colormaps[FAMILY_MAP](np.linspace(0.0, 0.9, max(count, 1)))[:count]
    ]
