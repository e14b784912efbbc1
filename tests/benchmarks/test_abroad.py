"""The simulated plants are what they say, and the benchmark that watches them runs."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from tests.support.abroad import KINDS, AbroadPlant, Mishap
from tests.support.places import PROJECT
from twinmatch.dynamics import begin, simulate_driven
from twinmatch.signals import KELVIN, Sample

OWN = ("rig", "kit", "incubator", "motor", "tanks")
"""Kinds with equations of their own."""
LONG = {"rig": 3000, "kit": 3000, "incubator": 30_000, "motor": 10, "tanks": 2000}
"""Seconds after which each kind is at rest."""


def rig_out_of_balance(
    p: Mapping[str, float], x: tuple[float, ...], u: float, room: float
) -> float:
    plate, sink = x
    current = (-p["supply"] * u / 255 - p["seebeck"] * (sink - plate)) / 3.4
    electric = 3.3 * current**2 + p["seebeck"] * (sink - plate) * current
    return electric - p["convection"] * (sink - KELVIN - room)


def kit_out_of_balance(
    p: Mapping[str, float], x: tuple[float, ...], u: float, room: float
) -> float:
    warm = x[0]
    cold = room + KELVIN
    radiated = 0.9 * 5.670374e-8 * 10e-4 * (warm**4 - cold**4)
    return p["heating"] * u - p["losses"] * 10e-4 * (warm - cold) - radiated


def incubator_out_of_balance(
    p: Mapping[str, float], x: tuple[float, ...], u: float, room: float
) -> float:
    resistance = 1 / p["wall_conductance"] + 1 / p["box_conductance"]
    return p["power"] * u - (x[3] - room) / resistance


def motor_out_of_balance(
    p: Mapping[str, float], x: tuple[float, ...], u: float, _: float
) -> float:
    torque = p["k"] * (u - p["k"] * x[0]) / p["resistance"]
    return 100 * (torque - p["dry"] - p["viscous"] * x[0])


def tanks_out_of_balance(
    p: Mapping[str, float], x: tuple[float, ...], u: float, _: float
) -> float:
    return 10 * (x[1] - (p["pump"] * u / p["lower_hole"]) ** 2)


CASES: dict[str, tuple[float, Callable[..., float]]] = {
    "rig": (80.0, rig_out_of_balance),
    "kit": (40.0, kit_out_of_balance),
    "incubator": (0.2, incubator_out_of_balance),
    "motor": (6.0, motor_out_of_balance),
    "tanks": (4.0, tanks_out_of_balance),
}
"""Input, and what enters less what leaves at rest, in about the share of a percent."""


@pytest.mark.parametrize("name", OWN)
def test_at_rest_as_much_enters_a_plant_as_leaves_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    u, out_of_balance = CASES[name]
    kind = KINDS[name]
    plant = AbroadPlant(kind, 3, (), closed=False)
    monkeypatch.setattr(plant, "level", lambda _: u)
    # hours pass before a real one is at rest
    monkeypatch.setitem(plant.parameters, "box_capacity", 500.0)
    samples = list(plant.run(round(LONG[name] / kind.period)))
    assert abs(out_of_balance(plant.parameters, plant.states, u, plant.room)) < 0.01
    assert abs(samples[-1].output - plant.output) < 6 * kind.noise + kind.resolution
    assert abs(plant.output - samples[0].output) > 10 * kind.kelvin


@pytest.mark.parametrize("name", KINDS)
def test_a_controller_holds_a_plant_at_its_level(name: str) -> None:
    kind = KINDS[name]
    plant = AbroadPlant(kind, 5, (), closed=True)
    samples = list(plant.run(round(1800 * kind.second / kind.period)))
    outputs = np.array([s.output for s in samples[len(samples) // 3 :]])
    assert (
        kind.levels[0] - 4 * kind.kelvin
        < np.median(outputs)
        < kind.levels[1] + 4 * kind.kelvin
    )
    if kind.gains is not None:
        references = np.array([s.reference for s in samples[len(samples) // 3 :]])
        assert np.median(np.abs(outputs - references)) < 2 * kind.kelvin


STRUCTURES = {
    "rig": "sink with mass",
    "kit": "sensor lag, radiation",
    "incubator": "box with mass, sensor lag",
    "motor": "without friction",
    "tanks": "two tanks",
}
RENAMED = {
    "convection": "sink_convection",
    "sink_capacity": "sink_heat_capacity",
    "capacity": "heat_capacity",
    "air_capacity": "air_heat_capacity",
    "bed_capacity": "bed_heat_capacity",
    "box_capacity": "box_heat_capacity",
    "lag": "sensor_lag",
    "resistance": "r",
    "inertia": "j",
    "viscous": "b",
}
"""Names of parameters in the plants' files, where they differ."""


@pytest.mark.parametrize("name", OWN)
def test_a_plant_that_has_nothing_special_is_what_its_file_says(name: str) -> None:
    kind = KINDS[name]
    plant = AbroadPlant(kind, 7, (), closed=False)
    plant.parameters |= {"dry": 0.0} if name == "motor" else {}
    truth = list[float]()
    samples = list[Sample]()
    for sample in plant.run(600):
        truth.append(plant.output)
        samples.append(sample)
    model = kind.plant.model(STRUCTURES[name])
    true_parameters = {RENAMED.get(n, n): v for n, v in plant.parameters.items()}
    true_parameters = {n: v for n, v in true_parameters.items() if n in model.declared}
    if "ambient" in model.declared:
        true_parameters["ambient"] = plant.room + KELVIN
    twin = model.parameters(**true_parameters)
    rows = np.full((600, 1), plant.room) if name == "incubator" else None
    inputs = np.array([sample.input for sample in samples])
    run = simulate_driven(
        twin,
        inputs,
        states=begin(twin, truth[0]),
        period=kind.period,
        disturbances=rows,
    )
    # The file's tanks bend the square root near zero, which the true ones do not.
    allowed = 1.0 if name == "tanks" else 0.05
    assert np.max(np.abs(run.output - truth)) < allowed * kind.kelvin


def test_the_loop_reacts_to_what_a_faulty_sensor_shows() -> None:
    kind = KINDS["kit"]
    whole = AbroadPlant(kind, 4, (), closed=True)
    lied = AbroadPlant(kind, 4, (), closed=True, mishap=Mishap("reading+5", 600, 900))
    list(whole.run(900))
    lied_samples = list(lied.run(900))
    assert whole.output - lied.output == pytest.approx(5.0, abs=0.7)
    assert abs(lied_samples[-1].output - whole.output) < 0.7


def test_the_benchmark_prints_a_row_for_a_kind(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(PROJECT))
    from benchmarks import abroad

    monkeypatch.setattr(
        sys, "argv", ["abroad", "healthy", "1", "0.1", "--kind", "kit", "--monitor"]
    )
    abroad.main()
    assert re.search(r"^kit +0\.1 ", capsys.readouterr().out, re.MULTILINE)
    assert abroad.right_name("drive*0.62") == "drive-weak"
    assert abroad.right_name("drive*0 twice") == "drive-lost"
    assert abroad.right_name("reading late") == "sensor-late"


def test_the_benchmark_prints_a_row_for_each_fault(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(PROJECT))
    from benchmarks import abroad

    case = [
        "faults",
        "1",
        "--kind",
        "incubator",
        "--only",
        "frozen",
        "--only",
        "spike",
        "--monitor",
    ]
    monkeypatch.setattr(sys, "argv", ["abroad", *case])
    abroad.main()
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[:2] for row in rows[-2:]] == [["frozen", "1"], ["spike", "1"]]
