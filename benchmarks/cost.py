"""Cost: processor time of a replay by samples, signals, rate and candidates.

Each case changes one of the four and leaves the others as in the first case. Recordings are simulated, closed
loop. Times are those of the processor, so a busy machine lengthens them by little.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from benchmarks.common import Row, forget_results, main
from benchmarks.rig import SINK, recorded
from twinmatch.dynamics import Parameters, begin, simulate_closed_loop
from twinmatch.dynamics.simulation import law_for
from twinmatch.offline.judging import judge_samples
from twinmatch.plants import Peltier, TCLab, TCLabBoth
from twinmatch.sessions import samples_of
from twinmatch.signals import FloatArray, Sample, Window
from twinmatch.twin import TwinSettings

SAMPLES = (900, 1800, 3600, 7200)
RATES = (1, 10, 100)
"""Samples per second."""
CANDIDATES = (1, 2, 4, 8)
"""Most that are kept in the family."""
REGIME = 300
"""Samples between two steps of the set-point."""


@dataclass(frozen=True)
class Case:
    """One recording to judge."""

    name: str
    samples: Sequence[Sample]
    settings: TwinSettings


def run(quick: bool) -> list[Row]:
    length = 320 if quick else 3600
    cases = [
        *_by_samples(quick),
        *_by_signals(length),
        *_by_rate(length),
        *_by_candidates(length),
    ]
    return _measured(cases, 1 if quick else 3)


def _by_samples(quick: bool) -> list[Case]:
    lengths = (160, 320) if quick else SAMPLES
    return [
        Case(f"{length} samples", recorded(length), TwinSettings())
        for length in lengths
    ]


def _by_signals(length: int) -> list[Case]:
    one_heater = TCLab.model(TCLab.followed).typical()
    two_heaters = TCLabBoth.model(TCLabBoth.followed).typical()
    levels = _levels(length, 30.0, 50.0)
    return [
        _simulated("kit, one loop", one_heater, levels[:, None], 1.0),
        _simulated(
            "kit, two loops", two_heaters, np.column_stack([levels, levels[::-1]]), 1.0
        ),
    ]


def _by_rate(length: int) -> list[Case]:
    levels = _levels(length, 30.0, 80.0)[:, None]
    return [_simulated(f"rig at {rate} Hz", SINK, levels, 1.0 / rate) for rate in RATES]


def _by_candidates(length: int) -> list[Case]:
    samples = recorded(length)
    return [
        Case(
            f"at most {count} candidates", samples, TwinSettings(most_candidates=count)
        )
        for count in CANDIDATES
    ]


def _levels(length: int, low: float, high: float) -> FloatArray:
    """Set-points, shape (N,), which change every `REGIME` samples."""
    random_levels = np.random.default_rng(5).uniform(low, high, -(-length // REGIME))
    return np.repeat(random_levels, REGIME)[:length]


def _simulated(
    name: str, truth: Parameters, references: FloatArray, period: float
) -> Case:
    """A recording of a plant under its own loop; references have shape (N, r)."""
    plant = truth.model.plant
    law = law_for(plant, period)
    sensor = (plant.sensor or Peltier.sensor).realise(len(references), period, 5)
    response = simulate_closed_loop(
        truth, references, states=begin(truth, references[0]), law=law, sensor=sensor
    )
    window = Window(references, response.outputs, response.inputs, period=period)
    return Case(name, samples_of(window), TwinSettings.of(plant, period=period))


def _measured(cases: Sequence[Case], rounds: int) -> list[Row]:
    """The rows of all cases, each judged once a round; a first round compiles and does not count."""
    times: dict[str, list[float]] = {case.name: [] for case in cases}
    for turn in range(rounds + 1):
        for case in cases:
            forget_results()
            start = time.process_time()
            judge_samples(case.name, case.samples, case.settings)
            if turn > 0:
                times[case.name].append(time.process_time() - start)
    return [_row(case, times[case.name]) for case in cases]


def _row(case: Case, seconds: Sequence[float]) -> Row:
    typical = median(seconds)
    count = len(case.samples)
    note = f"{1000 * typical / count:.2f} ms per sample, of {count}"
    return Row("cost", case.name, "twinmatch", typical, repeats=len(seconds), note=note)


if __name__ == "__main__":
    main(run, __doc__)
