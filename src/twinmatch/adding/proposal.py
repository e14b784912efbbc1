"""A first-order model of an unknown plant, estimated from a table of its signals.

Gain and lag are those of the difference equation y[k+1] − y[k] = a + b·y[k] + c·u[k] (and
disturbances), by least squares over blocks of samples long enough to move further than the noise.
"""

from __future__ import annotations

import keyword
import math
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from twinmatch.adding.noise import noise_of
from twinmatch.dynamics import Plant
from twinmatch.importing.mapped import require_columns, times_of, with_titles
from twinmatch.importing.resampling import Kind, repeated, resample
from twinmatch.importing.tables import Table, split_title
from twinmatch.sampling.sources import SignalMap, SignalSource
from twinmatch.sessions.files import RecordingError
from twinmatch.signals import FloatArray
from twinmatch.units import is_readable, measure

_SPIKE: Final = 10.0
"""Distance from the median of its neighbours, in noises, from which a reading is a spike."""
_MOST: Final = 1e100
"""Size from which squares of values are not numbers any longer."""
_KNOWN: Final = ("time", "output", "input", "reference")
_ROLES: Final = {"output": "measured", "input": "drive"}
"""Names of these signals where the table calls them by the name of another one, as PID libraries do."""
_RANGES: Final = ((0.0, 1.0), (0.0, 100.0), (-1.0, 1.0), (-100.0, 100.0), (0.0, 255.0), (-255.0, 255.0))
"""Usual ranges of a drive's command."""
_OFFSET_UNITS: Final = {"degc": "°C", "c": "°C", "°c": "°C", "celsius": "°C", "degf": "°F", "sec": "s"}


class Signal(NamedTuple):
    """A signal of the proposed plant."""

    name: str
    unit: str
    low: float
    high: float
    text: str = ""


@dataclass(frozen=True)
class Proposal:
    """Numbers for a first plant file."""

    output: Signal
    input: Signal
    disturbances: tuple[Signal, ...]
    noise: float
    """Standard deviation of the output's noise."""
    period: float
    """Sampling period, s."""
    gain: float
    """Steady-state gain: output per unit of the input."""
    lag: float
    """Time constant, s."""
    rest: float
    """Steady-state output without input, where no disturbance determines it."""
    sources: dict[str, SignalSource]
    """By signal, with the names of this plant; empty without a table."""
    table: str = ""
    """Name of the table's file."""
    has_reference: bool = False
    split: bool = False
    """Whether the table has gaps, or a clock that was set back."""

    @property
    def thermal(self) -> bool:
        """Whether the output is a temperature."""
        return measure(self.output.unit).dimension == (("[temperature]", 1.0),)

    @property
    def around(self) -> Signal | None:
        """The disturbance that the output tends to without input: the first one of the output's kind."""
        return next((d for d in self.disturbances if _alike(d.unit, self.output.unit)), None)


def _alike(unit: str, other: str) -> bool:
    """Whether two units measure the same quantity."""
    return measure(unit).dimension == measure(other).dimension


def example() -> Proposal:
    """A proposal without a table: a heated block in a room with measured temperature."""
    return Proposal(
        output=Signal("temperature", "°C", -20.0, 150.0, "temperature of the block"),
        input=Signal("heater", "%", 0.0, 100.0, "heater"),
        disturbances=(Signal("room", "°C", 10.0, 30.0, "temperature of the room"),),
        noise=0.1,
        period=1.0,
        gain=0.6,
        lag=120.0,
        rest=20.0,
        sources={},
    )


def propose(table: Table, given: SignalMap) -> Proposal:
    """Estimate the numbers for a first plant file from a table.

    Args:
        table: the table.
        given: columns of time, output and input; every other name is a disturbance.
    """
    require_columns(table, given)
    sources = {name: with_titles(table, source) for name, source in given.sources.items()}
    signals = {name: _values(table, source) for name, source in sources.items() if name != "time"}
    times = times_of(table, sources.get("time"), given.period)
    kinds: dict[str, Kind] = {**dict.fromkeys(signals, "reading"), "input": "held", "reference": "set"}
    kept = np.flatnonzero(np.all([np.isfinite(v) for v in (times.seconds, *signals.values())], axis=0))
    kept = np.setdiff1d(kept, repeated(kept, times.seconds, *signals.values()))
    done = resample(
        times.seconds[kept],
        {name: values[kept] for name, values in signals.items()},
        kinds,
        given.period,
        gaps="split",
        place=str(table.path),
        row=lambda i: f"{table.row} {table.lines[int(kept[i])]}",
    )
    for name, values in done.columns.items():
        if not np.abs(values).max() < _MOST:
            raise RecordingError(f"{table.path}: {name} reaches {np.abs(values).max():g}; correct its values")
    y, u = done.columns["output"], done.columns["input"]
    others = [name for name in given.sources if name not in _KNOWN]
    part = max(done.stretches, key=lambda stretch: stretch.stop - stretch.start)  # no rate across a gap
    beside = [done.columns[n][part] for n in others]
    noise = noise_of(y[part], [u[part], *beside])
    gain, lag, rest = _first_order(_without_spikes(y[part], noise), u[part], beside, noise, done.period)
    wanted = _unit(table, sources, "output")
    around = next((name for name in others if _alike(_unit(table, sources, name), wanted)), None)
    if around is not None:  # it is taken as the steady-state output without input
        rest = float(done.columns[around].mean())
    taken: list[str] = []
    output, input_ = (_signal(table, sources, s, taken) for s in ("output", "input"))
    span, reach = float(np.ptp(y)) or 1.0, _range_of(u)
    ends = [rest, *(rest + gain * limit for limit in reach)]
    low, high = _round_out(min(float(y.min()), *ends) - span, max(float(y.max()), *ends) + span)
    disturbances = []
    for name in others:
        values = done.columns[name]
        word, unit = _word(name, taken), _unit(table, sources, name)
        disturbances.append(Signal(word, unit, float(values.min()), float(values.max())))
    names = dict(zip(others, (d.name for d in disturbances), strict=True))
    return Proposal(
        output=Signal(*output, low, high),
        input=Signal(*input_, *reach),
        disturbances=tuple(disturbances),
        noise=noise,
        period=done.period,
        gain=gain,
        lag=lag,
        rest=rest,
        sources={names.get(signal, signal): source for signal, source in given.sources.items()},
        table=table.path.name,
        has_reference="reference" in given.sources,
        split=bool(done.gaps),
    )


