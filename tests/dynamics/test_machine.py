"""The compiled functions of a plant, against SymPy's own evaluation of the same expressions."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from twinmatch.dynamics.code import plant_formulas
from twinmatch.dynamics.equations import FUNCTIONS, Derived
from twinmatch.dynamics.machine import compiled_object, linked

X = sympy.symbols("level flow", real=True)
U = sympy.symbols("valve pump", real=True)
P = sympy.symbols("area height", real=True)
NUMBERS = (0.3, -0.7, 1.2, 0.4, 2.5, 0.6)
"""Values of X, U and P at which all functions are defined."""
BEYOND = 64
"""Numbers behind the results, where no function may write."""


def derived(rates: tuple[Any, Any], outputs: tuple[Any, ...] = X) -> Derived:
    """Equations of two states, two inputs and two parameters."""
    return Derived(
        X,
        U,
        (),
        P,
        P,
        sympy.symbols("seen also", real=True),
        (),
        (),
        rates,
        outputs,
        X,
        {},
    )


def evaluated(equations: Derived, sizes: dict[str, int]) -> dict[str, np.ndarray]:
    """The results of some compiled functions at NUMBERS, by name."""
    owner, addresses = linked(compiled_object(plant_formulas(equations)))
    x = np.array(NUMBERS[:2])
    u = np.array(NUMBERS[2:4])
    p = np.zeros(64)
    p[:2] = NUMBERS[4:]
    b = np.zeros(1)

    def call(function: str, target: np.ndarray) -> np.ndarray:
        function_type = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 6)(
            addresses[function]
        )
        function_type(*(array.ctypes.data for array in (x, u, b, p, b, target)))
        return target

    call("constants", p[2:])
    results = {
        name: call(name, np.full(size + BEYOND, np.nan)) for name, size in sizes.items()
    }
    del owner
    assert all(np.isnan(results[name][size:]).all() for name, size in sizes.items()), (
        "more than it should"
    )
    return {name: results[name][:size] for name, size in sizes.items()}


def expected(expressions: list[Any]) -> np.ndarray:
    """The same by SymPy, to 30 digits."""
    values = dict(zip((*X, *U, *P), map(sympy.Float, NUMBERS), strict=True))
    return np.array(
        [float(sympy.N(sympy.sympify(e).subs(values), 30)) for e in expressions]
    )


def assert_all_agree(equations: Derived) -> None:
    """Rates with all derivatives, and outputs with theirs."""
    rates = equations.rates
    outputs = list(equations.outputs)

    def derivatives_by(symbols: Iterable[sympy.Symbol]) -> list[Any]:
        return [e.diff(s) for e in rates for s in symbols]

    right = {
        "slopes": [*derivatives_by(P), *rates, *derivatives_by(X), *derivatives_by(U)],
        "outputs": outputs,
        "output_slopes": [
            e.diff(s) for symbols in (X, P, U) for e in outputs for s in symbols
        ],
    }
    results = evaluated(
        equations, {name: len(expressions) for name, expressions in right.items()}
    )
    for name, expressions in right.items():
        np.testing.assert_allclose(
            results[name], expected(expressions), rtol=1e-12, atol=1e-13
        )


@pytest.mark.parametrize(
    "name", sorted(set(FUNCTIONS) - {"Abs", "Max", "Min", "Piecewise"})
)
def test_every_function_that_equations_may_use_is_compiled(name: str) -> None:
    """Kinks are resolved into switches before; the four that have one are tested with those."""
    function: Callable[..., Any] = getattr(sympy, name)
    arguments = (X[0] * P[1], U[0]) if name == "atan2" else (X[0] * P[1],)
    offset = 2 if name in {"acosh", "log"} else 0
    inside = function(arguments[0] + offset, *arguments[1:])
    assert_all_agree(derived((inside * P[0], U[1] - X[1] * inside), (inside, X[1])))


def trees(leaves: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Sums, products, quotients and powers of expressions."""
    pairs = st.tuples(leaves, leaves)
    return st.one_of(
        pairs.map(lambda two: two[0] + two[1]),
        pairs.map(lambda two: two[0] * two[1]),
        pairs.map(lambda two: two[0] / (2 + two[1] ** 2)),
        st.tuples(leaves, st.sampled_from([2, 3, 5])).map(
            lambda two: two[0] ** two[1] / 7
        ),
        leaves.map(lambda one: sympy.sqrt(1 + one**2)),
        leaves.map(lambda one: (1 + one**2) ** sympy.Rational(-3, 2)),
        leaves.map(lambda one: sympy.exp(-(one**2))),
    )


EXPRESSIONS = st.recursive(
    st.one_of(
        st.sampled_from([*X, *U, *P]),
        st.sampled_from([1, sympy.Rational(1, 3), -2.5, sympy.pi]),
    ),
    trees,
    max_leaves=6,
)


@settings(max_examples=12)
@given(first=EXPRESSIONS, second=EXPRESSIONS)
def test_any_arithmetic_is_compiled(first: Any, second: Any) -> None:
    first_term = sympy.sympify(first)
    second_term = sympy.sympify(second)
    assert_all_agree(derived((first_term, second_term), (second_term, first_term)))
