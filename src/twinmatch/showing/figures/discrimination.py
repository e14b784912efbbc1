"""Figures of the discrimination: the criteria of every order, and the ν-gaps between the candidates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from twinmatch.comparing import Verdict
from twinmatch.showing.figures.drawing import new_figure, styled
from twinmatch.showing.style import MATRIX_MAP, ORDERS, TEXT
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_criteria", "draw_gains", "draw_matrix", "fill_matrix"]

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
        axes = figure.add_subplot(grid[k // 2, k % 2])
        _draw_bars(axes, verdict, attribute)
        axes.set_title(f"{name} ({hint})")
        if k == 0:
            figure.legend(
                *axes.get_legend_handles_labels(),
                loc="outside upper right",
                ncols=len(ORDERS),
                title="order; a black frame marks the chosen one",
                title_fontsize=8,
            )
    return figure


def draw_gains(axes: Axes, verdict: Verdict) -> None:
    """Information gain of every candidate and order."""
    _draw_bars(axes, verdict, "gain")
    axes.set_ylabel("information gain / characters")
    axes.set_title("Family and orders (framed: chosen)")
    axes.legend(ncols=4, loc="upper left")
    axes.margins(y=0.2)


def _draw_bars(axes: Axes, verdict: Verdict, attribute: str) -> None:
    candidates = verdict.modelled
    orders = [o.order for o in candidates[0].orders]
    places = np.arange(len(candidates))
    width = 0.8 / len(orders)
    table = np.array([[getattr(o.total, attribute) for o in c.orders] for c in candidates], dtype=float)
    for k, order in enumerate(orders):
        values = _above_best(table, attribute)[:, k]
        bars = axes.bar(
            places + (k - (len(orders) - 1) / 2) * width,
            values,
            width,
            label=order,
            color=ORDERS[k % len(ORDERS)],
        )
        for bar, candidate in zip(bars, candidates, strict=True):
            if candidate.chosen_order == order:
                bar.set_edgecolor("black")
                bar.set_linewidth(1.6)
    axes.set_xticks(places, [c.name for c in candidates])
    axes.grid(visible=False, axis="x")


def _above_best(table: FloatArray, attribute: str) -> FloatArray:
    """Gains unchanged; other criteria, which are only comparable, relative to the candidate's best."""
    if attribute == "gain":
        return table
    best = np.min(table, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        above = table / best - 1 if attribute == "mdl" else table - best
    return np.asarray(np.nan_to_num(above, nan=0.0, posinf=0.0, neginf=0.0), dtype=np.float64)


@styled
def draw_matrix(verdict: Verdict) -> Figure:
    """The ν-gaps between all candidates as a heat map, and their sums."""
    count = len(verdict.candidates)
    size = 1.2 + 0.55 * count
    figure = new_figure(size + 2.6, size)
    fill_matrix(figure.add_subplot(), verdict)
    return figure


def fill_matrix(axes: Axes, verdict: Verdict) -> None:
    """The heat map itself."""
    matrix = np.array(verdict.nu_gap)
    top = max(float(matrix.max()), 1e-12)
    image: Any = axes.imshow(matrix, cmap=MATRIX_MAP, vmin=0, vmax=top)
    small = len(matrix) > _CROWDED
    for i, j in np.ndindex(*matrix.shape):
        red, green, blue, _ = image.cmap(image.norm(matrix[i, j]))
        dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
        text = f"{matrix[i, j]:.2f}"
        axes.text(
            j, i, text, ha="center", va="center", fontsize=7 if small else 8, color="white" if dark else TEXT
        )
    names = [c.name for c in verdict.candidates]
    rows = [f"{c.name}  Σ {c.nu_gap_sum:.2f}" for c in verdict.candidates]
    axes.set_xticks(range(len(names)), names, rotation=45 if len(names) > 4 else 0)
    axes.set_yticks(range(len(names)), rows)
    for label, name in zip(axes.get_yticklabels(), names, strict=True):
        label.set_fontweight("bold" if name == verdict.nominal else "normal")
    axes.set_title("ν-gap between the plants\n(smallest Σ: nominal, bold)")
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.figure.colorbar(image, ax=axes, shrink=0.8, label="ν-gap (0: the same, 1: entirely different)")