def _values(table: Table, source: SignalSource) -> FloatArray:
    """The mean of the columns, in their unit, shape (N,)."""
    columns = [source.scale * table.values(title) + source.offset for title in source.places]
    return np.asarray(np.mean(columns, axis=0), dtype=np.float64)


def _signal(
    table: Table, sources: Mapping[str, SignalSource], signal: str, taken: list[str]
) -> tuple[str, str]:
    """Name and unit."""
    title = split_title(sources[signal].places[0])[0]
    title = _ROLES[signal] if title.lower() in _KNOWN and title.lower() != signal else title
    name = _word(title if re.search(r"[a-zA-Z]{3}", title) else signal, taken)
    return name, _unit(table, sources, signal)


def _unit(table: Table, sources: Mapping[str, SignalSource], signal: str) -> str:
    source = sources[signal]
    unit = source.unit or table.unit(source.places[0])
    unit = _OFFSET_UNITS.get(unit.lower(), unit)
    return unit if is_readable(unit) else ""


def _word(title: str, taken: list[str]) -> str:
    """A valid Python name that does not yet occur in the file."""
    text = unicodedata.normalize("NFKC", split_title(title)[0].strip().lower())  # as Python reads names
    plain = "".join(c if f"_{c}".isidentifier() else " " for c in text)
    plain = re.sub(r"[\s_]+", "_", plain).strip("_") or "signal"
    plain = plain if plain.isidentifier() else f"n{plain}"
    own = {*vars(Plant), *Plant.__annotations__, "gain", "lag", "rest", "inner", "seen", "sensor_lag"}
    own |= {"acting", "acting_0", "acting_1", "dead_time", "store", "store_lag", "store_share"}
    while keyword.iskeyword(plain) or plain in taken or plain in own - {"output"}:
        plain += "_"
    taken.append(plain)
    return plain


def _range_of(values: FloatArray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    for least, most in _RANGES:
        if least <= low and high <= most and high > 0.2 * most:
            return least, most
    return _round_out(low, high) if high > low else (low - 1.0, high + 1.0)


def _first_order(
    y: FloatArray, u: FloatArray, others: Sequence[FloatArray], noise: float, period: float
) -> tuple[float, float, float]:
    """Gain, lag (s) and steady-state output of the difference equation; a guess if it has none."""
    span, reach = float(np.ptp(y)) or 1.0, float(np.ptp(u)) or 1.0
    guess = span / reach, 0.1 * y.size * period, float(y[0])
    for block in (2**k for k in range(12)):
        if y.size < 20 * block:
            break
        cut = y.size - y.size % block
        means = [signal[:cut].reshape(-1, block).mean(axis=1) for signal in (y, u, *others)]
        before, after = means[0][:-1], means[0][1:]
        if np.std(after - before) < 5 * noise / math.sqrt(block):
            continue
        table = np.column_stack([np.ones(before.size), before, *(m[:-1] for m in means[1:])])
        slopes = np.linalg.lstsq(table, after - before, rcond=None)[0]
        back = -float(slopes[1])
        if 0.0 < back < 1.0 and abs(slopes[2]) > 0:
            lag = -block * period / math.log1p(-back)
            guess = float(slopes[2]) / back, lag, float(slopes[0]) / back
            break
    return rounded(guess[0]), rounded(guess[1]), rounded(guess[2], 3)


def _without_spikes(values: FloatArray, noise: float) -> FloatArray:
    """Readings with the median of five neighbours where one is far from it."""
    from scipy.ndimage import median_filter  # noqa: PLC0415 (slow to import, used only here)

    middle = median_filter(values, 5, mode="nearest")
    return np.where(np.abs(values - middle) > _SPIKE * noise, middle, values)


def rounded(value: float, digits: int = 2) -> float:
    """To so many digits."""
    return float(f"{value:.{digits}g}")


def _round_out(low: float, high: float) -> tuple[float, float]:
    """Round numbers just outside the range."""
    step = 10.0 ** math.floor(math.log10((high - low) / 2)) if high > low else 1.0
    return math.floor(low / step) * step, math.ceil(high / step) * step
