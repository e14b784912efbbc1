"""What a plant file lacks: effects that are added to its equations and fitted to what it leaves.

An effect is written as the lines that a user would add to the file, and these lines are run: the plant is
derived with them, compiled, and fitted to the samples that its own equations do not explain. The effect with
the smallest charge is named: N/2 times the logarithm of the mean square that is left, for N independent
residuals, and half that of N for each value that it adds (Schwarz 1978). The size of the residuals is unknown
here, so their ratio counts, not their difference in units of the noise.
"""

from __future__ import annotations

import math
import re
import types
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from operator import attrgetter
from typing import Any, Final, NamedTuple

from twinmatch.dynamics import (
    DeadTime,
    Drive,
    Model,
    Output,
    Parameter,
    Parameters,
    State,
    dead_times_of,
    dry_friction,
)
from twinmatch.dynamics.equations import outputs_of, written_equations
from twinmatch.dynamics.pace import time_constant
from twinmatch.errors import TwinmatchError
from twinmatch.fitting.estimation import Effort
from twinmatch.settings import Rule

LEFT: Final = 3.0
"""Mean squared weighted residual above which a driven twin may lack something."""
_UNKNOWN: Final = 50.0
"""Time constant of a plant that only integrates, sampling periods."""
_NAMES: Final = {
    one.__name__: one for one in (DeadTime, Parameter, State, dry_friction, replace)
}


class _Justification(Rule):
    """What an effect has to explain to be named: half of what the plant leaves, and more than it costs by six
    nats: 1 in 400."""

    explained: float = 0.5
    """Share of the squared residuals that it must explain."""
    sure: float = 6.0
    """Nats by which the charge must fall."""


_JUSTIFIED: Final = _Justification()


_MOST_EVALUATIONS: Final = 40
"""Evaluations of a fit with an effect: one that is not done by then rarely ends at all."""
_NEGLIGIBLE: Final = 1e-3
"""Share of what a plant leaves that decides nothing: an effect explains half of it, and effects differ by nats."""


def effort_for(left: float) -> Effort:
    """How far to fit effects to what a plant leaves, as a mean squared weighted residual."""
    return Effort(_MOST_EVALUATIONS, _NEGLIGIBLE * left)


class _Effect(NamedTuple):
    """An effect that equations may lack; texts have places for the names of the plant."""

    title: str
    declared: str
    """The lines of its declarations. States are unknown at the start and parameters free; the first of these
    is said: a time, which is tried from several starts, or a value."""
    equations: str
    """The lines in `equations`, where `held` are those without it."""
    parts: tuple[str, ...] = ()
    """Titles of the effects that it consists of; empty if it is one."""


