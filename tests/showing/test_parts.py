"""The small parts that tables and figures are made of."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.plants import Motor
from tests.support.rig import GAINS, rig, run
from twinmatch.comparing import CandidateScore, Criteria, OrderScore
from twinmatch.dynamics import Plant
from twinmatch.plants import PLANTS, Peltier
from twinmatch.showing.family import criterion_rows
from twinmatch.showing.quantities import in_order, number, parameter_format
from twinmatch.showing.series import compare, rolling_rms
from twinmatch.showing.style import CLOSED, DRIVEN, LEVELS, ORDERS, PLANT, SET_POINT, TEXT
from twinmatch.signals import KELVIN, Sample


@pytest.mark.parametrize("plant", PLANTS.values(), ids=str)
def test_every_parameter_has_a_symbol_a_unit_and_words(plant: type[Plant]) -> None:
    for name in plant.parameters:
        shown = parameter_format(plant, name)
        assert shown.name == name
        assert shown.symbol != name, f"{name} has no symbol"
        assert shown.unit
        assert shown.words


def test_parameters_are_shown_in_units_that_read_well() -> None:
    alpha, slope, room = (parameter_format(Peltier, name) for name in ("seebeck", "seebeck_slope", "ambient"))
    assert (alpha.text(0.06), alpha.label) == ("60.0", "α / (mV/K)")
    assert (slope.text(1.2e-4), slope.unit) == ("120", "µV/K²")
    assert (room.text(KELVIN + 22.5), room.unit, room.error_text(0.5)) == ("22.5", "°C", "0.50")
    assert parameter_format(Peltier, "conductance").text(0.7) == "0.700"
    sink = parameter_format(Peltier, "sink")
    assert (sink.symbol, sink.text(KELVIN + 30.0)) == ("T_B(0)", "30.0")
    assert parameter_format(Peltier, "new_thing").text(1.0) == "1.0000"


def test_another_plant_is_shown_as_it_declares_itself() -> None:
    inertia, friction = parameter_format(Motor, "j"), parameter_format(Motor, "b")
    assert (inertia.text(4e-4), inertia.unit) == ("0.000400", "kg m²"), "kilograms take no prefix"
    assert (friction.symbol, friction.words) == ("b", "viscous friction")
    assert parameter_format(Motor, "omega").unit == "rad/s"


def test_names_come_in_the_plants_order() -> None:
    names = ("sink", "heat_capacity", "unheard", "seebeck")
    assert in_order(Peltier, names) == ("seebeck", "heat_capacity", "sink", "unheard")


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.005, "1.00"), (-2.5, "−2.50"), (-0.001, "0.00"), (math.nan, "–"), (None, "–"), (math.inf, "∞")],
)
def test_numbers_read_well(value: float | None, text: str) -> None:
    assert number(value) == text


def criteria(gain: int, loss: float) -> Criteria:
    return Criteria(1000, 1000 - gain, gain, gain / 1000, math.log(loss), 100 * math.log(loss), loss)


def test_the_best_is_the_largest_gain_and_the_smallest_of_the_others() -> None:
    scores = [("22221", 500, 1.0), ("33331", 600, 2.0), ("44441", 600, 0.5)]
    orders = tuple(
        OrderScore(name, criteria(gain, loss), criteria(gain, loss), criteria(gain, loss))
        for name, gain, loss in scores
    )
    candidate = CandidateScore("c", 50.0, rig(), 0, 99, orders, "33331", 0.0, None, None)
    rows = criterion_rows(candidate)
    assert [(r.output, r.order) for r in rows[:3]] == [("y", "22221"), ("y", "33331"), ("y", "44441")]
    assert [r.chosen for r in rows[:3]] == [False, True, False]
    best = {k: [row.cells[k].best for row in rows[:3]] for k in range(7)}
    assert best[0] == best[1] == [False] * 3
    assert best[2] == best[3] == [False, True, True]
    assert best[4] == best[5] == best[6] == [False, False, True]


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.integers(1, 12))
def test_the_rolling_rms_is_that_of_the_newest_values(values: list[float], count: int) -> None:
    table = np.array(values)
    expected = [math.sqrt(np.mean(table[max(0, k + 1 - count) : k + 1] ** 2)) for k in range(table.size)]
    np.testing.assert_allclose(rolling_rms(table, count), expected, rtol=1e-6, atol=1e-4)


def test_the_right_twin_leaves_nothing_and_gaps_are_stepped_over() -> None:
    plant = rig(seebeck=0.06, conductance=0.5, heat_capacity=27.0)
    reference = np.repeat([30.0, 60.0], 150)
    window = run(plant, reference)
    table = enumerate(zip(reference, window.output, window.input, strict=True))
    samples = [Sample(k, k * 10**9, float(r), float(y), float(u)) for k, (r, y, u) in table]
    parts = compare(samples[:100] + samples[101:103] + samples[110:], plant, GAINS)
    assert [len(p.window) for p in parts] == [100, 190]
    for part in parts:
        np.testing.assert_allclose(part.closed_residual_y, 0, atol=1e-6)
        np.testing.assert_allclose(part.closed_residual_u, 0, atol=1e-3)
        np.testing.assert_allclose(part.driven_residual_y, 0, atol=1e-6)


# Machado et al. (2009), severity 1: how linear RGB looks to somebody without one kind of cone
DEFICIENCIES = {
    "protan": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deutan": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritan": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def linear(colour: str) -> np.ndarray:
    value = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ rgb
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > (6 / 29) ** 3, np.cbrt(np.maximum(t, 0)), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("deficiency", ["none", *DEFICIENCIES])
@pytest.mark.parametrize(
    "colours",
    [(PLANT, CLOSED, DRIVEN, SET_POINT), tuple(LEVELS.values()), ORDERS],
    ids=["signals", "levels", "orders"],
)
def test_colours_that_stand_side_by_side_are_distinguished(colours: tuple[str, ...], deficiency: str) -> None:
    """A difference of 10 in CIELAB is plain to see; 2 is just noticeable."""
    change = np.array(DEFICIENCIES.get(deficiency, np.eye(3)))
    seen = [lab(np.clip(change @ linear(c), 0, 1)) for c in colours]
    for k, one in enumerate(seen):
        for other in seen[k + 1 :]:
            assert np.linalg.norm(one - other) > 10


def test_text_is_dark_on_white() -> None:
    contrast = 1.05 / (float(linear(TEXT) @ [0.2126, 0.7152, 0.0722]) + 0.05)
    assert contrast > 7
