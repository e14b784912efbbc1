"""Figures are laid out: what belongs to their panels has room, is measured once, and is drawn."""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.axis import Tick
from matplotlib.figure import Figure

from twinmatch.showing.figures.drawing import (
    align_labels,
    new_figure,
    panel,
    png,
    stack,
    styled,
    svg,
)
from twinmatch.showing.figures.elements.panel import Panel


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


@pytest.mark.parametrize("largest", [1e-3, 1.0, 250.0, 1e5, 3e7])
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


@styled
def one_panel(largest: float) -> Panel:
    """A panel with a line from 0 to a largest value."""
    axes = panel(new_figure(5, 3))
    axes.plot([0.0, 3.0], [0.0, largest])
    return axes


def figure_of(axes: Axes) -> Figure:
    figure = axes.figure
    assert isinstance(figure, Figure)
    return figure


def written(axes: Panel) -> str:
    """The figure of a panel as an SVG document."""
    return svg(figure_of(axes))


@styled
def numbers_of_matplotlib(axes: Axes) -> list[list[str]]:
    """What axes of matplotlib write at their ticks, below and at the left."""
    plain = new_figure(5, 3).add_subplot()
    plain.set_position(axes.get_position())
    plain.plot(*axes.get_lines()[0].get_data())
    plain.set_xlim(axes.get_xlim())
    numbers = []
    for axis in (plain.xaxis, plain.yaxis):
        low, high = sorted(axis.get_view_interval())
        places = axis.get_majorticklocs()
        labels = axis.get_major_formatter().format_ticks(places)
        shown = zip(places, labels, strict=True)
        numbers.append([label for place, label in shown if low <= place <= high])
    return numbers


@pytest.mark.parametrize("largest", [-3.0, 1e-3, 7.0, 250.0, 1e5])
def test_rulers_show_the_numbers_that_matplotlib_would(largest: float) -> None:
    axes = one_panel(largest)
    written(axes)
    assert [axes.below.numbers, axes.left.numbers] == numbers_of_matplotlib(axes)
    assert len(axes.below.numbers) == len(axes.below.places) > 2


def test_every_number_of_a_ruler_is_drawn() -> None:
    axes = one_panel(1234.0)
    document = written(axes)
    for number in (*axes.below.numbers, *axes.left.numbers):
        assert f"<!-- {number} -->" in document


def test_a_factor_of_all_numbers_is_drawn_with_them() -> None:
    axes = one_panel(3e7)
    document = written(axes)
    assert max(map(float, axes.left.numbers)) <= 3.0
    assert "<!-- 1e7 -->" in document
    assert "<!-- 1e7 -->" not in written(one_panel(3.0))


def test_no_tick_of_matplotlib_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Tick] = []
    make = Tick.__init__

    def counting(tick: Tick, *args: Any, **options: Any) -> None:
        made.append(tick)
        make(tick, *args, **options)

    monkeypatch.setattr(Tick, "__init__", counting)
    svg(two_stacks(250.0))
    assert made == []


def test_a_program_that_asks_for_ticks_of_matplotlib_gets_them() -> None:
    axes = one_panel(3.0)
    written(axes)
    texts = [label.get_text() for label in axes.get_yticklabels()]
    assert set(axes.left.numbers) <= set(texts)


def test_the_grid_has_a_line_at_each_tick_of_the_axes_that_are_to_have_one() -> None:
    axes = one_panel(3.0)
    written(axes)
    vertical = {x for (x, _), (end, _) in axes.grid_lines() if x == end}
    horizontal = {y for (_, y), (_, end) in axes.grid_lines() if y == end}
    assert vertical == set(axes.below.places)
    assert horizontal == set(axes.left.places)
    axes.grid(visible=False, axis="x")
    assert len(axes.grid_lines()) == len(horizontal)
    axes.grid(visible=False)
    assert axes.grid_lines() == []
    axes.grid(axis="x")
    assert len(axes.grid_lines()) == len(vertical)


def test_ticks_have_names_in_place_of_numbers() -> None:
    axes = one_panel(3.0)
    names = ["below", "refused", "admitted", "above"]
    axes.left.name_ticks([-9.0, 0.0, 1.0, 9.0], names)
    document = written(axes)
    assert axes.left.numbers == ["refused", "admitted"]
    assert "<!-- admitted -->" in document
    assert "<!-- above -->" not in document


def test_wide_names_have_their_room_beside_longer_ones() -> None:
    edges = []
    for names in (["iiiiiiiii", "mm"], ["iiiiiiiii", "mmmmmmmm"]):
        axes = one_panel(3.0)
        axes.left.name_ticks([0.0, 1.0], names)
        png(figure_of(axes))
        edges.append(axes.get_position().x0)
    assert edges[1] > edges[0] + 0.02


