"""Forecasts, times of arrival and backtests in words, tables and as dictionaries for JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twinmatch.comparing import ahead_words, statements_of
from twinmatch.dynamics import Plant, channels
from twinmatch.forecasting import (
    NEAR,
    Arrival,
    Band,
    Forecast,
    Moment,
    largest_input,
    settling_time,
    time_to_reach,
)
from twinmatch.offline.backtest.scoring import LEADER, TWINS, Backtest, Card
from twinmatch.offline.clock_times import clock_words
from twinmatch.showing.quantities import ShownSignals, number, signal_names
from twinmatch.showing.series import Fan, root_mean_square
from twinmatch.signals import FloatArray
from twinmatch.twin import TwinSettings

if TYPE_CHECKING:
    from rich.table import Table


_MAX_LEVELS: Final = 4
"""With more set-points in a row, only the last is described."""


def forecast_document(forecast: Forecast, plant: type[Plant]) -> dict[str, Any]:
    """A forecast with its bands, sample by sample; every value is a string, number, list or dictionary.

    Of a plant with several outputs or inputs, bands and set-points are lists in the order of the plant file.
    """
    references = forecast.references.T.tolist()
    outputs = [_band(band) for band in forecast.outputs]
    inputs = [_band(band) for band in forecast.inputs]
    return {
        "sample": forecast.sample,
        "candidate": forecast.candidate,
        "structure": forecast.structure,
        "confidence": forecast.confidence,
        "t": forecast.time.tolist(),
        "y": outputs[0] if plant.single else outputs,
        "u": inputs[0] if plant.single else inputs,
        "reference": (references[0] if plant.single else references)
        if forecast.closed
        else None,
        "notes": list(forecast.notes),
    }


def forecast_words(forecast: Forecast, settings: TwinSettings) -> list[str]:
    """The forecast of each output in lines: final output, arrival at each set-point, largest input, widths of
    the band; for prescribed inputs only final output and widths."""
    lines = []
    for k, plant in enumerate(channels(settings.plant)):
        lines += _words_of_output(forecast.alone(k), plant, settings.forecasts.horizons)
    return lines


def _words_of_output(
    forecast: Forecast, plant: type[Plant], horizons: Sequence[float]
) -> list[str]:
    """The forecast of a plant's only output in lines."""
    widths = _widths(forecast, plant, horizons)
    if not forecast.closed:
        return [_end(forecast, plant), widths]
    parts = _parts(forecast)
    if len(parts) > _MAX_LEVELS:
        parts = parts[-1:]
    arrivals = [_arrival(part, plant, only=len(parts) == 1) for part in parts]
    return [_end(forecast, plant), *arrivals, _largest(forecast, plant), widths]


def asked(forecast: Forecast) -> FloatArray:
    """The set-points (or inputs) that the forecast is made for."""
    return forecast.reference if forecast.closed else forecast.input.mean


def levels_words(forecast: Forecast) -> str:
    """The set-points or inputs in order; of more than four, the first and the last."""
    values = asked(forecast)
    levels = [values[0], *values[1:][np.diff(values) != 0]]
    if len(levels) > _MAX_LEVELS:
        return f"{levels[0]:g} … {levels[-1]:g}"
    return " → ".join(f"{level:g}" for level in levels)


def comparison_words(fan: Fan, plant: type[Plant]) -> list[str]:
    """How it compares with the measurements, in one line for each output; empty where there are none to
    compare with."""
    if not fan.judged:
        return []
    return [
        _comparison_of_output(fan.alone(k), alone)
        for k, alone in enumerate(channels(plant))
    ]


