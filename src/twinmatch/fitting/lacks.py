"""What a plant file lacks: effects that are added to its equations, one at a time, and fitted to what it leaves.

An effect is written as the lines that a user would add to the file, and these lines are what is run: the plant
is derived with them, compiled, and fitted to the samples that its own equations do not explain. The effect
with the smallest charge is named: N/2 times the logarithm of the mean square that is left, for N independent
residuals, and half that of N for each value that it adds (Schwarz 1978). The size of the residuals is unknown
here, so it is their ratio that counts, not their difference in units of the noise.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any, Final, NamedTuple

from twinmatch.dynamics import (
    DeadTime,
    Drive,
    Model,
    Output,
    Parameter,
    Parameters,
    State,
    Structure,
    dry_friction,
)
from twinmatch.dynamics.equations import outputs_of, written_equations
from twinmatch.dynamics.pace import time_constant
from twinmatch.errors import TwinmatchError

LEFT: Final = 3.0
"""Mean squared weighted residual above which a driven twin may lack something."""
_EXPLAINED: Final = 0.5
"""Share of the squared residuals that an effect must explain to be named."""
_SURE: Final = 6.0
"""Nats by which the charge must fall: 1 in 400."""
_UNKNOWN_PERIODS: Final = 50.0
"""Time constant of a plant that only integrates, sampling periods."""


class _Effect(NamedTuple):
    """An effect that equations may lack; texts have places for the names of the plant."""

    title: str
    declared: str
    """The lines of its declarations."""
    equations: str
    """The lines in `equations`, where `held` are those without it."""
    free: tuple[str, ...]
    hidden: tuple[str, ...] = ()
    """States whose value at the start is unknown."""
    lasts: str = ""
    """The parameter that is a time, which is tried from several starts."""
    said: str = ""
    """Parameter whose value is said with its unit."""


_TIME = "Parameter(unit='s', default={usual}, bounds=({short}, {long}), positive=True)"
_STATE = "State(unit={unit!r}, span={span}, start_bounds={span}, text={text!r})"
OF_A_DRIVE: Final = (
    _Effect(
        "a dead time",
        "arriving = DeadTime(unit={unit!r}, span={span}, text='{at} that has arrived')\n"
        "delay = Parameter(unit='s', default={few}, bounds=({short}, {most}), positive=True)",
        "arrives = self.arriving.after(self.{at}, self.delay)\n"
        "held = held.driven(self.{at}, arrives.value)\n"
        "held.rates.update(arrives.rates)\n"
        "held.start.update(arrives.start)",
        ("delay",),
        lasts="delay",
    ),
    _Effect(
        "a second store behind {at}",
        f"between = {_STATE}\nbetween_lag = {_TIME}",
        "held = held.driven(self.{at}, self.between)\n"
        "held.rates[self.between] = (self.{at} - self.between) / self.between_lag\n"
        "held.start[self.between] = self.{at}",
        ("between_lag",),
        ("between",),
        lasts="between_lag",
    ),
    _Effect(
        "a scale of {at}",
        "scale_of_input = Parameter(default=1.0, bounds=(0.05, 20.0), positive=True)",
        "held = held.driven(self.{at}, self.scale_of_input * self.{at})",
        ("scale_of_input",),
        said="scale_of_input",
    ),
)
OF_A_STATE: Final = (
    _Effect(
        "a second store beside {at}",
        f"beside = {_STATE}\nbeside_lag = {_TIME}\n"
        "beside_rate = Parameter(unit='1/s', default={rate}, bounds=(0.0, {fast}), least=0.0)",
        "held.rates[self.{at}] += self.beside_rate * (self.beside - self.{at})\n"
        "held.rates[self.beside] = (self.{at} - self.beside) / self.beside_lag\n"
        "held.start[self.beside] = held.start[self.{at}]",
        ("beside_lag", "beside_rate"),
        ("beside",),
        lasts="beside_lag",
    ),
    _Effect(
        "a constant load on {at}",
        "load_rate = Parameter(unit={rate_unit!r}, default=0.0, bounds=(-{steep}, {steep}), scale={steep})",
        "held.rates[self.{at}] += self.load_rate",
        ("load_rate",),
        said="load_rate",
    ),
)
A_FED_STORE: Final = _Effect(
    "a second store between {drive} and {at}",
    f"fed = {_STATE}\nfed_lag = {_TIME}\n"
    "fed_rate = Parameter(unit='1/s', default={rate}, bounds=(0.0, {fast}), least=0.0)",
    "idle = held.driven(self.{drive}, {rest}).rates[self.{at}]\n"
    "held.rates[self.fed] = held.rates[self.{at}] - idle + (self.{at} - self.fed) / self.fed_lag\n"
    "held.rates[self.{at}] = idle + self.fed_rate * (self.fed - self.{at})\n"
    "held.start[self.fed] = held.start[self.{at}]",
    ("fed_lag", "fed_rate"),
    ("fed",),
    lasts="fed_lag",
)
TWO_STORES: Final = _Effect(
    "a second store between {drive} and {at}, and a third one beside it",
    f"{A_FED_STORE.declared}\n{OF_A_STATE[0].declared}",
    f"{A_FED_STORE.equations}\n{OF_A_STATE[0].equations}",
    (*A_FED_STORE.free, *OF_A_STATE[0].free),
    (*A_FED_STORE.hidden, *OF_A_STATE[0].hidden),
    lasts="fed_lag",
)
OF_A_SPEED: Final = _Effect(
    "friction of {at}",
    "friction = Parameter(unit={rate_unit!r}, default=0.0, bounds=(0.0, {steep}), least=0.0, scale={steep})",
    "held.rates[self.{at}] += dry_friction(self.{at}, self.friction, {soft})",
    ("friction",),
    said="friction",
)
OF_A_COLUMN: Final = _Effect(
    "the measured {column}",
    "by_column = Parameter(default=0.0, bounds=(-{wide}, {wide}), scale={per}, relative=False)",
    "held.rates[self.{at}] += self.by_column * (self.{column} - {middle})",
    ("by_column",),
)
BEHIND_AN_OUTPUT: Final = _Effect(
    "a second store behind the output {at}",
    f"shown = {_STATE}\nshown_lag = {_TIME}",
    "held.rates[self.shown] = (held.output - self.shown) / self.shown_lag\n"
    "held.start[self.shown] = self.{at}\n"
    "held = replace(held, output=self.shown)",
    ("shown_lag",),
    ("shown",),
    lasts="shown_lag",
)
_NAMES: Final = {
    "DeadTime": DeadTime, "Parameter": Parameter, "State": State, "dry_friction": dry_friction, "replace": replace
}  # fmt: skip


class Lack(NamedTuple):
    """What a plant file lacks most."""

    what: str
    """Such as `a second store beside air of about 3 h`."""
    explained: float
    """Share of the squared residuals that it explains."""
    lines: tuple[str, ...]
    """What to add to the file."""

    def __str__(self) -> str:
        """A clause for a sentence about the residuals."""
        return f"{self.what} would explain {self.explained:.0%} of them"


class _Grown(NamedTuple):
    """A plant with an effect added, in one structure."""

    effect: _Effect
    words: dict[str, Any]
    model: Model


def lack_of(
    base: Parameters,
    period: float,
    left: float,
    independent: float,
    fit: Callable[[Parameters], tuple[Parameters, float] | None],
) -> Lack | None:
    """The effect that explains most of what a plant leaves; None if none is justified.

    Args:
        base: the plant as fitted without it.
        period: sampling period, s.
        left: mean squared weighted residual of that fit.
        independent: number of independent residuals.
        fit: fits a plant from a start; the parameters and what is left; None if it does not converge.
    """
    if base.model.is_external:
        return None
    best, least, each = (
        None,
        independent * math.log(max(left, 1.0)) / 2 - _SURE,
        math.log(max(independent, 2.0)),
    )
    for grown in _plants_with_effects(base.model, period):
        found = fit(grown.model.parameters(**base))
        if found is None or found[1] > (1.0 - _EXPLAINED) * left:
            continue
        added = len(grown.effect.free) + len(grown.effect.hidden)
        charge = (independent * math.log(max(found[1], 1.0)) + added * each) / 2
        if charge < least:
            best, least = (
                Lack(_words(grown, found[0]), 1.0 - found[1] / left, _lines(base.model, grown)),
                charge,
            )
    return best


@cache
def _plants_with_effects(model: Model, period: float) -> tuple[_Grown, ...]:
    grown = []
    for effect, words in _effects(model, period):
        try:
            grown.append(_Grown(effect, words, _with_effect(model, effect, words)))
        except TwinmatchError:  # such as a name that the plant has already
            continue
    return tuple(grown)


def _effects(model: Model, period: float) -> Iterator[tuple[_Effect, dict[str, Any]]]:
    """Every effect at every place, with what its lines need."""
    plant, slow = model.plant, time_constant(model.plant) or _UNKNOWN_PERIODS * period
    written = written_equations(plant(), model.structure.parts)
    shown = outputs_of(plant(), written)
    used = _symbols([*written.rates.values(), *shown.values()])
    times = {"usual": slow / 3, "few": 3 * period, "short": period, "most": slow, "long": 100 * slow}
    times |= {"rate": 1 / slow, "fast": 100 / slow}

    def at(declared: State | Drive | Output, **more: Any) -> dict[str, Any]:
        low, high = declared.limits if isinstance(declared, Drive) else declared.span
        steep = 10 * (high - low) / slow
        numbers = {name: float(f"{value:.3g}") for name, value in (times | {"steep": steep}).items()}
        own = {"at": declared.name, "unit": declared.unit, "span": (low, high), "text": "second store"}
        return {**numbers, **own, "rate_unit": f"{declared.unit or 1}/s", "soft": 1e-3 * (high - low), **more}

    for drive in plant.drives.values():
        late = any(isinstance(part, DeadTime) for part in vars(plant).values())
        yield from ((effect, at(drive)) for effect in OF_A_DRIVE[late:])
    if len(shown) == 1:
        yield BEHIND_AN_OUTPUT, at(plant.output)
    driven = {str(s) for s, rate in written.rates.items() if _symbols([rate]) & {*plant.drives}}
    seen = _symbols(shown.values())
    for name in (n for n in model.states if n in driven | seen):
        state = plant.states[name]
        yield from ((effect, at(state)) for effect in OF_A_STATE)
        for drive in plant.drives.values():
            if drive.name in _symbols([written.rates[getattr(plant(), name)]]):
                words = at(state, drive=drive.name, rest=drive.rest)
                yield from ((effect, words) for effect in (A_FED_STORE, TWO_STORES))
        if name in driven and state.span[0] < 0.0 < state.span[1]:
            yield OF_A_SPEED, at(state)
        for column, declared in plant.disturbances.items():
            if column not in used:
                per = (state.span[1] - state.span[0]) / slow / max(abs(declared.default), 1.0)
                yield OF_A_COLUMN, at(state, column=column, middle=declared.default, per=per, wide=1e3 * per)


def _symbols(expressions: Iterable[Any]) -> set[str]:
    """Names in some expressions."""
    return {str(symbol) for e in expressions for symbol in getattr(e, "free_symbols", ())}


def _with_effect(model: Model, effect: _Effect, words: dict[str, Any]) -> Model:
    """The plant's structure with an effect added.

    Raises:
        PlantError: the plant has one of its names already, or the equations cannot be used.
    """
    plant, structure = model.plant, model.structure
    declared: dict[str, Any] = {}
    exec(effect.declared.format(**words), dict(_NAMES), declared)  # noqa: S102 — the lines of this module
    if declared.keys() & vars(plant).keys():
        raise TwinmatchError(f"plant {plant.name}: it has {', '.join(declared)} already")
    lines = compile(effect.equations.format(**words), effect.title, "exec")

    def equations(self: Any, parts: frozenset[str]) -> Any:
        held = plant.equations(self, parts)
        held = replace(held, rates=dict(held.rates), start=dict(held.start))
        local = {**_NAMES, "self": self, "held": held}
        exec(lines, local)  # noqa: S102 — the lines of this module
        return local["held"]

    slow, short = words["usual"], words["short"]
    starts = tuple({effect.lasts: t} for t in (slow / 10, 10 * slow) if t > short) if effect.lasts else ()
    richer = Structure(
        free=(*structure.free, *effect.free),
        parts=structure.parts,
        fixed=structure.fixed,
        free_starts=(*structure.free_starts, *effect.hidden),
        starts=starts,
    )
    body = declared | {
        "equations": equations, "structures": {model.structure_name: richer}, "followed": "",
        "__module__": __name__, "__qualname__": f"{plant.__qualname__} {effect.title} {words}",
    }  # fmt: skip
    made = types.new_class(plant.__name__, (plant,), {"name": plant.name}, lambda space: space.update(body))
    return made.model()  # type: ignore[no-any-return, attr-defined]


def _words(grown: _Grown, found: Parameters) -> str:
    effect, text = grown.effect, grown.effect.title.format(**grown.words)
    if effect.lasts:
        return f"{text} of about {_time(found[effect.lasts])}"
    if effect.said:
        unit = grown.model.declared[effect.said].unit
        return f"{text} of about {found[effect.said]:.2g} {unit}".rstrip()
    return text


def _time(seconds: float) -> str:
    sizes = ((86400, "d"), (3600, "h"), (60, "min"))
    size, unit = next((one for one in sizes if seconds >= 2 * one[0]), (1, "s"))
    return f"{float(f'{seconds / size:.2g}'):g} {unit}"


def _lines(model: Model, grown: _Grown) -> tuple[str, ...]:
    """What to add to a plant file, in the order in which it is read."""
    effect, words = grown.effect, grown.words
    part = effect.title.format(**words).removeprefix("a ")
    richer = grown.model.structure
    free = f"free={richer.free}, parts=frozenset({sorted({*richer.parts, part})})"
    free += f", free_starts={richer.free_starts}" if richer.free_starts else ""
    return (
        *effect.declared.format(**words).splitlines(),
        f"parts = {(*model.plant.parts, part)}",
        f"structures = {{…, {f'{model.structure_name}, {part}'!r}: Structure({free})}}",
        "in `equations`, write held = Equations(…) in place of return Equations(…), and after it:",
        f"    if {part!r} in parts:",
        *(f"        {line}" for line in effect.equations.format(**words).splitlines()),
        "    return held",
    )