def test_turned_names_have_room_below_their_panel() -> None:
    edges = []
    for rotation in (0.0, 45.0):
        axes = one_panel(3.0)
        names = ["the name of a session", "of another"]
        axes.below.name_ticks([1.0, 2.0], names, rotation=rotation)
        png(figure_of(axes))
        edges.append(axes.get_position().y0)
        box = axes.get_tightbbox()
        assert box is not None
        assert box.y0 >= figure_of(axes).bbox.y0
    assert edges[1] > edges[0] + 0.1


@styled
def labelled_stack() -> list[Panel]:
    """Panels below one another whose numbers are of different widths."""
    panels = stack(new_figure(6, 4), (1, 1, 1))
    for axes, largest in zip(panels, (1.0, 1e5, 10.0), strict=True):
        axes.plot([0.0, 1.0], [-largest, largest])
        axes.set_ylabel("error / K")
    return panels


def test_labels_are_on_one_line_where_they_are_aligned() -> None:
    apart = labelled_stack()
    png(figure_of(apart[0]))
    edges = [axes.yaxis.label.get_window_extent().x1 for axes in apart]
    assert edges[1] < min(edges[0], edges[2]) - 5.0
    aligned = labelled_stack()
    align_labels(aligned)
    png(figure_of(aligned[0]))
    edges = [axes.yaxis.label.get_window_extent().x1 for axes in aligned]
    np.testing.assert_allclose(edges, edges[1], atol=0.5)


def test_axes_that_show_words_only_have_no_ruler() -> None:
    axes = one_panel(1234.0)
    axes.set_axis_off()
    document = written(axes)
    assert axes.left.numbers
    for number in axes.left.numbers:
        assert f"<!-- {number} -->" not in document


def test_numbers_that_another_panel_shows_are_not_written() -> None:
    upper, lower = stack(new_figure(5, 4), (1, 1))
    lower.plot([0.0, 3.0], [0.0, 3.0])
    png(figure_of(upper))
    assert upper.below.numbers == []
    np.testing.assert_allclose(upper.below.places, lower.below.places)


_TEXT_OF_MATPLOTLIB = re.compile(
    r"<!-- (.*?) -->\s*<g [^>]*translate\(([-\d.]+) ([-\d.]+)\)"
)
_WRITTEN = re.compile(r'<g id="(text-\w+)">\s*<!-- (.*?) -->')
_REFERENCE = re.compile(r'<use xlink:href="#(text-\w+)" x="([-\d.]+)" y="([-\d.]+)"/>')


@styled
def by_matplotlib(figure: Figure) -> str:
    """The SVG document that matplotlib writes of a figure that is laid out."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg")
    return stream.getvalue()


def test_texts_are_where_matplotlib_writes_them_and_once_in_the_document() -> None:
    figure = two_stacks(250.0)
    document = svg(figure)
    expected = [
        (text, float(x), float(y))
        for text, x, y in _TEXT_OF_MATPLOTLIB.findall(by_matplotlib(figure))
    ]
    text_of_name = dict(_WRITTEN.findall(document))
    found = [
        (text_of_name[name], float(x), float(y))
        for name, x, y in _REFERENCE.findall(document)
    ]
    assert [text for text, *_ in found] == [text for text, *_ in expected]
    np.testing.assert_allclose(
        [place for _, *place in found], [place for _, *place in expected], atol=1e-3
    )
    assert len(found) > 1.5 * len(text_of_name)
    assert len(_WRITTEN.findall(document)) == len(text_of_name)


def test_texts_with_another_look_are_written_apart() -> None:
    axes = one_panel(3.0)
    for size, turned in ((8, 0), (12, 0), (12, 90)):
        axes.text(1.0, 1.0, "limit", fontsize=size, rotation=turned)
    axes.text(1.0, 1.0, "limit", fontsize=12, rotation=90, color="red")
    axes.text(2.0, 2.0, "limit", fontsize=12, rotation=90, color="red")
    assert written(axes).count("<!-- limit -->") == 4


def test_a_text_that_is_cut_off_is_drawn_where_it_is_cut_off() -> None:
    axes = one_panel(3.0)
    for place in (0.5, 2.0):
        axes.text(place, 1.0, "part", clip_on=True)
    assert re.findall(r"<g clip-path=[^>]*>\s*<!-- part -->", written(axes))[1:]


def test_equal_texts_of_two_documents_have_equal_names() -> None:
    names = [dict(_WRITTEN.findall(written(one_panel(top)))) for top in (3.0, 30.0)]
    common = names[0].keys() & names[1].keys()
    assert common
    assert all(names[0][name] == names[1][name] for name in common)
