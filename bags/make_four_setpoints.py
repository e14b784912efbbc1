"""Make the sample session `four_setpoints`: a simulated rig that is richer than the twin.

The heat sink has a mass and a fan's worth of convection, the camera has noise and freezes while it
corrects its flat field, and the set-points are the paper's 30, 50, 70 and 90 °C. Nothing in it comes
from a recording. Run `python bags/make_four_setpoints.py`; the bytes are the same every time.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from twinmatch.dynamics import begin, simulate_closed_loop
from twinmatch.emulation.virtual_rig import RICH_RIG
from twinmatch.errors import TwinmatchError
from twinmatch.plants import Peltier
from twinmatch.sessions import samples_of, write_session
from twinmatch.signals import Window

SET_POINTS = (30, 50, 70, 90, 50, 30, 70, 50, 90, 70)
"""°C; every level is met from below and from above."""
HOLD = 200
"""Samples each is held."""


def four_setpoints() -> Window:
    """The simulated run, 1 Hz."""
    reference = np.repeat(np.array(SET_POINTS, dtype=float), HOLD)
    sensor = Peltier.sensor.realise(len(reference), 1.0, seed=30507090)
    run = simulate_closed_loop(
        RICH_RIG, reference, states=begin(RICH_RIG, 22.0), sensor=sensor
    )
    return Window(reference, run.output, run.input)


if __name__ == "__main__":
    folder = Path(__file__).resolve().parent / "four_setpoints"
    try:
        write_session(folder, samples_of(four_setpoints()), overwrite=True)
    except TwinmatchError as error:
        sys.exit(f"make_four_setpoints: {error}")
    print(f"wrote {folder}")
