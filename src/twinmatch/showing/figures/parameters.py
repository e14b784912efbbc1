"""The parameters of every match, with their intervals."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from twinmatch.fitting import Match
from twinmatch.showing.figures.drawing import empty, new_figure, stack, styled
from twinmatch.showing.intervals import interval, value_of
from twinmatch.showing.quantities import Quantity, quantity
from twinmatch.showing.style import CLOSED, PLANT, SET_POINT
from twinmatch.twin import MatchReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_parameters"]


@styled
def draw_parameters(
    matches: Sequence[MatchReport], joined: Collection[int], nominal: Match | None, period: float
) -> Figure:
    """Value and 95 % interval of every parameter over the session; refused matches hollow.

    `joined` holds the samples of the matches admitted to the family.
    """
    fitted = [m for m in matches if np.isfinite(m.match.chi2)]
    names = fitted[0].match.free if fitted else ()
    figure = new_figure(10, max(1.75 * len(names), 1.5) + 0.4)
    if not names:
        empty(figure.add_subplot(), "no match was made")
        return figure
    plant = fitted[0].match.parameters.model.plant
    axes = stack(figure, [1.0] * len(names))
    groups = {
        "refused": [m for m in fitted if m.sample not in joined],
        "admitted": [m for m in fitted if m.sample in joined and m.match is not nominal],
        "nominal": [m for m in fitted if m.match is nominal],
    }
    for each, name in zip(axes, names, strict=True):
        _draw_parameter(each, groups, quantity(plant, name), period)
    axes[-1].set_xlabel("time since the session began / s")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    figure.align_ylabels(axes)
    return figure


def _draw_parameter(
    axes: Axes, groups: Mapping[str, Sequence[MatchReport]], shown: Quantity, period: float
) -> None:
    axes.set_ylabel(shown.label)
    looks: dict[str, dict[str, Any]] = {
        "refused": {"color": SET_POINT, "marker": "o", "mfc": "white", "ms": 4},
        "admitted": {"color": PLANT, "marker": "o", "ms": 4},
        "nominal": {"color": CLOSED, "marker": "D", "ms": 7},
    }
    for name, group in groups.items():
        points = [(m.sample * period, m.match) for m in group if shown.name in m.match.free]
        if not points:
            continue
        values = np.array([_value(match, shown) for _, match in points])
        ends = np.array([_ends(match, shown) for _, match in points])
        spread = np.abs(ends.T - values)
        axes.errorbar(
            [t for t, _ in points], values, spread, ls="", lw=1, capsize=2, label=name, **looks[name]
        )
    everything = [
        _value(m.match, shown) for group in groups.values() for m in group if shown.name in m.match.free
    ]
    low, high = min(everything), max(everything)
    margin = 0.25 * (high - low) + 0.05 * abs(high) + 1e-9
    axes.set_ylim(max(low - margin, 0.0) if low >= 0 else low - margin, high + margin)


def _value(match: Match, shown: Quantity) -> float:
    return shown.shown(value_of(match, shown.name))


def _ends(match: Match, shown: Quantity) -> tuple[float, float]:
    """The interval's ends; an unbounded or unknown end equals the value, so that no bar is drawn there."""
    found = interval(match, shown.name)
    value = _value(match, shown)
    low, high = shown.shown(found.low), shown.shown(found.high)
    return (low if np.isfinite(low) else value), (high if np.isfinite(high) else value)
