"""Figures are laid out: what belongs to their axes has room, and is measured once."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from twinmatch.showing.figures.drawing import new_figure, panel, png, stack, styled


@styled
def two_stacks(largest: float) -> Figure:
    """Two columns of three panels with labels and titles, and a legend above them."""
    figure = new_figure(10, 6)
    grid = figure.add_gridspec(1, 2)
    time = np.linspace(0.0, 3600.0, 100)
    for column in range(2):
        for axes in stack(figure, (3, 1.5, 1), grid[0, column]):
            axes.plot(time, largest * np.sin(time / 300.0), label="plant")
            axes.set_ylabel("measured −\nforecast / °C")
        axes.set_xlabel("time / s")
        figure.axes[-3].set_title("two lines\nof a title")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


@pytest.mark.parametrize("largest", [1e-3, 1.0, 250.0, 1e5])
def test_decorations_lie_in_the_figure_and_beside_one_another(largest: float) -> None:
    figure = two_stacks(largest)
    png(figure)
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    for box in boxes:
        assert box is not None
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
    left, right = boxes[:3], boxes[3:]
    assert max(box.x1 for box in left) < min(box.x0 for box in right)


def test_panels_have_the_room_that_measuring_them_twice_would_give() -> None:
    ours = two_stacks(250.0)
    measured_twice = two_stacks(250.0)
    png(ours)
    measured_twice.savefig(io.BytesIO(), format="png")
    for panel_axes, twice in zip(ours.axes, measured_twice.axes, strict=True):
        edges = panel_axes.get_position().bounds
        np.testing.assert_allclose(edges, twice.get_position().bounds, atol=2e-3)


def test_a_layout_measures_panels_once(monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[Axes] = []
    measure = Axes.get_tightbbox

    def counting(axes: Axes, *args: Any, **options: Any) -> Any:
        measured.append(axes)
        return measure(axes, *args, **options)

    monkeypatch.setattr(Axes, "get_tightbbox", counting)
    figure = two_stacks(1.0)
    png(figure)
    assert measured == figure.axes


def test_axes_that_show_nothing_but_words_take_no_room_beside_them() -> None:
    figure = new_figure(4, 2)
    axes = panel(figure)
    axes.set_axis_off()
    png(figure)
    x, y, width, height = axes.get_position().bounds
    assert min(x, y) < 0.05
    assert min(width, height) > 0.9
