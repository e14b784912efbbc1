"""The formulas against the paper's last table, numbers nobody here wrote."""

from __future__ import annotations

import math
from typing import NamedTuple

import pytest

from twinmatch.comparing import InformationGain, bic, mdl


class Row(NamedTuple):
    set_point: int
    order: int
    lengths: tuple[int, int, int, int, int, int, int]  # l(t), l(BJ), gain of y; the same of u; total gain
    naic: tuple[float, float]
    bic: tuple[float, float]
    mdl: float


SAMPLES = {50: 342, 70: 491, 90: 461}
"""Samples behind each complete set-point: what nAIC and BIC agree on. At 30 °C nAIC is missing."""

ROWS = (
    Row(30, 2, (1242, 681, 561, 1019, 1014, 5, 566), (0, 0), (310.24, 330.39), 0.27),
    Row(30, 3, (1242, 741, 501, 1019, 1055, -36, 465), (0, 0), (472.21, 383.82), 0.34),
    Row(30, 4, (1242, 637, 605, 1019, 998, 21, 626), (0, 0), (819.77, 464.58), 0.49),
    Row(30, 5, (1242, 1219, 23, 1019, 1078, -59, -36), (0, 0), (429.28, 467.93), 0.48),
    Row(50, 2, (2048, 979, 1069, 1622, 1493, 129, 1198), (0.78, 0.80), (1283.65, 1290.03), 2.52),
    Row(50, 3, (2048, 1082, 966, 1622, 1506, 116, 1082), (0.84, 0.84), (1327.87, 1325.32), 2.75),
    Row(50, 4, (2048, 1067, 981, 1622, 1549, 73, 1054), (0.86, 0.84), (1358.30, 1349.62), 2.88),
    Row(50, 5, (2048, 1836, 212, 1622, 1653, -31, 181), (0.93, 0.93), (1404.68, 1404.46), 3.33),
    Row(70, 2, (2898, 1286, 1612, 2890, 2042, 848, 2460), (1.82, 2.24), (2337.72, 2543.94), 10.40),
    Row(70, 3, (2898, 1258, 1640, 2890, 1712, 1178, 2818), (1.91, 2.26), (2406.90, 2579.63), 11.13),
    Row(70, 4, (2898, 1429, 1469, 2890, 2107, 783, 2252), (1.94, 2.17), (2446.20, 2561.95), 10.61),
    Row(70, 5, (2898, 2591, 307, 2890, 2013, 877, 1184), (1.97, 2.29), (2485.83, 2642.01), 15.18),
    Row(90, 2, (2721, 1219, 1502, 2712, 1930, 782, 2284), (1.88, 2.30), (2226.30, 2417.66), 11.06),
    Row(90, 3, (2721, 1519, 1202, 2712, 1904, 808, 2010), (2.28, 2.29), (2434.50, 2437.36), 11.43),
    Row(90, 4, (2721, 1386, 1335, 2712, 2014, 698, 2033), (1.90, 2.28), (2284.10, 2457.17), 11.78),
    Row(90, 5, (2721, 1170, 1551, 2712, 2143, 569, 2120), (4.17, 1.91), (3354.17, 2312.17), 12.38),
)

COMPLETE = tuple(row for row in ROWS if row.set_point in SAMPLES)


@pytest.mark.parametrize("row", ROWS)
def test_published_gains_are_differences_of_published_lengths(row: Row) -> None:
    trivial_y, model_y, gain_y, trivial_u, model_u, gain_u, total = row.lengths
    y, u = InformationGain(trivial_y, model_y), InformationGain(trivial_u, model_u)
    assert (y.gain, u.gain, y.gain + u.gain) == (gain_y, gain_u, total)
    assert y.explanation == pytest.approx(gain_y / trivial_y)


def loss_behind(cell: float, row: Row) -> float:
    return math.exp(cell - 2 * 6 * row.order / SAMPLES[row.set_point])


@pytest.mark.parametrize("row", COMPLETE)
@pytest.mark.parametrize("output", [0, 1])
def test_bic_column_follows_from_the_naic_column(row: Row, output: int) -> None:
    """All 24 cells. A published nAIC is known to half its last digit: N times that, in BIC."""
    samples = SAMPLES[row.set_point]
    found = bic(loss_behind(row.naic[output], row), 6 * row.order, samples)
    assert found == pytest.approx(row.bic[output], abs=0.005 * samples + 0.005)


@pytest.mark.parametrize("row", [row for row in COMPLETE if row.order < 5])
def test_mdl_column_follows_from_the_naic_of_the_control_signal(row: Row) -> None:
    """Orders 2 to 4: 2 % low at most, half a percent of it rounding. As printed it is 4 to 6 times off.

    The three cells of order 5 (3.33, 15.18, 12.38) are 3, 26 and 49 % above the formula: no loss of
    that order's own nAIC gives them.
    """
    samples = SAMPLES[row.set_point]
    v = loss_behind(row.naic[1], row)
    found = mdl(v, 6 * row.order, samples)
    assert 0.97 * row.mdl < found < 1.006 * row.mdl
    printed = v * (1 + 6 * row.order / samples) * math.log(samples)
    assert 4 < printed / row.mdl < 10
