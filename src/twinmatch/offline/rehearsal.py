"""A short simulated run through the twin, so that everything is compiled before a real one begins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twinmatch import __version__
from twinmatch.dynamics import Plant, Sensor, begin, simulate_closed_loop
from twinmatch.dynamics.store import cache_folder
from twinmatch.offline.judgement import judge_samples
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import TwinSettings

__all__ = ["rehearse"]

LEVELS = (0.2, 0.6, 0.3)
"""Set-points, as shares of the usual range: enough for a match, a second candidate and gaps."""
HOLD = 240
"""Samples of each."""


def rehearse(plant: type[Plant], settings: TwinSettings, watch: Callable[[int, int], None]) -> None:
    """Judge a simulated run, unless this version has done so on this machine; the verdicts are discarded.

    Compiled code is kept, so this takes a minute or two the first time. Without it that time would pass while
    the rig already runs, and matches would come too late. A plant without a loop is not rehearsed.

    Args:
        plant: the plant to simulate.
        settings: the settings of the twin.
        watch: called with how many samples of how many are judged.
    """
    mark = cache_folder() / f"rehearsed-{plant.name}-{__version__}"
    if plant.loop is None or mark.exists():
        return
    low, high = plant.output.set_points or plant.output.span
    reference = np.repeat([low + (high - low) * share for share in LEVELS], HOLD)
    parameters = plant.model().parameters()
    response = simulate_closed_loop(
        parameters,
        reference,
        states=begin(parameters, float(reference[0])),
        gains=settings.gains,
        sensor=Sensor(noise=plant.output.noise).realise(reference.size, settings.period, seed=1),
    )
    window = Window(reference, response.output, response.input, period=settings.period)
    judge_samples("rehearsal", samples_of(window), settings, watch=watch)
    mark.parent.mkdir(parents=True, exist_ok=True)
    mark.touch()