_STATE = "State(unit={unit!r}, span={span}, start_bounds={span})\n"
_TIME = (
    "Parameter(unit='s', default={usual}, bounds=({short}, {long}), positive=True)\n"
)
_RATE = "Parameter(unit='1/s', default={rate}, bounds=(0.0, {fast}), least=0.0)\n"
_STEEP = "Parameter(unit={rate_unit!r}, default=0.0, bounds=({low}, {steep}), least={low}, scale={steep})\n"
_OF_A_DRIVE: Final = (
    _Effect(
        "a dead time",
        "arriving = DeadTime(unit={unit!r}, span={span})\n"
        "delay = Parameter(unit='s', default={few}, bounds=({short}, {slow}), positive=True)\n",
        "arrives = self.arriving.after(self.{at}, self.delay)\n"
        "held = held.driven(self.{at}, arrives.value)\n"
        "held.rates.update(arrives.rates)\n"
        "held.start.update(arrives.start)\n",
    ),
    _Effect(
        "a second store behind {at}",
        f"between = {_STATE}between_lag = {_TIME}",
        "held = held.driven(self.{at}, self.between)\n"
        "held.rates[self.between] = (self.{at} - self.between) / self.between_lag\n"
        "held.start[self.between] = self.{at}\n",
    ),
    _Effect(
        "a scale of {at}",
        "input_scale = Parameter(default=1.0, bounds=(0.05, 20.0), positive=True)\n",
        "held = held.driven(self.{at}, self.input_scale * self.{at})\n",
    ),
)
_OF_AN_OUTPUT: Final = _Effect(
    "a second store behind the output {at}",
    f"shown = {_STATE}shown_lag = {_TIME}",
    "read = held.expression_of(self.{at})\n"
    "held.rates[self.shown] = (read - self.shown) / self.shown_lag\n"
    "held.start[self.shown] = self.{at}\n"
    "held = replace(held, output=self.shown)\n",
)
_BESIDE: Final = _Effect(
    "a second store beside {at}",
    f"beside = {_STATE}beside_lag = {_TIME}beside_rate = {_RATE}",
    "held.rates[self.{at}] += self.beside_rate * (self.beside - self.{at})\n"
    "held.rates[self.beside] = (self.{at} - self.beside) / self.beside_lag\n"
    "held.start[self.beside] = held.start[self.{at}]\n",
)
_FED: Final = _Effect(
    "a second store between {drive} and {at}",
    f"fed = {_STATE}fed_lag = {_TIME}fed_rate = {_RATE}",
    "idle = held.driven(self.{drive}, {rest}).rates[self.{at}]\n"
    "held.rates[self.fed] = held.rates[self.{at}] - idle + (self.{at} - self.fed) / self.fed_lag\n"
    "held.rates[self.{at}] = idle + self.fed_rate * (self.fed - self.{at})\n"
    "held.start[self.fed] = held.start[self.{at}]\n",
)
_BOTH: Final = _Effect(
    f"{_FED.title}, and a third one beside it",
    _FED.declared + _BESIDE.declared,
    _FED.equations + _BESIDE.equations,
    parts=(_FED.title, _BESIDE.title),
)
_LOAD: Final = _Effect(
    "a constant load on {at}",
    f"load_rate = {_STEEP}".replace("{low}", "-{steep}"),
    "held.rates[self.{at}] += self.load_rate\n",
)
_FRICTION: Final = _Effect(
    "friction of {at}",
    f"friction = {_STEEP}".replace("{low}", "0.0"),
    "held.rates[self.{at}] += dry_friction(self.{at}, self.friction, {soft})\n",
)
_COLUMN: Final = _Effect(
    "the measured {column} on {at}, by a rate",
    "by_column = Parameter(default=0.0, bounds=(-{wide}, {wide}), scale={per}, relative=False)\n",
    "held.rates[self.{at}] += self.by_column * (self.{column} - {middle})\n",
)


class Lack(NamedTuple):
    """What a plant file lacks most."""

    what: str
    """Such as `a second store beside air of about 3 h`."""
    explained: float
    """Share of the squared residuals that it explains."""
    lines: tuple[str, ...]
    """What to add to the file, in the order in which it is read."""
    model: Model
    """The plant with it."""

    def __str__(self) -> str:
        """A clause for a sentence about the residuals."""
        return f"{self.what} would explain {self.explained:.0%} of them"


@dataclass(frozen=True, eq=False)
class _Grown:
    """A plant with an effect added, in one structure."""

    base: Model
    effect: _Effect
    """With the plant's names."""
    words: dict[str, Any]
    """What its lines need."""

    @property
    def added(self) -> int:
        """Number of values that it adds to a fit."""
        return len(re.findall(r"= (?:Parameter|State)\(", self.effect.declared))

    @cached_property
    def model(self) -> Model | None:
        """The plant, compiled when it is first asked for; None if it cannot have the effect."""
        try:
            return _with_effect(self.base, self.effect, self.words)
        except TwinmatchError:  # such as a name that the plant has already
            return None


