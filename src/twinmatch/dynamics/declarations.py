"""Declarations of a plant file: states, drive, output, disturbances, parameters, structures.

A declaration is written as a class attribute of a `Plant` and takes its name from there. Asked of the class
it is itself; asked of an instance, which is what the plant's equations do, it is its SymPy symbol. SymPy is
imported only then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, TypeVar, overload

from twinmatch.errors import TwinmatchError
from twinmatch.units import is_readable

_Self = TypeVar("_Self", bound="Declaration")

_STEP = 20.0
"""Step that excites a plant, in units of the noise."""

_MOST_TURNS = 1e9
"""Turns up to which readings that begin again are counted: a motor makes fewer in its life."""
_LARGEST_INTEGER = 2**63 - 1
_LONGEST_SHOWN = 60
"""Length to which a message shortens a value, characters."""

ROLES = ("", "losses", "room")
"""Roles that a parameter can have for the health of a plant."""


class PlantError(TwinmatchError):
    """Equations that cannot be used, impossible values, or signals on which the plant cannot be run."""


class StructureLostError(PlantError):
    """An external structure was lost: it ran before, but can never be run again."""


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """A named quantity of a plant."""

    unit: str = ""
    text: str = ""
    """Short description."""
    symbol: str = ""
    """The usual symbol; the name if empty."""
    name: str = field(default="", init=False)

    def __post_init__(self) -> None:
        for attribute in ("unit", "text", "symbol"):
            require_text(f"{attribute} of a quantity", getattr(self, attribute))
        if not is_readable(self.unit):
            raise PlantError(
                f"plant: unit of a quantity is {shown(self.unit)}, too long or with too large powers; "
                "write one such as W/(m² K)"
            )
        for declared in fields(self):
            object.__setattr__(
                self, declared.name, _in_range(getattr(self, declared.name))
            )

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", name)

    @overload
    def __get__(self: _Self, plant: None, owner: type) -> _Self: ...
    @overload
    def __get__(self, plant: object, owner: type) -> Any: ...
    def __get__(self, plant: object | None, owner: type) -> Any:
        if plant is None:
            return self
        import sympy  # noqa: PLC0415

        return sympy.Symbol(self.name, real=True)


@dataclass(frozen=True, kw_only=True)
class State(Declaration):
    """A state variable of the plant."""

    span: tuple[float, float]
    """Its range, in its unit; the fastest rate of the plant is searched there."""
    scale: float = 10.0
    """Typical uncertainty of its initial value."""
    start_bounds: tuple[float, float] | None = None
    """Bounds of the search for an unknown initial value; default: `span`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range("span of a state", self.span)
        require_number("scale of a state", self.scale, above=0.0)
        if self.start_bounds is not None:
            require_range("start_bounds of a state", self.start_bounds)


def _decimals(noise: float) -> int:
    """Decimal places of a value with this noise: down to the noise's first digit."""
    return next(k for k in range(9) if noise >= 10.0**-k or k == 8)


