"""The thermal image."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import ColorBar, Column, ColumnDataSource, LinearColorMapper
from bokeh.palettes import Inferno256
from bokeh.plotting import figure
from numpy.typing import NDArray

from twinmatch.showing.page.look import panel

__all__ = ["Thermal"]

LEAST_SPAN = 4.0
"""Smallest span of the colours, K: less would show the camera's noise as a picture."""


class Thermal:
    """The thermal image of one tab."""

    def __init__(self) -> None:
        """Start without an image; the card is hidden."""
        self._source = ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []})
        self._colours = LinearColorMapper(palette=Inferno256, low=20.0, high=30.0, nan_color="#8C8C8C")
        self.figure = self._draw()
        heading = panel("thermal_heading", "<h2>Thermal image / °C</h2>")
        self.root = Column(
            heading,
            self.figure,
            name="thermal_card",
            css_classes=["card"],
            visible=False,
            sizing_mode="stretch_width",
        )
        """The whole card; hidden for a plant without a camera."""

    def update(self, image: NDArray[np.float32]) -> None:
        """Show an image in °C, first row on top."""
        self.root.visible = True
        rows, columns = image.shape
        low, high = float(np.nanmin(image)), float(np.nanmax(image))
        wider = max(0.0, LEAST_SPAN - (high - low)) / 2
        self._colours.low, self._colours.high = round(low - wider, 1), round(high + wider, 1)
        self._source.data = {"image": [image[::-1]], "x": [0], "y": [0], "dw": [columns], "dh": [rows]}

    def _draw(self) -> Any:
        chart = figure(
            name="thermal",
            height=260,
            sizing_mode="stretch_width",
            match_aspect=True,
            tools="",
            toolbar_location=None,
            x_axis_type=None,
            y_axis_type=None,
            min_border_left=4,
            min_border_right=56,  # room for labels such as 22.5
        )
        chart.grid.grid_line_color = None
        chart.x_range.range_padding = chart.y_range.range_padding = 0
        chart.image("image", "x", "y", "dw", "dh", source=self._source, color_mapper=self._colours)
        bar = ColorBar(color_mapper=self._colours, width=10, padding=6)
        chart.add_layout(bar, "right")
        return chart
