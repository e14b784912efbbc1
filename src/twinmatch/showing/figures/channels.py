"""What competed to explain the readings of a plant with several channels, what led, and when."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING, Final

import numpy as np

from twinmatch.comparing import TrustLevel
from twinmatch.health.channels import CHANGE, ChannelAlarm
from twinmatch.offline.channels import ChannelHealth
from twinmatch.showing.figures.drawing import empty, legend_above, new_figure, styled
from twinmatch.showing.figures.session import draw_estimate
from twinmatch.showing.style import CLOSED, DRIVEN, LEVELS, MODEL, ORDERS, SET_POINT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST: Final = 8
"""Causes that are drawn: those with the most evidence."""
_COLOURS: Final = (CLOSED, *ORDERS, DRIVEN, MODEL)


@styled
def draw_channels(health: ChannelHealth) -> Figure:
    """Evidence of every cause over time, the alarms as bars above, and what sensors that lied should have
    read below."""
    figure = new_figure(10, 4.2 + 2.4 * len(health.through))
    axes, *below = figure.subplots(1 + len(health.through), squeeze=False)[:, 0]
    for estimate_axes, estimated in zip(below, health.through, strict=True):
        draw_estimate(estimate_axes, estimated, health.period, health.samples)
    if not health.course:
        empty(axes, "nothing explained the readings better than a healthy plant")
        return figure
    most = sorted(health.course, key=lambda name: -max(nats for _, nats in health.course[name]))[:_MOST]
    for name, colour, line in zip(most, cycle(_COLOURS), cycle(("-", "--", ":")), strict=False):
        samples, nats = np.array(health.course[name]).T
        broken = np.flatnonzero(np.diff(samples, prepend=samples[0]) > 1)
        time = np.insert(samples, broken, np.nan) * health.period
        axes.plot(time, np.insert(nats, broken, np.nan), color=colour, ls=line, label=name)
    axes.axhline(CHANGE, color=SET_POINT, lw=0.8)
    axes.set_yscale("symlog", linthresh=10.0)
    for alarm in health.alarms:
        _draw_alarm(axes, alarm, health)
    axes.set_xlim(0.0, health.samples * health.period)
    (below or [axes])[-1].set_xlabel("time since the session began / s")
    axes.set_ylabel("evidence beyond its price / nats")
    legend_above(axes, 4)
    return figure


def _draw_alarm(axes: Axes, alarm: ChannelAlarm, health: ChannelHealth) -> None:
    """A bar from its beginning to its end, and its name where it was reported."""
    begin = alarm.first * health.period
    last = health.samples if alarm.last is None else alarm.last
    axes.axvspan(begin, last * health.period, color=LEVELS[TrustLevel.FAULT], alpha=0.1, lw=0)
    name = f"{alarm.fault.value}\n{alarm.signal}"
    place = (alarm.flagged * health.period, 1.0)
    axes.annotate(name, place, xycoords=("data", "axes fraction"), size=7, va="top")
