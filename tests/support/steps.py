"""Recorded steps of a simulated rig."""

from __future__ import annotations

import numpy as np

from twinmatch.plant import Camera, RigParameters, simulate_closed_loop
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, Window


def quarter_of_an_hour() -> list[Sample]:
    """920 samples: a set-point step that shows nothing, then two that do."""
    reference = np.repeat([25.0, 40.0, 60.0, 45.0], [60, 300, 300, 260])
    parameters = RigParameters(seebeck=0.08, conductance=0.4, heat_capacity=30.0)
    camera = Camera().realise(reference.size, 1.0, 7)
    response = simulate_closed_loop(parameters, reference, plate=296.0, camera=camera)
    return samples_of(Window(reference=reference, output=response.output, input=response.input))
