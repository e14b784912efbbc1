"""What a plant file declares: states, the drive, the output, disturbances, parameters, structures.

A declaration is written as a class attribute of a `Plant` and takes its name from there. Asked of the class
it is itself; asked of an instance, which is what the plant's equations do, it is its SymPy symbol. SymPy is
imported only then.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar, overload

from twinmatch.dynamics.errors import PlantError
from twinmatch.dynamics.numbers import require_number, require_range

if TYPE_CHECKING:
    from twinmatch.dynamics.elsewhere import Elsewhere

__all__ = ["Declaration", "Disturbance", "Drive", "Output", "Parameter", "State", "Structure"]

_Self = TypeVar("_Self", bound="Declaration")

_STEP = 20.0
"""Movement that excites a plant, in units of the noise."""

ROLES = ("", "losses", "room")
"""What a parameter can mean to the health of a plant."""


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """A named quantity of a plant."""

    unit: str = ""
    text: str = ""
    """What it is, in a few words."""
    symbol: str = ""
    """How the field writes it; the name if empty."""
    name: str = field(default="", init=False)

    def __set_name__(self, owner: type, name: str) -> None:
        object.__setattr__(self, "name", name)

    @overload
    def __get__(self: _Self, plant: None, owner: type) -> _Self: ...
    @overload
    def __get__(self, plant: object, owner: type) -> Any: ...
    def __get__(self, plant: object | None, owner: type) -> Any:
        if plant is None:
            return self
        import sympy  # noqa: PLC0415 (only those who derive equations pay for it)

        return sympy.Symbol(self.name, real=True)


@dataclass(frozen=True, kw_only=True)
class State(Declaration):
    """A quantity that the plant carries from sample to sample."""

    span: tuple[float, float]
    """Where it lives, in its unit; the fastest rate of the plant is looked for there."""
    scale: float = 10.0
    """A typical difference of its start."""
    start_bounds: tuple[float, float] | None = None
    """Where an unknown start is looked for; `span` if not given."""

    def __post_init__(self) -> None:
        require_range("span of a state", self.span)
        require_number("scale of a state", self.scale, above=0.0)


def _decimals(noise: float) -> int:
    """Of a reading with this noise: down to the noise's first digit."""
    return next(k for k in range(9) if noise >= 10.0**-k or k == 8)


@dataclass(frozen=True, kw_only=True)
class Drive(Declaration):
    """The input u: what the controller commands."""

    limits: tuple[float, float]
    noise: float
    """Standard deviation of u in steady closed loop on a healthy plant; weighs what is left of u in a
    match."""
    rest: float = 0.0
    """Command at which the drive does nothing."""

    def __post_init__(self) -> None:
        require_range("limits of the drive", self.limits)
        require_number("noise of the drive", self.noise, above=0.0)

    @property
    def least_step(self) -> float:
        """Movement that excites the plant: far above the noise, yet no more than a quarter of what the drive
        can do, so that switching it on counts however noisy it is said to be."""
        low, high = self.limits
        return min(_STEP * self.noise, (high - low) / 4)

    @property
    def decimals(self) -> int:
        """Decimal places with which a value is shown; of errors and residuals one more is."""
        return _decimals(self.noise)


@dataclass(frozen=True, kw_only=True)
class Output(Declaration):
    """The output y: what the sensor says and the controller holds at the set-point."""

    noise: float
    """Standard deviation of a reading; weighs what is left of y in a match."""
    span: tuple[float, float]
    """Readings that a working sensor can give."""
    set_points: tuple[float, float] | None = None
    """Where set-points make sense, which is where a suggested step may lead; `span` if not given."""
    safe: tuple[float, float] = (-math.inf, math.inf)
    """Set-points that do the plant no harm; a controller takes no others."""
    absolute: float = 0.0
    """What to add to a reading to count it from where its quantity is zero: 273.15 for °C."""
    sensor: str = "sensor"
    """What gives the readings, in a word: where to look if they are wrong."""

    def __post_init__(self) -> None:
        require_range("span of the output", self.span)
        require_number("noise of the output", self.noise, above=0.0)

    @property
    def least_step(self) -> float:
        """Movement of the set-point that excites the plant: far above the noise of a reading."""
        return _STEP * self.noise

    @property
    def decimals(self) -> int:
        """Decimal places with which a value is shown; of errors and residuals one more is."""
        return _decimals(self.noise)