def lack_of(
    base: Parameters,
    period: float,
    left: float,
    independent: float,
    fit: Callable[[Parameters], tuple[Parameters, float] | None],
) -> Lack | None:
    """The effect that explains most of what a plant leaves; None if none is justified.

    Effects that add few values come first, and those that could not win if they left nothing are not fitted,
    nor those of whose parts none could be.

    Args:
        base: the plant as fitted without it.
        period: sampling period, s.
        left: mean squared weighted residual of that fit.
        independent: number of independent residuals.
        fit: fits a plant from a start; the parameters and what is left; None if it does not converge.
    """
    if base.model.is_external:
        return None
    best = None
    structure = base.model.structure
    price = math.log(max(independent, 2.0))
    least = independent * math.log(max(left, 1.0)) / 2 - _JUSTIFIED.sure
    unfitted: set[str] = set()
    for grown in _plants_with_effects(base.model, period):
        price_of_added = grown.added * price / 2
        if price_of_added >= least:
            break
        parts = grown.effect.parts
        if grown.model is None or (parts and unfitted.issuperset(parts)):
            continue
        fitted = fit(grown.model.parameters(**base))
        if fitted is None:
            unfitted.add(grown.effect.title)
            continue
        parameters, left_by_effect = fitted
        if left_by_effect > (1.0 - _JUSTIFIED.explained) * left:
            continue
        charge = independent * math.log(max(left_by_effect, 1.0)) / 2 + price_of_added
        if charge < least:
            least = charge
            first_added = grown.model.structure.free[len(structure.free)]
            title = f"{grown.effect.title} of about {_size_in_words(parameters, first_added)}"
            best = Lack(
                title,
                1.0 - left_by_effect / left,
                _lines(grown, grown.model),
                grown.model,
            )
    return best


@cache
def _plants_with_effects(model: Model, period: float) -> tuple[_Grown, ...]:
    """The plants with each of the effects, those with few added values first."""
    grown = []
    for effect, words in _effects(model, period):
        title, declared, lines = (text.format(**words) for text in effect[:3])
        parts = tuple(part.format(**words) for part in effect.parts)
        named = _Effect(title, declared, lines, parts)
        grown.append(_Grown(model, named, words))
    return tuple(sorted(grown, key=attrgetter("added")))


def _effects(model: Model, period: float) -> Iterator[tuple[_Effect, dict[str, Any]]]:
    """Every effect at every place, with what its lines need."""
    plant = model.plant
    slow = time_constant(plant) or _UNKNOWN * period
    written = written_equations(plant(), model.structure.parts)
    shown = list(outputs_of(plant(), written).values())
    has_dead_time = bool(dead_times_of(plant))
    for drive in plant.drives.values():
        for effect in _OF_A_DRIVE[has_dead_time:]:  # the first is a dead time
            yield effect, _words_at(drive, slow, period)
    if len(shown) == 1:
        yield _OF_AN_OUTPUT, _words_at(plant.output, slow, period)
    moved_by = {str(state): _symbols([rate]) for state, rate in written.rates.items()}
    idle = plant.disturbances.keys() - _symbols([*written.rates.values(), *shown])
    for name in model.states:
        drives = [
            drive for drive in plant.drives.values() if drive.name in moved_by[name]
        ]
        if drives or name in _symbols(shown):
            state = plant.states[name]
            yield from _effects_on_state(state, drives, slow, period)
            for column in sorted(idle):
                middle = plant.disturbances[column].default
                per = (state.span[1] - state.span[0]) / slow / max(abs(middle), 1.0)
                words = {
                    "column": column,
                    "middle": middle,
                    "per": per,
                    "wide": 1e3 * per,
                }
                yield _COLUMN, _words_at(state, slow, period) | words


def _effects_on_state(
    state: State, drives: Sequence[Drive], slow: float, period: float
) -> Iterator[tuple[_Effect, dict[str, Any]]]:
    """The effects on a state, and those that need a drive which moves it."""
    for effect in (_BESIDE, _LOAD):
        yield effect, _words_at(state, slow, period)
    low, high = state.span
    for drive in drives:
        words = _words_at(state, slow, period) | {
            "drive": drive.name,
            "rest": drive.rest,
        }
        for effect in (_FED, _BOTH):
            yield effect, words
    if drives and low < 0.0 < high:
        yield _FRICTION, _words_at(state, slow, period)


def _words_at(
    declared: State | Drive | Output, slow: float, period: float
) -> dict[str, Any]:
    """What the lines of an effect need at its place, for a plant with a time constant, s."""
    low, high = declared.limits if isinstance(declared, Drive) else declared.span
    numbers = {
        "usual": slow / 3,
        "few": 3 * period,
        "short": period,
        "slow": slow,
        "long": 100 * slow,
        "rate": 1 / slow,
        "fast": 100 / slow,
        "steep": 10 * (high - low) / slow,
        "soft": 1e-3 * (high - low),
    }
    words: dict[str, Any] = {
        name: float(f"{value:.3g}") for name, value in numbers.items()
    }
    words |= {"at": declared.name, "unit": declared.unit, "span": (low, high)}
    words["rate_unit"] = f"{declared.unit or 1}/s"
    return words