def _comparison_of_output(fan: Fan, plant: type[Plant]) -> str:
    """How the forecast of a plant's only output compares with the measurements."""
    signals = signal_names(plant)
    shares = [
        f"{100 * np.mean(inside):.0f} % of the" for inside in fan.in_band if inside.size
    ]
    inside = " and ".join(
        f"{share} {signal}" for share, signal in zip(shares, signals, strict=False)
    )
    moves = "set-points" if fan.forecast.closed else "inputs"
    condition = (
        "" if fan.judged == fan.forecast.time.size else f", under the same {moves}"
    )
    return (
        f"compared with the next {fan.judged * fan.past.period:g} s of measurements{condition}: error "
        f"{signals.output.text(root_mean_square([fan.error]), finer=1)} RMS; the band contained {inside}"
    )


def _band(band: Band) -> dict[str, list[float]]:
    return {
        "mean": band.mean.tolist(),
        "low": band.low.tolist(),
        "high": band.high.tolist(),
    }


def _end(forecast: Forecast, plant: type[Plant]) -> str:
    y = signal_names(plant).output
    band = forecast.output
    low, mean, high = (float(edge[-1]) for edge in (band.low, band.mean, band.high))
    return (
        f"{y.name} after {forecast.time[-1]:g} s: {y.text(mean)}, within {y.text(low, high)} "
        f"in {100 * forecast.confidence:.0f} % of such cases"
    )


def _parts(forecast: Forecast) -> list[Forecast]:
    """The forecast in parts with a constant set-point."""
    steps = np.flatnonzero(np.diff(forecast.reference)) + 1
    ends = [0, *steps.tolist(), forecast.time.size]

    return [_part(forecast, slice(begin, end)) for begin, end in pairwise(ends)]


def _part(forecast: Forecast, samples: slice) -> Forecast:
    output = forecast.output
    input_band = forecast.input
    return replace(
        forecast,
        time=forecast.time[samples],
        references=forecast.reference[samples],
        outputs=(
            Band(output.mean[samples], output.low[samples], output.high[samples]),
        ),
        inputs=(
            Band(
                input_band.mean[samples],
                input_band.low[samples],
                input_band.high[samples],
            ),
        ),
    )


def _arrival(part: Forecast, plant: type[Plant], *, only: bool) -> str:
    """When the output reaches one set-point, and whether it stays there."""
    unit = plant.output.unit
    level = float(part.reference[0])
    near = NEAR * plant.output.noise
    goal = f"within {f'{near:g} {unit}'.rstrip()} of {f'{level:g} {unit}'.rstrip()}"
    if not only:
        goal += f" (set-point from {part.time[0]:g} to {part.time[-1]:g} s)"
    reached = time_to_reach(part, level, near)
    settled = settling_time(part, level, near)
    if reached.expected is None:
        edge = reached.earliest
        best = "" if edge is None else f"; at the edge of the band after {edge:g} s"
        return f"{goal}: not in that time{best}"
    if reached.expected == settled.expected == part.time[0]:
        further = (
            ""
            if settled.latest == settled.expected
            else ", though the band reaches further"
        )
        return f"{goal}: all the time{further}"
    afterwards = "but it does not stay there"
    if settled.expected is not None:
        stays = settled.expected == reached.expected
        afterwards = (
            "and it stays there"
            if stays
            else f"permanently after {settled.expected:g} s{_range(settled)}"
        )
    return f"{goal}: first after {reached.expected:g} s{_range(reached)}, {afterwards}"


def _largest(forecast: Forecast, plant: type[Plant]) -> str:
    u = signal_names(plant).input
    peak = largest_input(forecast)
    least, most = (number(edge, u.decimals) for edge in (peak.least, peak.most))
    return f"largest {u.name}: {u.text(peak.expected)} after {peak.time:g} s ({least} to {most})"


