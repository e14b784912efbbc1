"""A model-exchange FMU, which provides derivatives and is integrated here; and the loading of any FMU."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from twinmatch.fmu.archive import CO_SIMULATION, Described
from twinmatch.fmu.machine import Addresses, Buffers, Calls, CoSimulation, FmuRunError, References

MOST_ROUNDS: Final = 100
"""Most event iterations at one time."""
BISECTIONS: Final = 48
MOST_EVENTS: Final = 24
"""Most events located in one step; later ones are not located."""


class ModelExchange(CoSimulation):
    """A model-exchange FMU, integrated by Runge–Kutta steps of order 4.

    If an event indicator changes sign within a step, its time is found by bisection and the step ends just
    after it, as for kinks of the native equations.
    """

    def __init__(
        self, fmu: Any, major: int, references: References, described: Described, places: list[int]
    ) -> None:
        super().__init__(fmu, major, references)
        self._n = self._size = described.states
        self._places = places
        vector = ctypes.c_double * self._n
        self._x, self._dx = vector(), vector()
        calls, real, size, pointer = Calls(fmu, major), ctypes.c_double, ctypes.c_size_t, ctypes.c_void_p
        of_x, of_dx = (ctypes.addressof(array) for array in (self._x, self._dx))
        self._set_time = calls.bound("SetTime", real)
        self._set_x = partial(calls.bound("SetContinuousStates", pointer, size), of_x, self._n)
        self._get_x = partial(calls.bound("GetContinuousStates", pointer, size), of_x, self._n)
        rates = "GetDerivatives" if major == 2 else "GetContinuousStateDerivatives"
        self._get_dx = partial(calls.bound(rates, pointer, size), of_dx, self._n)
        self._completes_steps = described.after_steps
        self._events = described.indicators if major == 2 else None
        self._z: Any = None
        self._initialised_with: list[float] | None = None
        """Parameters of the last initialisation; None: it must be repeated."""

    def run_arguments(self) -> tuple[Addresses, Buffers] | None:
        """The arguments of a compiled run from the current state; None if it may have events."""
        return None if self._indicators else super().run_arguments()

    def _functions(self) -> dict[str, str]:
        rates = "GetDerivatives" if self.major == 2 else "GetContinuousStateDerivatives"
        return {
            "set_time": "SetTime",
            "set_x": "SetContinuousStates",
            "get_x": "GetContinuousStates",
            "get_dx": rates,
            "after_step": "CompletedIntegratorStep" if self._completes_steps else "",
            "do_step": "",
        }

    def put(self, fixed: Sequence[float], inputs: Sequence[float]) -> None:
        """Initialise with these values; the last of the fixed ones are the states."""
        split = len(fixed) - self._n
        given = list(fixed[:split])
        if given != self._initialised_with:
            super().put(given, inputs)
            self._initialised_with = given
            self._settle()
        self.time = 0.0
        self._set_time(0.0)
        super().feed(inputs)
        self._place([*fixed[split:]])
        self._after_jump()

    def forget(self) -> None:
        """Initialise again at the next `put`, after an error."""
        self._initialised_with = None

    def feed(self, inputs: Sequence[float]) -> None:
        """Set drive and disturbances."""
        super().feed(inputs)
        self._after_jump()

    def move(self, period: float, steps: int) -> None:
        """Advance by one period in `steps` steps."""
        x = self._own_states()
        end = self.time + period
        for k in range(steps):
            left, begun = period / steps, self.time
            for event in range(MOST_EVENTS):
                signs = self._signs(x, self.time)
                after = self._stepped(x, left)
                h = left
                if event < MOST_EVENTS - 1 and self._signs(after, self.time + left) != signs:
                    h = self._event_time(x, left, signs)
                    after = self._stepped(x, h)
                self.time += h
                self._complete_step(after)
                x = self._own_states() if h != left else after
                left -= h
                if not left > 0.0:
                    break
            self.time = begun + period / steps if k < steps - 1 else end
        self._set_time(self.time)

    def rates(self) -> list[float]:
        """Derivatives of the states at the current state."""
        return self._ordered(self._rates(self._own_states(), self.time))

    def states(self) -> list[float]:
        """The current states."""
        return self._ordered(self._own_states())

    def _ordered(self, own: list[float]) -> list[float]:
        return [own[place] for place in self._places]

    def _place(self, states: list[float]) -> None:
        for place, value in zip(self._places, states, strict=True):
            self._x[place] = value
        self._set_x()

    def _own_states(self) -> list[float]:
        if self._n:
            self._get_x()
        return self._x[:]

    def _rates(self, x: list[float], time: float) -> list[float]:
        self._set_time(time)
        self._x[:] = x  # type: ignore[assignment]
        self._set_x()
        self._get_dx()
        return self._dx[:]

    def _stepped(self, x: list[float], h: float) -> list[float]:
        t = self.time
        k1 = self._rates(x, t)
        k2 = self._rates([a + 0.5 * h * b for a, b in zip(x, k1, strict=True)], t + 0.5 * h)
        k3 = self._rates([a + 0.5 * h * b for a, b in zip(x, k2, strict=True)], t + 0.5 * h)
        k4 = self._rates([a + h * b for a, b in zip(x, k3, strict=True)], t + h)
        slopes = zip(x, k1, k2, k3, k4, strict=True)
        return [a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e) for a, b, c, d, e in slopes]

    def _signs(self, x: list[float], time: float) -> tuple[bool, ...]:
        if not self._indicators:
            return ()
        self._set_time(time)
        self._x[:] = x  # type: ignore[assignment]
        self._set_x()
        self.fmu.getEventIndicators(self._z, self._indicators)
        return tuple(value > 0.0 for value in self._z)

    def _event_time(self, x: list[float], h: float, signs: tuple[bool, ...]) -> float:
        """Length of the step that ends just after the first event, s."""
        low, high = 0.0, h
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if self._signs(self._stepped(x, middle), self.time + middle) != signs:
                high = middle
            else:
                low = middle
        return high

    def _complete_step(self, x: list[float]) -> None:
        """Set the states at the end of a step, and handle events."""
        self._set_time(self.time)
        self._x[:] = x  # type: ignore[assignment]
        self._set_x()
        wants_event = False
        if self._completes_steps:
            wants_event, ended = self.fmu.completedIntegratorStep()
            if ended:
                raise FmuRunError("it terminated the simulation")
        if wants_event or self._indicators:
            self._after_jump()

    @property
    def _indicators(self) -> int:
        if self._events is None:
            self._events = int(self.fmu.getNumberOfEventIndicators())
        if self._z is None:
            self._z = (ctypes.c_double * self._events)()
        return self._events

    def _after_jump(self) -> None:
        """Run an event iteration after a jump of states or inputs, if the FMU has event indicators."""
        if self._indicators:
            self.fmu.enterEventMode()
            self._settle()

    def _settle(self) -> None:
        for _ in range(MOST_ROUNDS):
            update = self.fmu.newDiscreteStates if self.major == 2 else self.fmu.updateDiscreteStates
            again, ended = update()[:2]
            if ended:
                raise FmuRunError("it terminated the simulation")
            if not again:
                self.fmu.enterContinuousTimeMode()
                return
        raise FmuRunError(f"its discrete states do not converge in {MOST_ROUNDS} event iterations")


def machine_of(
    folder: Path, described: Described, kind: str, references: References, places: list[int]
) -> CoSimulation:
    """Load the FMU's library and create an instance.

    Raises:
        FmuRunError: it has none for this machine, or that refuses.
    """
    from fmpy import fmi2, fmi3, platform, platform_tuple  # noqa: PLC0415 (an extra)

    major = int(described.version[0])
    here = platform if major == 2 else platform_tuple
    if here not in described.platforms:
        available = ", ".join(described.platforms) or "no platform"
        raise FmuRunError(f"it has binaries for {available}; this machine is {here}")
    classes = {2: (fmi2.FMU2Model, fmi2.FMU2Slave), 3: (fmi3.FMU3Model, fmi3.FMU3Slave)}[major]
    identifier = described.identifiers[described.kinds.index(kind)]
    library = folder / "binaries" / here / f"{identifier}.so"
    name = library.relative_to(folder)
    if not library.is_file():
        raise FmuRunError(f"it has no {name}, the program for this machine; export it again")
    try:
        fmu = classes[kind == CO_SIMULATION](
            guid=described.guid,
            modelIdentifier=identifier,
            unzipDirectory=str(folder),
            instanceName="twinmatch",
            libraryPath=str(library),
        )
    except Exception as error:  # FMPy raises many kinds
        why = str(error).rpartition(f"{library}: ")[2]
        raise FmuRunError(f"its {name} is not a library for this machine: {why}") from error
    try:
        fmu.instantiate()
    except Exception as error:
        raise FmuRunError(f"it cannot be instantiated ({error}): is it complete, and its licence?") from error
    if kind == CO_SIMULATION:
        return CoSimulation(fmu, major, references)
    return ModelExchange(fmu, major, references, described, places)
