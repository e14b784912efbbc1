"""Matching three parameters: native equations, and the same equations as FMUs.

One window of a simulated, noisy closed loop; each FMU runs in its own process: model exchange compiled from
C, and co-simulation written in Python. The ratio shows the cost of differences instead of exact tangents, and
of calls to another process instead of compiled loops. The note gives the deviation of the estimated Seebeck
coefficient from the native one.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.common import Row, main, measure_side_by_side, peer, rows_of
from tests.support.fmus import build_c_fmu, build_python_fmu, write_map
from twinmatch.dynamics import Model, begin, simulate_closed_loop
from twinmatch.fitting import Match, match
from twinmatch.plants import Peltier
from twinmatch.signals import Window

NATIVE = Peltier.model("held sink")


def run(quick: bool) -> list[Row]:
    samples, repeats = (150, 3) if quick else (500, 7)
    window = record(samples)
    with tempfile.TemporaryDirectory() as folder:
        models = {"twinmatch": NATIVE, **structures(Path(folder))}
        try:
            cases = {
                name: (lambda model=model: match(window, start=model.parameters()))
                for name, model in models.items()
            }
            timings = measure_side_by_side(cases, repeats=repeats, patience=120.0)
        finally:
            for model in models.values():
                Peltier.disown(model.structure_name)
    found: dict[str, Match] = {
        name: timing.result for name, timing in timings.items() if not timing.error
    }
    native = found["twinmatch"].parameters["seebeck"]
    notes = {
        name: f"seebeck off by {abs(one.parameters['seebeck'] / native - 1):.1e}"
        for name, one in found.items()
    }
    return rows_of("fmus", f"{samples} samples", timings, notes=notes)


def structures(folder: Path) -> dict[str, Model]:
    """The held sink as FMUs, if the tools to build and run them are installed."""
    if peer("fmpy") is None:
        return {}
    from twinmatch.fmu import adopt_fmus  # noqa: PLC0415

    built = {}
    if shutil.which("gcc"):
        built["C, model exchange"] = build_c_fmu(folder)
    if peer("pythonfmu") is not None:
        built["Python, co-simulation"] = build_python_fmu(folder, steps=4)
    return {
        name: adopt_fmus(write_map(folder, fmu, name))[0] for name, fmu in built.items()
    }


def record(samples: int) -> Window:
    """A step of the set-point, measured by a noisy camera."""
    truth = NATIVE.parameters(seebeck=0.06, conductance=0.7, heat_capacity=28.0)
    reference = np.repeat([40.0, 60.0], [30, samples - 30])
    camera = Peltier.sensor.realise(samples, 1.0, 3)
    run = simulate_closed_loop(
        truth, reference, states=begin(truth, 38.0), sensor=camera
    )
    return Window(reference, run.output, run.input, period=1.0)


if __name__ == "__main__":
    main(run, __doc__)