@dataclass(frozen=True, kw_only=True)
class Drive(Declaration):
    """The input u: what the controller commands."""

    limits: tuple[float, float]
    noise: float
    """Standard deviation of u in steady closed loop on a healthy plant; unit of the residuals of u in a
    match."""
    rest: float = 0.0
    """Command at which the drive does nothing."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range("limits of the drive", self.limits)
        require_number("noise of the drive", self.noise, above=0.0)
        require_number("rest of the drive", self.rest)
        if not self.limits[0] <= self.rest <= self.limits[1]:
            msg = f"plant: rest of the drive is {self.rest:g}; give a value within its limits {self.limits}"
            raise PlantError(msg)

    @property
    def decimals(self) -> int:
        """Decimal places with which a value is shown; of errors and residuals one more is."""
        return _decimals(self.noise)


@dataclass(frozen=True, kw_only=True)
class Output(Declaration):
    """The output y: measured by the sensor and controlled to the set-point."""

    noise: float
    """Standard deviation of a reading; unit of the residuals of y in a match."""
    span: tuple[float, float]
    """Readings that a working sensor can give."""
    set_points: tuple[float, float] | None = None
    """Range of useful set-points, within which steps are suggested; default: `span`."""
    safe: tuple[float, float] = (-math.inf, math.inf)
    """Values that are safe for the plant: a controller refuses other set-points, and no law that takes the
    output beyond them is called safe."""
    absolute: float = 0.0
    """Offset from a reading to the absolute quantity: 273.15 for °C."""
    turn: float = 0.0
    """What a reading loses where it begins again, as that of a compass after 360°; 0: it never does. Turns are
    counted on, also beyond `span`."""
    sensor: str = "sensor"
    """Name of the sensor: what to check if readings are wrong."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range("span of the output", self.span)
        require_number("noise of the output", self.noise, above=0.0)
        require_number("absolute of the output", self.absolute)
        if self.set_points is not None:
            require_range("set_points of the output", self.set_points)
        require_range("safe of the output", self.safe, finite=False)
        require_text("sensor of the output", self.sensor)
        require_number("turn of the output", self.turn)
        if self.turn < 0.0:
            raise PlantError(
                f"plant: turn of the output is {self.turn:g}; give what a reading loses where it begins again, "
                "such as 360.0"
            )

    @property
    def readable(self) -> tuple[float, float]:
        """Readings that a working sensor can give, with the turns that were counted."""
        low, high = self.span
        counted = _MOST_TURNS * self.turn
        return low - counted, high + counted

    @property
    def least_step(self) -> float:
        """Step of the set-point that excites the plant: far above the noise of a reading."""
        return _STEP * self.noise

    @property
    def decimals(self) -> int:
        """Decimal places with which a value is shown; of errors and residuals one more is."""
        return _decimals(self.noise)


@dataclass(frozen=True, kw_only=True)
class Disturbance(Declaration):
    """A measured quantity that acts on the plant but is not commanded."""

    default: float
    """Its value where it is not measured."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_number("default of a disturbance", self.default)


@dataclass(frozen=True, kw_only=True)
class Parameter(Declaration):
    """A physical parameter, which differs between plants of one kind.

    Raises:
        PlantError: default, bounds and limits contradict each other.
    """

    default: float
    bounds: tuple[float, float]
    """Bounds of the search in a match."""
    scale: float = 0.0
    """Typical size (of a difference where zero is arbitrary); default: |default|."""
    least: float = -math.inf
    """Smallest possible value."""
    positive: bool = False
    """Whether it must be above zero."""
    most: float = math.inf
    role: str = ""
    """Meaning of a change: "losses" (how easily the plant loses heat or the like), "room" (to what it loses
    it); empty: no named meaning."""
    relative: bool = True
    """Whether its error is judged relative to its value; False where its zero is arbitrary, as it is where
    the bounds reach below zero."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_number("default of a parameter", self.default)
        require_range("bounds of a parameter", self.bounds)
        require_range(
            "least and most of a parameter", (self.least, self.most), finite=False
        )
        require_number("scale of a parameter", self.scale)
        if not self.scale > 0:
            object.__setattr__(self, "scale", abs(self.default) or 1.0)
        low, high = self.bounds
        object.__setattr__(self, "relative", self.relative and low >= 0.0)
        if not low < high or not self.possible(low) or not self.possible(high):
            raise PlantError(
                f"plant: bounds {self.bounds} of a parameter ({self.text}); give possible values, lower first"
            )
        if not self.possible(self.default):
            msg = f"plant: default of a parameter is {self.default:g}; it must be {self.requirement}"
            raise PlantError(msg)
        if self.role not in ROLES:
            raise PlantError(
                f"plant: role {self.role!r} of a parameter ({self.text}) must be one of {ROLES}"
            )

    def possible(self, value: float) -> bool:
        """Whether the parameter can have this value."""
        return (
            math.isfinite(value)
            and self.least <= value <= self.most
            and (value > 0 or not self.positive)
        )

    @property
    def requirement(self) -> str:
        """The conditions on a value, as text."""
        words = ["finite"]
        if self.positive:
            words.append("positive")
        elif self.least > -math.inf:
            words.append(f"at least {self.least:g}")
        if self.most < math.inf:
            words.append(f"at most {self.most:g}")
        return " and ".join(words)


