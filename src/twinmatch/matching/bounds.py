"""Which parameters may vary, and where each is looked for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

from twinmatch.errors import TwinmatchError
from twinmatch.plant import PARAMETER_NAMES, RigParameters

__all__ = [
    "AUTHORS_BOUNDS",
    "BOUNDS",
    "SCALES",
    "SINK_START",
    "WITHOUT_ZERO",
    "Bounds",
    "MatchingError",
    "checked_bounds",
    "checked_free",
]


class MatchingError(TwinmatchError):
    """A match was asked for that cannot be made: unknown names, bounds or noise without meaning."""


Bounds = Mapping[str, tuple[float, float]]

SINK_START: Final = "sink_start"
"""Name of the sink's unknown temperature at the window's third sample, K."""

BOUNDS: Final[Bounds] = MappingProxyType(
    {
        "seebeck": (0.01, 0.2),
        "resistance": (0.5, 10.0),
        "conductance": (0.0, 2.0),
        "heat_capacity": (5.0, 150.0),
        "ambient": (263.0, 323.0),
        "sink_heat_capacity": (20.0, 5000.0),
        "sink_convection": (0.1, 100.0),
        "sensor_lag": (0.0, 20.0),
        "seebeck_slope": (-5e-4, 5e-4),
        "drive_ripple": (0.0, 1.0),
        SINK_START: (253.0, 393.0),
    }
)
"""Where each parameter is looked for, in its own unit."""

AUTHORS_BOUNDS: Final[Bounds] = MappingProxyType(
    {"seebeck": (0.02, 0.15), "conductance": (0.0, 1.0), "heat_capacity": (10.0, 60.0)}
)
"""The tighter limits of the paper's matching; the others as in `BOUNDS`."""

SCALES: Final[Mapping[str, float]] = MappingProxyType(
    {
        "seebeck": 0.075,
        "resistance": 3.3,
        "conductance": 0.35,
        "heat_capacity": 30.0,
        "ambient": 10.0,
        "sink_heat_capacity": 300.0,
        "sink_convection": 3.0,
        "sensor_lag": 2.0,
        "seebeck_slope": 1e-4,
        "drive_ripple": 1.0,
        SINK_START: 10.0,
    }
)
"""A typical size of each parameter (for temperatures, of their differences); fixed, so that condition
numbers of different windows compare."""

WITHOUT_ZERO: Final = frozenset({"ambient", "seebeck_slope", SINK_START})
"""Parameters whose zero means nothing: their error is compared with a typical difference instead."""


def checked_free(free: Iterable[str], parameters: RigParameters) -> tuple[str, ...]:
    """The names in canonical order, with `SINK_START` added for a sink with mass.

    Raises:
        MatchingError: no name, an unknown or repeated one, or one that this rig does not feel.
    """
    names = tuple(free)
    known = (*PARAMETER_NAMES, SINK_START)
    unknown = [name for name in names if name not in known]
    if unknown:
        msg = f"matching: {unknown[0]!r} cannot be free; choose among {', '.join(known)}"
        raise MatchingError(msg)
    if not names or len(set(names)) != len(names):
        msg = f"matching: free is {names}; name at least one parameter and none twice"
        raise MatchingError(msg)
    of_sink = [n for n in names if n in ("sink_heat_capacity", "sink_convection", SINK_START)]
    if of_sink and not parameters.sink_has_mass:
        msg = f"matching: {of_sink[0]} is free but the sink has no mass; give a finite sink_heat_capacity"
        raise MatchingError(msg)
    wanted = {*names, SINK_START} if parameters.sink_has_mass else set(names)
    return tuple(name for name in known if name in wanted)


def checked_bounds(bounds: Bounds | None) -> Bounds:
    """The default bounds with some replaced.

    Raises:
        MatchingError: a name is unknown or a pair is not finite and growing.
        PlantError: no rig can have the value at an end.
    """
    for name, (low, high) in (bounds or {}).items():
        if name not in BOUNDS:
            msg = f"matching: bounds for {name!r}, which is none of {', '.join(BOUNDS)}"
            raise MatchingError(msg)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            msg = f"matching: the bounds {low} and {high} of {name} must be finite and grow"
            raise MatchingError(msg)
        if name != SINK_START:
            for end in (low, high):
                RigParameters(**{name: end})
    return MappingProxyType({**BOUNDS, **(bounds or {})})
