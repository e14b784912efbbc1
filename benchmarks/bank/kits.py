"""Simulated kits with two heaters in two loops, to which things happen."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from twinmatch.dynamics import Parameters, advance, begin
from twinmatch.dynamics.simulation import readings
from twinmatch.plants.tclab import RESOLUTION, TCLabBoth
from twinmatch.signals import Sample

BEGINS = 1500
ENDS = 2400
SIZE = 3000
"""When something happens, when it is over, and when the run is, s."""
MISHAPS = {
    "nothing": (None, None),
    "T1 +5 °C": ("sensor-drift", "temperature"), "T2 +5 °C": ("sensor-drift", "second_temperature"),
    "T1 -3 °C": ("sensor-drift", "temperature"),
    "Q1 × 0": ("drive-lost", "power"), "Q2 × 0": ("drive-lost", "second"),
    "Q1 × 0.8": ("drive-weak", "power"), "Q2 × 0.8": ("drive-weak", "second"),
    "losses × 2.5": ("losses-changed", "losses"), "T1 frozen": ("sensor-frozen", "temperature"),
}  # fmt: skip
"""What may happen; by what name, and of which channel, it is to be reported."""
_NOISE = 0.043


def typical() -> Parameters:
    """What is known of the kit before it is seen."""
    return TCLabBoth.model(TCLabBoth.followed).typical()


def run(
    seed: int, mishap: str, size: int = SIZE, begins: int = BEGINS
) -> Iterator[Sample]:
    """One of many kits, whose parameters differ by up to a quarter, in a room that becomes warmer and colder
    by 0.8 K; its set-points step every few minutes."""
    random = np.random.default_rng(seed)
    base = typical()
    other = {
        k: base[k] * math.exp(random.uniform(-0.22, 0.22))
        for k in base.model.structure.free
    }
    room = random.uniform(292.0, 299.0)
    phase = random.uniform(0.0, 2.0 * math.pi)
    kit = base.replace(**{**other, "ambient": room})
    x = begin(kit, np.full(2, room - 273.15))
    integral = np.zeros(2)
    before = np.full(2, room - 273.15)
    held = 0.0
    wanted = np.full(2, 35.0)
    steps_at = 0
    for k in range(size):
        if k >= steps_at:
            which = int(random.integers(0, 3))
            level = random.uniform(30.0, 60.0, 2)
            wanted = np.where((np.arange(2) == which) | (which == 2), level, wanted)
            steps_at = k + int(random.uniform(200.0, 500.0))
        on = mishap if begins <= k < ENDS else "nothing"
        now = kit.replace(
            ambient=room + 0.8 * math.sin(2.0 * math.pi * k / 3600.0 + phase)
        )
        if on.startswith("losses"):
            now = now.replace(losses=2.5 * kit["losses"])
        y = (
            np.round(
                (readings(now, x) + _NOISE * random.standard_normal(2)) / RESOLUTION
            )
            * RESOLUTION
        )
        signal = int(on[1:2] or 1) - 1 if on[0] in "TQ" else 0
        if on.endswith("°C"):
            y[signal] += float(on.split()[1])
        held = held if on.endswith("frozen") else float(y[0])
        y[0] = held
        error = wanted - y
        asked = 5.0 * error + integral - 10.0 * (y - before)
        u = np.clip(asked, 0.0, 100.0)
        integral = integral + 5.0 / 120.0 * error + 0.0645 * (u - asked)
        before = y
        outputs = tuple(np.round(y, 3).tolist())
        yield Sample(k, k * 10**9, tuple(wanted.tolist()), outputs, tuple(u.tolist()))
        acts = u.copy()
        if on[0] == "Q":
            acts[signal] *= float(on.split()[-1])
        x = advance(now, x, acts, 1.0)
