"""Functions with kinks for a plant's equations; import smooth ones (exp, sqrt) from `sympy`."""

from __future__ import annotations

from typing import Any

__all__ = ["limited", "magnitude", "maximum", "minimum"]


def maximum(*values: Any) -> Any:
    """The greatest of some expressions."""
    import sympy  # noqa: PLC0415

    return sympy.Max(*values, evaluate=False)


def minimum(*values: Any) -> Any:
    """The least of some expressions."""
    import sympy  # noqa: PLC0415

    return sympy.Min(*values, evaluate=False)


def magnitude(value: Any) -> Any:
    """The absolute value of an expression."""
    import sympy  # noqa: PLC0415

    return sympy.Abs(value, evaluate=False)


def limited(value: Any, low: Any, high: Any) -> Any:
    """An expression limited to the range between two others."""
    return maximum(low, minimum(high, value))
