"""Forecasts of simulated rooms of one to three stores of heat, beside ARX and a Kalman filter with one store.

    python -m benchmarks.rooms 20

The number is that of rooms. Each is recorded for twelve days, every ten minutes, with heat from people and
the sun that nobody measures. From the third day on everybody forecasts every 100 minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tests.support.rooms import Room, StoredRoom, recorded_room
from twinmatch.dynamics import Plant
from twinmatch.forecasting import ForecastError
from twinmatch.sessions import samples_of
from twinmatch.signals import Window
from twinmatch.twin import Twin, TwinSettings

PERIOD = 600.0
HORIZONS = (3600.0, 14400.0, 28800.0)
FREE = 0.4
"""Heat that nobody measures on a bright day at noon, kW."""
_FROM = 288
_EVERY = 10
"""Samples before the first forecast, and between two."""


@dataclass
class Scored:
    """Forecasts of one room by a twin, from the same samples as those of the referees."""

    errors: list[list[float]] = field(default_factory=list)
    """At each horizon, °C, of every forecast."""
    arx: list[list[float]] = field(default_factory=list)
    held: list[list[bool]] = field(default_factory=list)
    """Whether the band held the reading."""
    trusted: list[tuple[float, ...]] = field(default_factory=list)
    """Horizons at which the leader was trusted, of each verdict from the first forecast on."""


def forecasts(plant: type[Plant], window: Window) -> Scored:
    """Those of the leader on a room, driven by its input and the outdoor temperature, as they came."""
    settings = TwinSettings.of(plant, period=window.period, law=None)
    twin = Twin(
        replace(settings, forecasts=replace(settings.forecasts, horizons=HORIZONS))
    )
    scored = Scored()
    leads = [round(h / window.period) - 1 for h in HORIZONS]
    most = leads[-1] + 1
    for k, sample in enumerate(samples_of(window)):
        outcome = twin.push(sample)
        if k < _FROM or k + most >= window.output.size:
            continue
        scored.trusted += [verdict.trusted for verdict in outcome.verdicts]
        if k % _EVERY:
            continue
        forecaster = twin.discriminator.forecaster
        ahead = window.input[k + 1 : k + most + 1]
        outside = window.disturbances[k : k + most + 1]
        try:
            band = forecaster.outlook().forecast(ahead, outside).output
        except ForecastError:
            continue
        came = window.output[k + 1 : k + most + 1][leads]
        arx = forecaster.arx.referees(ahead[:, None], outside)[1][0]
        scored.errors.append((came - band.mean[leads]).tolist())
        scored.arx.append((came - arx[leads]).tolist())
        scored.held.append(
            ((band.low[leads] <= came) & (came <= band.high[leads])).tolist()
        )
    return scored


def main(arguments: Sequence[str]) -> None:
    """Print a line for each room, and what they have in common."""
    rooms = int(arguments[0]) if arguments else 20
    kinds = {"ours": StoredRoom, "one store": Room}
    done: dict[str, list[Scored]] = {name: [] for name in kinds}
    for seed in range(rooms):
        window = recorded_room(seed, 1 + seed % 3, PERIOD, FREE)
        for name, plant in kinds.items():
            done[name].append(forecasts(plant, window))
        share = np.mean(done["ours"][-1].held, axis=0)
        print(
            f"room {seed}, {1 + seed % 3} stores: held {np.round(100 * share)} %",
            flush=True,
        )
    ours, alone = done.values()
    said = (
        [(one.errors, one.arx, one.held) for one in ours],
        [(one.errors, one.held) for one in alone],
    )
    rows = [*zip(*said[0], strict=True), *zip(*said[1], strict=True)]
    names = (
        "our error",
        "ARX's",
        "held by ours, %",
        "error of one store",
        "held by it, %",
    )
    for name, row in zip(names, rows, strict=True):
        every = np.concatenate([np.array(one) for one in row if one])
        found = (
            100 * every.mean(axis=0)
            if every.dtype == bool
            else np.sqrt(np.square(every).mean(axis=0))
        )
        print(
            f"{name:20s}",
            *(f"{value:6.2f}" for value in found),
            "   at",
            *HORIZONS,
            "s",
        )
    for stores in (1, 2, 3):
        told = [trusted for one in alone[stores - 1 :: 3] for trusted in one.trusted]
        shares = [100 * np.mean([h in trusted for trusted in told]) for h in HORIZONS]
        print(
            f"one store trusted in rooms of {stores}, % of {len(told)} verdicts:",
            np.round(shares),
        )


if __name__ == "__main__":
    main(sys.argv[1:])
