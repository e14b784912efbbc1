"""Pictures of a judged session, drawn with matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twinmatch.discrimination import CandidateScore, TrustLevel, Verdict
from twinmatch.errors import TwinmatchError
from twinmatch.plant import simulate_window
from twinmatch.signals import Sample, Window, unbroken
from twinmatch.twin import TwinSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_verdict"]

_COLOURS = {
    TrustLevel.UNKNOWN: "#9e9e9e",
    TrustLevel.TRUSTED: "#2e7d32",
    TrustLevel.DOUBTFUL: "#f9a825",
    TrustLevel.FAULT: "#c62828",
}
_PLANT, _TWIN, _SET_POINT = "#1565c0", "#ef6c00", "#616161"


def draw_verdict(
    samples: Sequence[Sample], verdicts: Sequence[Verdict], settings: TwinSettings, path: Path
) -> None:
    """Plant and nominal twin, trust over time, the criteria and the ν-gap matrix, on one page.

    Raises:
        TwinmatchError: matplotlib cannot write such a file there.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 — slow, and not everybody draws

    figure = Figure(figsize=(12, 9), layout="constrained")
    grid = figure.add_gridspec(4, 2, height_ratios=(3, 2, 0.35, 3))
    temperature = figure.add_subplot(grid[0, :])
    control = figure.add_subplot(grid[1, :], sharex=temperature)
    trust = figure.add_subplot(grid[2, :], sharex=temperature)
    last = verdicts[-1] if verdicts else None
    for number, stretch in enumerate(unbroken(samples)):
        window = Window.from_samples(stretch, settings.period)
        _draw_signals(temperature, control, window, _nominal(last), settings, label=number == 0)
    _dress(temperature, control, _nominal(last))
    _draw_trust(trust, verdicts, settings.period)
    if last is not None and last.candidates:
        _draw_gains(figure.add_subplot(grid[3, 0]), last)
        _draw_matrix(figure.add_subplot(grid[3, 1]), last)
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        msg = f"{path}: the figure cannot be written: {error}"
        raise TwinmatchError(msg) from error


def _draw_signals(
    temperature: Axes,
    control: Axes,
    window: Window,
    nominal: CandidateScore | None,
    settings: TwinSettings,
    *,
    label: bool,
) -> None:
    """One unbroken stretch of plant and twin."""
    time, hidden = window.time, "_"  # matplotlib leaves such labels out of the legend
    names = ("set-point", "plant") if label else (hidden, hidden)
    temperature.plot(time, window.reference, color=_SET_POINT, lw=1, ls="--", label=names[0])
    temperature.plot(time, window.temperature, color=_PLANT, lw=1.2, label=names[1])
    control.plot(time, window.pwm, color=_PLANT, lw=0.9)
    if nominal is None or len(window) < 4:
        return
    twin = simulate_window(nominal.parameters, window, gains=settings.gains)
    name = f"twin of {nominal.name}" if label else hidden
    temperature.plot(time[2:], twin.temperature, color=_TWIN, lw=1, label=name)
    control.plot(time[2:], twin.pwm, color=_TWIN, lw=0.8)


def _dress(temperature: Axes, control: Axes, nominal: CandidateScore | None) -> None:
    if nominal is not None:
        temperature.set_title(f"Nominal: {nominal.name}, order {nominal.chosen_order}", loc="left")
    temperature.set_ylabel("temperature / °C")
    temperature.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8, frameon=False)
    control.set_ylabel("control / PWM")
    for axes in (temperature, control):
        axes.grid(alpha=0.25)
        axes.tick_params(labelbottom=False)


def _draw_trust(axes: Axes, verdicts: Sequence[Verdict], period: float) -> None:
    since = 0
    for verdict in verdicts:
        axes.axvspan(since * period, verdict.sample * period, color=_COLOURS[verdict.level], lw=0)
        since = verdict.sample
        if not verdict.stands:
            axes.axvline(verdict.sample * period, color="black", lw=0.6)
    axes.set_yticks([])
    axes.set_ylabel("trust", rotation=0, ha="right", va="center")
    axes.set_xlabel(
        "time / s     (grey unknown, green trusted, yellow doubtful, red fault; a line: newly judged)"
    )


def _draw_gains(axes: Axes, verdict: Verdict) -> None:
    orders = [o.order for o in verdict.candidates[0].orders]
    places = np.arange(len(verdict.candidates))
    width = 0.8 / len(orders)
    for k, order in enumerate(orders):
        gains = [c.orders[k].total.gain for c in verdict.candidates]
        bars = axes.bar(places + (k - (len(orders) - 1) / 2) * width, gains, width, label=order)
        for bar, candidate in zip(bars, verdict.candidates, strict=True):
            if candidate.chosen_order == order:
                bar.set_edgecolor("black")
                bar.set_linewidth(1.5)
    axes.set_xticks(places, [c.name for c in verdict.candidates], fontsize=8)
    axes.set_ylabel("information gain / characters")
    axes.set_title("Family and orders (framed: chosen)", loc="left", fontsize=10)
    axes.legend(fontsize=8, ncols=4, loc="upper left")
    axes.margins(y=0.2)
    axes.grid(axis="y", alpha=0.25)


def _draw_matrix(axes: Axes, verdict: Verdict) -> None:
    matrix = np.array(verdict.nu_gap)
    names = [c.name for c in verdict.candidates]
    image: Any = axes.imshow(matrix, cmap="viridis_r", vmin=0, vmax=max(float(matrix.max()), 1e-12))
    for i, j in np.ndindex(*matrix.shape):
        colour = "white" if matrix[i, j] > 0.6 * matrix.max() else "black"
        axes.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=8, color=colour)
    sums = [f"{c.name}\nΣ {c.nu_gap_sum:.2f}" for c in verdict.candidates]
    axes.set_xticks(range(len(names)), sums, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.set_title("ν-gap in the family (smallest Σ: nominal)", loc="left", fontsize=10)
    axes.figure.colorbar(image, ax=axes, shrink=0.8)


def _nominal(verdict: Verdict | None) -> CandidateScore | None:
    if verdict is None:
        return None
    return next((c for c in verdict.candidates if c.name == verdict.nominal), None)
