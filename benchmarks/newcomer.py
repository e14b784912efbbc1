"""Newcomers with twenty simulated plants of which nothing is recorded, led to a trusted twin and a PID.

    python -m benchmarks.newcomer 20        # the plants that the method was made with
    python -m benchmarks.newcomer 20 500    # others: the number is the first seed

Kettles, rooms, hot ends and tanks in turn, each by its own physics, which the plant file does not have. The
newcomer knows the ranges, and the time constant up to a factor of two; types what is printed, and records
what is asked for. At the end the PID runs on the plant itself.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.support.newcomers import KINDS, Led, lead

SETTLED = 0.1
"""Largest distance from the set-point, as a share of the step, at which the PID counts as settled."""


def main(arguments: Sequence[str]) -> None:
    """Lead as many newcomers as asked for, and print how each of them fared."""
    number = int(arguments[0]) if arguments else 20
    first_seed = int(arguments[1]) if len(arguments) > 1 else 100
    all_led = []
    for k in range(number):
        plant = KINDS[k % len(KINDS)](np.random.default_rng(first_seed + k))
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            led = lead(plant, Path(folder), seed=1000 * k)
        all_led.append(led)
        print(
            f"{k + 1:2} {_words(led)}; {time.perf_counter() - began:.0f} s", flush=True
        )
    led_there = sum(led.trusted and led.kept and led.error < SETTLED for led in all_led)
    print(
        f"{led_there} of {number}: trusted, in the range, settled by the PID, within three commands"
    )


def _words(led: Led) -> str:
    trust = "trusted" if led.trusted else "not trusted"
    kept = "kept its range" if led.kept else "LEFT its range"
    return (
        f"{led.plant.name}: {trust} after {led.commands} commands and {led.recordings} recordings, "
        f"{led.hours:.1f} h; {kept} ({led.lowest:.4g} to {led.highest:.4g}); PID: off by "
        f"{100 * led.error:.0f} %, overshoot {100 * led.overshoot:.0f} %"
        + ("" if led.trusted else "\n" + led.words)
    )


if __name__ == "__main__":
    main(sys.argv[1:])