class ExternalEquations(Protocol):
    """Source of a structure whose equations are external, possibly in another language.

    Output, drive and disturbances are those of the plant's file. States and parameters may be the plant's,
    too, or be declared here.
    """

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Parameters that only this structure has, by name."""

    @property
    def states(self) -> Mapping[str, State]:
        """States that only this structure has, by name."""

    def kernels_by(self, unknown: Iterable[str]) -> Any:
        """As `twinmatch.dynamics.store.Kernels`, with tangents for these parameters.

        They raise `StructureLostError` once the external equations are gone.
        """

    @property
    def lost(self) -> str:
        """Why it can no longer be run, in a sentence; empty while it can."""


@dataclass(frozen=True)
class Structure:
    """Which parts of a plant are modelled, and which parameters are unknown."""

    free: tuple[str, ...]
    """Parameters that a match fits."""
    parts: frozenset[str] = frozenset()
    """Those of the plant's `parts` that are modelled."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Values of other parameters, or start values of the search, if not the defaults."""
    free_starts: tuple[str, ...] = ()
    """States whose value at a window's start is unknown, too."""
    starts: tuple[Mapping[str, float], ...] = ()
    """Further start points of the search, as changes of the first."""
    watched: bool = True
    """Whether it is fitted beside the running plant from the start; otherwise only if a match was made in it,
    or when all structures are requested."""
    text: str = ""
    external: ExternalEquations | None = None
    """Source of its equations, if they are not in the plant's file."""

    def __post_init__(self) -> None:
        for name in ("free", "parts", "free_starts"):
            names = getattr(self, name)
            if isinstance(names, str):
                raise PlantError(
                    f"plant: {name} of a structure is the text {names!r}; write ({names!r},)"
                )

    def __hash__(self) -> int:
        return hash(
            (self.free, self.parts, tuple(self.fixed.items()), self.free_starts)
        )

    def n_parameters(self, windows: int = 1) -> int:
        """Number of values that a fit to so many windows estimates."""
        return len(self.free) + windows * len(self.free_starts)


def shown(value: Any) -> str:
    """A value of a plant's file as a message quotes it: in at most 60 characters."""
    try:
        text = repr(value)
    except Exception:
        # Python writes no integer of more than 4300 digits; a class may write itself wrongly
        return f"of type {type(value).__name__}, too long to be shown"
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 1]}…"


def is_number(value: Any) -> bool:
    """Whether a value is a number within the range of floating point, which the integer 10**400 is not."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def _in_range(value: Any) -> Any:
    """A value, with integers that an array of integers cannot hold, such as 10**30, as floating point."""
    if isinstance(value, tuple):
        return tuple(map(_in_range, value))
    if isinstance(value, int) and abs(value) > _LARGEST_INTEGER and is_number(value):
        return float(value)
    return value


def require_number(what: str, value: Any, *, above: float = -math.inf) -> None:
    """Check that a value is a finite number above `above`.

    Raises:
        PlantError: it is none.
    """
    if not is_number(value) or not above < value < math.inf:
        least = f" above {above:g}" if above > -math.inf else ""
        raise PlantError(
            f"plant: {what} is {shown(value)}; give a finite number{least}"
        )


def require_range(what: str, ends: Any, *, finite: bool = True) -> None:
    """Check that a value is a pair of numbers, the smaller one first; without `finite`, ±inf are allowed.

    Raises:
        PlantError: it is none.
    """
    if isinstance(ends, tuple | list) and len(ends) == 2 and all(map(is_number, ends)):
        low, high = ends
        if low < high and (not finite or (math.isfinite(low) and math.isfinite(high))):
            return
    kind = "two finite numbers" if finite else "two numbers"
    raise PlantError(
        f"plant: {what} is {shown(ends)}; give {kind}, the smaller first, such as (0.0, 100.0)"
    )


def require_text(what: str, value: Any) -> None:
    """Check that a value is one line of text.

    Raises:
        PlantError: it is none.
    """
    if not isinstance(value, str) or "\n" in value:
        raise PlantError(
            f"plant: {what} is {shown(value)}; give a short text in quotes"
        )