@dataclass(frozen=True, kw_only=True)
class Disturbance(Declaration):
    """A measured quantity that acts on the plant without being commanded."""

    default: float
    """Its value where nobody measures it."""

    def __post_init__(self) -> None:
        require_number("default of a disturbance", self.default)


@dataclass(frozen=True, kw_only=True)
class Parameter(Declaration):
    """A number that tells one plant from another of its kind.

    Raises:
        PlantError: default, bounds and limits contradict one another.
    """

    default: float
    bounds: tuple[float, float]
    """Where a match looks for it."""
    scale: float = 0.0
    """A typical size (of a difference where zero means nothing); |default| if not given."""
    least: float = -math.inf
    """Smallest value it can have at all."""
    positive: bool = False
    """Whether it has to be above zero."""
    most: float = math.inf
    role: str = ""
    """What it means if it changes: "losses" (how the plant gives away heat or the like), "room" (to what);
    empty: nothing that has a name."""
    relative: bool = True
    """Whether its error is judged relative to its value; False where its zero means nothing."""

    def __post_init__(self) -> None:
        require_number("default of a parameter", self.default)
        require_range("bounds of a parameter", self.bounds)
        if not self.scale > 0:
            object.__setattr__(self, "scale", abs(self.default) or 1.0)
        low, high = self.bounds
        if not low < high or not self.possible(low) or not self.possible(high):
            msg = f"plant: bounds {self.bounds} of a parameter ({self.text}) must grow and be possible values"
            raise PlantError(msg)
        if self.role not in ROLES:
            msg = f"plant: role {self.role!r} of a parameter ({self.text}) must be one of {ROLES}"
            raise PlantError(msg)

    def possible(self, value: float) -> bool:
        """Whether the parameter can have this value."""
        return math.isfinite(value) and self.least <= value <= self.most and (value > 0 or not self.positive)

    @property
    def requirement(self) -> str:
        """What a value has to be, in words."""
        words = ["finite"]
        if self.positive:
            words.append("positive")
        elif self.least > -math.inf:
            words.append(f"at least {self.least:g}")
        if self.most < math.inf:
            words.append(f"at most {self.most:g}")
        return " and ".join(words)


@dataclass(frozen=True)
class Structure:
    """Which parts a plant is taken to have, and what of it is unknown."""

    free: tuple[str, ...]
    """Parameters that a match looks for."""
    parts: frozenset[str] = frozenset()
    """Of the plant's `parts`, those that are there."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Values of other parameters, or where the search begins, if not the defaults."""
    free_starts: tuple[str, ...] = ()
    """States whose value at a window's begin is unknown too."""
    starts: tuple[Mapping[str, float], ...] = ()
    """More points to begin a search at, as changes of the first."""
    watched: bool = True
    """Whether it is tried beside the running plant; the others only where somebody asks for all."""
    text: str = ""
    elsewhere: Elsewhere | None = None
    """Where its equations are, if not in the plant's file."""

    def __post_init__(self) -> None:
        for name in ("free", "parts", "free_starts"):
            held = getattr(self, name)
            if isinstance(held, str):
                msg = f"plant: {name} of a structure is the text {held!r}; write ({held!r},)"
                raise PlantError(msg)

    def __hash__(self) -> int:
        return hash((self.free, self.parts, tuple(self.fixed.items()), self.free_starts))

    def n_parameters(self, windows: int = 1) -> int:
        """How many numbers a fit to so many windows is free to choose."""
        return len(self.free) + windows * len(self.free_starts)
