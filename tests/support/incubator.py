"""Recordings of the published incubator, and what its authors' twins said of the same runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twinmatch.importing import resample
from twinmatch.signals import FloatArray, Window

FIRST = "exp1_ht3_hg2"
SECOND = "exp2_ht20_hg30"
LID = "lid_opening_jan_2021"
LIDS = "lid_opening_mar_2021_first"
PERIOD = 3.0


def read_run(folder: Path, name: str) -> Window:
    """A run: the mean of both sensors in the box, the heat bed's state, and the room.

    The controller takes a step for every row and changes the heat bed there, so what a row says of it holds
    until the next.
    """
    table = np.genfromtxt(
        folder / f"{name}.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    time = table["time"].astype(np.float64)
    columns = {
        "box": (table["t2"] + table["t3"]) / 2,
        "heater": table["heater_on"].astype(np.float64),
        "room": table["t1"].astype(np.float64),
    }
    resampled = resample(
        time * (1e-9 if time[0] > 1e12 else 1.0),
        columns,
        {"box": "reading", "heater": "held", "room": "reading"},
        PERIOD,
    ).columns
    box = resampled["box"]
    room = resampled["room"]
    return Window(
        np.full(box.size, box[0]),
        box,
        resampled["heater"],
        period=PERIOD,
        disturbances=room[:, None],
    )


def read_events(folder: Path, name: str) -> FloatArray:
    """When the lid was opened and closed in turn, s after the run's first row."""
    begin, events = (
        np.loadtxt(
            folder / f"{name}{suffix}.csv",
            dtype=np.int64,
            delimiter=",",
            skiprows=1,
            usecols=0,
        )
        for suffix in ("", "_events")
    )
    return np.asarray((events - begin[0]) * 1e-9, dtype=np.float64)


def published_twin(
    folder: Path, name: str, parameters: int
) -> tuple[FloatArray, FloatArray]:
    """Temperatures of the authors' twin with so many parameters, and of the box, row by row."""
    table = np.genfromtxt(
        folder / f"{name}.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    twin = np.genfromtxt(
        folder / f"twin_{parameters}P_{name}.csv", delimiter=",", skip_header=1
    )[:, 1]
    box = (table["t2"] + table["t3"]) / 2
    size = min(twin.size, box.size)
    return twin[:size], np.asarray(box[:size], dtype=np.float64)