def _symbols(expressions: Iterable[Any]) -> set[str]:
    """Names in some expressions."""
    return {
        str(symbol) for e in expressions for symbol in getattr(e, "free_symbols", ())
    }


def _with_effect(model: Model, effect: _Effect, words: dict[str, Any]) -> Model:
    """The plant's structure with an effect added.

    Raises:
        TwinmatchError: the plant has one of its names already, or the equations cannot be used.
    """
    plant = model.plant
    structure = model.structure
    declared: dict[str, Any] = {}
    exec(effect.declared, dict(_NAMES), declared)  # noqa: S102
    taken_names = [name for name in declared if hasattr(plant, name)]
    if taken_names:
        raise TwinmatchError(
            f"plant {plant.name}: it has {', '.join(taken_names)} already"
        )

    def equations(self: Any, parts: frozenset[str]) -> Any:
        plain = plant.equations(self, parts)
        extended = replace(plain, rates=dict(plain.rates), start=dict(plain.start))
        local = {**_NAMES, "self": self, "held": extended}
        exec(effect.equations, local)  # noqa: S102
        return local["held"]

    free = [name for name, value in declared.items() if isinstance(value, Parameter)]
    hidden = [name for name, value in declared.items() if isinstance(value, State)]
    first = free[0]
    starts = []
    if declared[first].unit == "s":
        for time in (words["usual"] / 10, 10 * words["usual"]):
            if time > words["short"]:
                starts.append({first: time})
    richer = replace(
        structure,
        free=(*structure.free, *free),
        free_starts=(*structure.free_starts, *hidden),
        starts=tuple(starts),
    )
    body = declared | {
        "equations": equations,
        "structures": {model.structure_name: richer},
        "followed": "",
    }
    body |= {"__module__": __name__, "__qualname__": f"{plant.__qualname__} {effect}"}
    plant_class: Any = types.new_class(
        plant.__name__,
        (plant,),
        {"name": plant.name},
        lambda namespace: namespace.update(body),
    )
    return plant_class.model()  # type: ignore[no-any-return]


def _size_in_words(found: Parameters, name: str) -> str:
    """A parameter to two digits, with its unit; times in one in which they are not long numbers."""
    value = found[name]
    unit = found.model.declared[name].unit
    if unit == "s":
        for seconds, longer_unit in ((86400, "d"), (3600, "h"), (60, "min")):
            if value >= 2 * seconds:
                value /= seconds
                unit = longer_unit
                break
    return f"{float(f'{value:.2g}'):g} {unit}".rstrip()


def _imports(effect: _Effect) -> list[str]:
    """The lines that import what the lines of an effect use; they stand above the class."""
    words = set(re.findall(r"\w+", effect.declared + effect.equations))
    of_dynamics = sorted(words & _NAMES.keys() - {"replace"})
    lines = ["from dataclasses import replace"] if "replace" in words else []
    if of_dynamics:
        lines.append(f"from twinmatch.dynamics import {', '.join(of_dynamics)}")
    return lines


def _lines(grown: _Grown, model: Model) -> tuple[str, ...]:
    base = grown.base
    richer = model.structure
    part = grown.effect.title.removeprefix("a ")
    starts = f", free_starts={richer.free_starts}" if richer.free_starts else ""
    wanted = f"Structure(free={richer.free}, parts=frozenset({sorted({*richer.parts, part})}){starts})"
    return (
        *_imports(grown.effect),
        *grown.effect.declared.splitlines(),
        f"parts = {(*base.plant.parts, part)}",
        f"structures = {{…, {f'{base.structure_name}, {part}'!r}: {wanted}}}",
        "in `equations`, write held = Equations(…) in place of return Equations(…), and after it:",
        f"    if {part!r} in parts:",
        *(f"        {line}" for line in grown.effect.equations.splitlines()),
        "    return held",
    )
