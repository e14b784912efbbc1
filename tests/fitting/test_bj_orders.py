"""Orders in the paper's way of writing them."""

from __future__ import annotations

from itertools import pairwise

import pytest

from twinmatch.fitting import ORDERS, FittingError, Order, parse_order


@pytest.mark.parametrize("written", ["22221", "2 2 2 2 1", "2,2,2,2,1", (2, 2, 2, 2, 1), [2, 2, 2, 2, 1]])
def test_one_order_written_five_ways(written: str | tuple[int, ...]) -> None:
    assert parse_order(written) == Order(nb=2, nc=2, nd=2, nf=2, nk=1)


def test_an_order_reads_back() -> None:
    for order in (*ORDERS, "10 0 2 1 12"):
        assert str(parse_order(order)) == order


def test_the_ladder_is_nested() -> None:
    rungs = [parse_order(order) for order in ORDERS]
    for lower, higher in pairwise(rungs):
        assert higher.covers(lower)
        assert not lower.covers(higher)


def test_covering_respects_the_span_of_b() -> None:
    assert parse_order("31110").covers(parse_order("21111"))
    assert not parse_order("21110").covers(parse_order("21111"))


@pytest.mark.parametrize("order", ["2222", "222211", "two", (2, 2, 2, 2), (1.5, 2, 2, 2, 1)])
def test_what_is_not_an_order(order: str) -> None:
    with pytest.raises(FittingError, match="five whole numbers"):
        parse_order(order)


def test_b_needs_a_coefficient() -> None:
    with pytest.raises(FittingError, match="nb must be at least 1"):
        parse_order("02221")


@pytest.mark.parametrize("order", [(2, -1, 2, 2, 1), (2, 2, 2, 2, 51)])
def test_orders_out_of_range(order: tuple[int, ...]) -> None:
    with pytest.raises(FittingError, match="outside 0 to 50"):
        parse_order(order)