def _widths(forecast: Forecast, plant: type[Plant], horizons: Sequence[float]) -> str:
    signals = signal_names(plant)
    widths = []

    def width(k: int) -> str:
        y, u = (
            float(band.high[k] - band.low[k])
            for band in (forecast.output, forecast.input)
        )
        both = f"{signals.output.text(y)} and {signals.input.text(u)}"
        return both if forecast.closed else signals.output.text(y)

    for horizon in horizons:
        if horizon > forecast.time[-1] + 1e-9 * horizon or horizon < forecast.time[0]:
            continue
        k = int((forecast.time <= horizon * (1 + 1e-9)).sum()) - 1
        widths.append(f"{width(k)} at {horizon:g} s")
    if not widths:
        y = float(forecast.output.high[-1] - forecast.output.low[-1])
        widths.append(f"{signals.output.text(y)} at the end")
    return f"width of the band: {'; '.join(widths)}"


def _range(moment: Moment) -> str:
    """The earliest and latest time in brackets."""
    first = "0" if moment.earliest is None else f"{moment.earliest:g}"
    return (
        f" ({first} to {moment.latest:g})"
        if moment.latest is not None
        else f" ({first} or later)"
    )


def _short_names(signals: ShownSignals) -> tuple[str, str]:
    """Output and input in headings: by their units, or by their names where both have the same unit."""
    output, entry = signals
    if output.unit == entry.unit:
        return output.name, entry.name
    return output.unit or output.name, entry.unit or entry.name


def _short_units(signals: ShownSignals) -> tuple[str, str]:
    """What values of output and input are in, in headings; with their names where both have the same unit."""
    output, entry = signals
    if output.unit == entry.unit:
        return output.label, entry.label
    return f"/ {output.unit or output.name}", f"/ {entry.unit or entry.name}"


def card_columns(
    plant: type[Plant], *, driven: bool = False
) -> list[tuple[str, Callable[[Card], str]]]:
    """Name and text of one forecaster's figures, those of inputs left out if they were given (`driven`).

    Ends and widths are in the plant's units, the others in units of its noise.
    """
    w = signal_names(plant)
    y = plant.output
    u = plant.drive
    of_output, of_input = _short_names(w)
    in_output, in_input = _short_units(w)
    columns: list[tuple[str, Callable[[Card], str]]] = [
        ("who", lambda c: c.who),
        ("error", lambda c: number(c.median)),
        ("9 in 10", lambda c: number(c.nine_in_ten)),
        ("× best", lambda c: number(c.ratio)),
        (f"end {in_output}", lambda c: number(c.end_output * y.noise, y.decimals + 1)),
        (f"end {in_input}", lambda c: number(c.end_input * u.noise, u.decimals + 1)),
        (f"held {of_output}", lambda c: _share(c.coverage_output)),
        (f"held {of_input}", lambda c: _share(c.coverage_input)),
        (
            f"width {in_output}",
            lambda c: number(c.width_output * y.noise, y.decimals + 1),
        ),
        (
            f"width {in_input}",
            lambda c: number(c.width_input * u.noise, u.decimals + 1),
        ),
        ("score", lambda c: number(c.score, 1)),
    ]
    return [
        column for k, column in enumerate(columns) if not (driven and k in _OF_INPUT)
    ]


def _share(share: float) -> str:
    """In per cent; a dash without a band."""
    return "–" if math.isnan(share) else f"{number(100 * share, 0)} %"


_OF_INPUT: Final = (5, 7, 9)
"""Columns of figures of the input."""


def backtest_tables(backtest: Backtest) -> list[Table]:
    """One table for each horizon with scored forecasts."""
    from rich.table import Table  # noqa: PLC0415

    tables = []
    columns = card_columns(backtest.plant, driven=backtest.driven)
    for horizon, cards in backtest.at_horizons.items():
        title = f"{backtest.name}: {horizon:g} s ahead, {cards[0].count} forecasts"
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        for k, (name, _) in enumerate(columns):
            table.add_column(name, justify="right" if k else "left", no_wrap=True)
        for card in cards:
            table.add_row(*(text(card) for _, text in columns), style=_style(card.who))
        tables.append(table)
    return tables


def _style(forecaster: str) -> str:
    if forecaster == LEADER:
        return "bold"
    return "" if forecaster in TWINS else "dim"


def backtest_words(backtest: Backtest) -> list[str]:
    """Sentences on the leader's results, one for each horizon."""
    w = signal_names(backtest.plant)
    noise = backtest.plant.output.noise
    sentences = []
    for horizon, cards in backtest.at_horizons.items():
        card_of_leader = next((card for card in cards if card.who == LEADER), None)
        if card_of_leader is None:
            continue
        error = w.output.text(card_of_leader.end_output * noise, finer=1)
        share = f"{100 * card_of_leader.coverage_output:.0f} % of the readings"
        sentences.append(
            f"{horizon:g} s ahead, the leader's {w.output} was off by less than {error} half of the time, "
            f"and its band held {share} ({100 * backtest.confidence:.0f} % expected)."
        )
    return [*sentences, *_trust(backtest)]


def _trust(backtest: Backtest) -> Iterator[str]:
    """What the last verdict says of the leader's forecasts, of several outputs of this one, by horizon."""
    last = backtest.last
    name, *_ = backtest.plant.outputs
    if last is not None and last.leader is not None:
        trust = statements_of(last).trust
        forecasts = "they"
        if backtest.plant.channel_of is not None:
            of_output = next(
                score.trusted for score in last.signals if score.signal == name
            )
            trust = trust._replace(horizons=of_output, doubts="")
            forecasts = f"the forecasts of {signal_names(backtest.plant).output}"
        why = f": {trust.doubts}" if trust.doubts else ""
        yield f"At the end {forecasts} pass the test of trust {ahead_words(trust.horizons)}{why}."


def arrival_words(
    answer: Arrival, plant: type[Plant], stamp: int, *, closed: bool
) -> list[str]:
    """The answer in lines; `stamp` is that of the newest sample, ns, and `closed` says whether the loop is
    known."""
    unit = plant.output.unit if closed else plant.drive.unit
    kind = "set-point" if closed else "input"
    goal = _amount(answer.level, plant.output.unit)
    held = f"{kind} of {_amount(answer.standing, unit)} held"
    lines = [f"{goal}: {_when(answer.held, answer.looked, stamp)} with its {held}"]
    if answer.move != answer.standing:
        moved = _when(answer.moved, answer.looked, stamp)
        lines.append(f"{goal}: {moved} with {_amount(answer.move, unit)} from now on")
    if answer.beginning is None or answer.by is None:
        return lines
    target = _time(answer.by, stamp)
    begin = f"give {_amount(answer.move, unit)}"
    if answer.beginning.safe is not None and answer.beginning.expected is not None:
        mean = _time(answer.beginning.expected, stamp)
        lines.append(
            f"to be there {target}: {begin} {_time(answer.beginning.safe, stamp)}; {mean} in the mean"
        )
    elif answer.beginning.expected is not None:
        mean = _time(answer.beginning.expected, stamp)
        lines.append(
            f"to be there {target}: {begin} at once; {mean} in the mean, but the band may arrive later"
        )
    else:
        lines.append(
            f"not there {target}, even with {_amount(answer.move, unit)} from now on"
        )
    return lines


def arrival_document(answer: Arrival) -> dict[str, Any]:
    """All of it for JSON."""
    return asdict(answer) | {"notes": list(answer.notes)}


def _when(moment: Moment, looked: float, stamp: int) -> str:
    if moment.expected is None:
        if moment.earliest is None:
            return f"not within {looked:g} s"
        soonest = _time(moment.earliest, stamp)
        return f"not within {looked:g} s by the mean, by the band {soonest} at the earliest"
    latest = "later" if moment.latest is None else f"{moment.latest:g}"
    earliest = moment.expected if moment.earliest is None else moment.earliest
    return f"first {_time(moment.expected, stamp)} ({earliest:g} to {latest} s)"


def _time(seconds: float, stamp: int) -> str:
    clock = clock_words(stamp, seconds)
    return f"after {seconds:g} s" + (f", at {clock}" if clock else "")


def _amount(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".rstrip()
