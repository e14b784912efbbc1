"""What became of trying a controller, in lines and as a dictionary for JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from twinmatch.controllers import (
    ControllerAnswer,
    CourseFigure,
    Guarantee,
    LawComparison,
    MemberStability,
    NextExperiment,
    Retuned,
    Spread,
    levels_words,
)
from twinmatch.dynamics import Plant

MAX_LIMITED: Final = 20.0
"""Share of the time at a limit, %, from which gains hardly matter."""


def answer_words(answer: ControllerAnswer) -> list[str]:
    """The answer in lines: the decision first, then stability, margins, what happens, and reservations."""
    lines = [answer.sentence]
    if answer.stability:
        points = "; ".join(levels_words(answer.plant, point) for point in answer.points)
        lines.append(f"stability at {points}:")
        lines += [f"  {line}" for line in _stability_words(answer)]
    if answer.guarantee is not None:
        lines.append(guarantee_words(answer.guarantee, answer.plant))
    beside = "" if answer.running is None else "; beside it the law that ran"
    lines.append(f"over {answer.time[-1]:g} s, median and 90 % band{beside}:")
    ran = {} if answer.running is None else answer.running.figures
    lines += [f"  {_figure_words(q, s, ran.get(q))}" for q, s in answer.courses.figures.items() if _known(s)]
    return lines + [f"Note: {note}" for note in answer.notes]


def comparison_words(found: LawComparison) -> str:
    """Predicted and measured cost, and the rest of what a session has shown of an answer, in one sentence."""
    band = f"{found.median:.3g} {found.unit} ({found.low:.3g} to {found.high:.3g})"
    held = "stable" if found.stable else "unstable or beyond the safe range"
    said = {None: "undecided before", True: "as predicted", False: "not as predicted"}[found.as_said]
    return (
        f"{found.name}: predicted cost {band}, measured {found.measured:.3g} {found.unit}: "
        f"{'inside' if found.inside else 'outside'}; {100 * found.share:.0f} % of the readings lay in their "
        f"bands; {held}, {said}; largest error {found.error:.3g}, predicted {found.predicted_error:.3g} "
        f"{found.unit.removesuffix('²')}"
    )


def comparison_document(found: LawComparison) -> dict[str, Any]:
    """All of it for JSON."""
    values = {key: _finite(v) if isinstance(v, float) else v for key, v in asdict(found).items()}
    return values | {"inside": found.inside, "as_said": found.as_said, "half_widths": _finite(found.off)}


def retuned_words(found: Retuned, answer: ControllerAnswer) -> list[str]:
    """Old and new gains with their M_s, why, and what tuning cannot change, in lines."""
    lines = [found.reason]
    for name in ("proportional", "integral", "derivative"):
        before = getattr(found.before, name)
        after = getattr(found.after, name)
        lines.append(f"  {name}: {before:.4g} → {after:.4g}")
    lines.append(f"  largest M_s: {found.sensitivities[0]:.2f} → {found.sensitivities[1]:.2f}")
    limited = [s.median for q, s in answer.courses.figures.items() if q.name == "time at a limit"]
    if max(limited, default=0.0) > MAX_LIMITED:
        lines.append(f"  the drive is at a limit {max(limited):.0f} % of the time: tuning is not the trouble")
    return lines


def experiment_words(found: NextExperiment) -> list[str]:
    """The course in one sentence, then what it brings beside others of its length."""
    plant = found.leader.parameters.model.plant
    rows = found.course.rows
    period = found.terms.holding.period
    signals = plant.drives if found.terms.holding.law is None else plant.outputs
    changes = [0, *(np.flatnonzero(np.any(np.diff(rows, axis=0), axis=1)) + 1)]
    plan = [
        ", ".join(f"{name} {v:.4g} {s.unit}" for (name, s), v in zip(signals.items(), rows[k], strict=True))
        + f" for {period * (end - k):.4g} s"
        for k, end in zip(changes, [*changes[1:], len(rows)], strict=True)
    ]
    brings = f"{found.course.characters:.3g} characters for {found.goal.name}"
    lines = [f"hold {', then '.join(plan)}: after {period * len(rows):.4g} s, {brings} are expected"]
    for one in (found.course, *found.others):
        spreads = zip(found.leader.free, one.spreads.tolist(), strict=False)
        known = ", ".join(f"{name} ± {spread:.2g}" for name, spread in spreads)
        left = "" if one.within else "; leaves the range"
        lines.append(f"  {one.name}: {one.characters:.3g} characters; {known}{left}")
    return lines


def experiment_document(found: NextExperiment) -> dict[str, Any]:
    """The course and the others beside it for JSON."""
    return {
        "goal": found.goal.name,
        "contenders": [contender.twin.name for contender in found.goal.contenders],
        "period": found.terms.holding.period,
        "planned": "inputs" if found.terms.holding.law is None else "set-points",
        "most": found.most,
        "courses": [
            {
                "name": one.name,
                "levels": one.rows.T.tolist(),
                "characters": one.characters,
                "within": one.within,
                "spreads": dict(zip(found.leader.free, one.spreads.tolist(), strict=False)),
            }
            for one in (found.course, *found.others)
        ],
    }


def guarantee_words(found: Guarantee, plant: type[Plant]) -> str:
    """What the theorem guarantees, and its premises, in one sentence."""
    units = zip((*plant.outputs, *plant.drives), (*found.scaling.outputs, *found.scaling.inputs), strict=True)
    scaled = ", ".join(f"{name} {value:.3g}" for name, value in units)
    gap = max(found.scaling.gap, found.drawn)
    held = (
        f"b = {found.scaling.margin:.2f} against a largest ν-gap of {gap:.2f} between {found.plants} plants"
    )
    origin = f"{found.member} at {levels_words(plant, found.point)}"
    if not found.holds:
        return f"not guaranteed: {held}, from {origin} (units: {scaled})"
    return (
        f"guaranteed for every linear plant within a ν-gap of {found.scaling.margin:.2f} of {origin}: "
        f"{held}; for small movements within the limits of the drives (units: {scaled})"
    )


def _stability_words(answer: ControllerAnswer) -> list[str]:
    worst = max(answer.stability, key=lambda one: one.eigenvalue)
    draws = sum(one.eigenvalues.size for one in answer.stability)
    unstable = sum(int(np.sum(one.eigenvalues >= 1.0)) for one in answer.stability)
    where = levels_words(answer.plant, worst.point)
    lines = [
        f"largest eigenvalue {worst.eigenvalue:.5f}, of {worst.member.name} at {where}; "
        f"{unstable} of {draws} draws unstable"
    ]
    if worst.eigenvalue >= 1.0:
        return lines
    for i, drive in enumerate(answer.plant.drives):
        margins = [one.margins[i] for one in answer.stability]
        gain = min(m.gain_change for m in margins)
        delay = min(m.delay for m in margins)
        lines.append(
            f"{drive}: unstable from {_or_never(gain, 'times', 'or 1/')} the gain, from "
            f"{_or_never(delay, 's')} more dead time; maximum sensitivity "
            f"{max(m.sensitivity for m in margins):.2f}"
        )
    return lines


def _or_never(value: float, unit: str, other: str = "") -> str:
    if math.isinf(value):
        return f"no {unit}"
    return f"{value:.2f} {unit}" + (f" ({other}{value:.2f})" if other else "")


def _known(spread: Spread) -> bool:
    return not math.isnan(spread.median)


def _figure_words(quantity: CourseFigure, spread: Spread, ran: Spread | None) -> str:
    signal = f" of {quantity.signal}" if quantity.signal else ""
    beside = "" if ran is None else f"; ran: {_spread_words(ran)}"
    return f"{quantity.name}{signal}: {_spread_words(spread)} {quantity.unit}{beside}".replace(" ;", ";")


def _spread_words(spread: Spread) -> str:
    low, median, high = (f"{v:.3g}".replace("inf", "∞") for v in spread)
    return f"{median} ({low} to {high})"


def answer_document(answer: ControllerAnswer) -> dict[str, Any]:
    """The answer with all figures and bands; every value is a string, number, list, dictionary or None."""
    found = answer.guarantee
    return {
        "decision": answer.decision.value,
        "sentence": answer.sentence,
        "twins": [_member_document(one) for one in answer.stability],
        "points": [list(point) for point in answer.points],
        "hangs_on": None
        if answer.question is None
        else {name: getattr(answer.question, name) for name in ("parameter", "drive", "step")},
        "guarantee": None
        if found is None
        else {
            "holds": found.holds,
            "twin": found.member,
            "point": list(found.point),
            "margin": found.scaling.margin,
            "gap": found.scaling.gap,
            "gap_of_draws": found.drawn,
            "output_units": found.scaling.outputs.tolist(),
            "input_units": found.scaling.inputs.tolist(),
        },
        "widening": answer.widening,
        "figures": _figures_document(answer.courses.figures),
        "figures_of_law_that_ran": None
        if answer.running is None
        else _figures_document(answer.running.figures),
        "t": answer.time.tolist(),
        "references": answer.references.T.tolist(),
        "outputs": _bands_document(answer.courses.outputs),
        "inputs": _bands_document(answer.courses.inputs),
        "notes": list(answer.notes),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _member_document(one: MemberStability) -> dict[str, Any]:
    return {
        "name": one.member.name,
        "structure": one.member.parameters.model.structure_name,
        "eigenvalue": _finite(one.eigenvalue),
        "point": list(one.point),
        "unstable": one.unstable,
        "draws": int(one.eigenvalues.size),
        "margins": [{key: _finite(v) for key, v in margin._asdict().items()} for margin in one.margins],
        "sensitivity": _finite(one.sensitivity),
    }


def _figures_document(figures: Any) -> list[dict[str, Any]]:
    return [
        {"name": q.name, "signal": q.signal, "unit": q.unit}
        | {key: _finite(value) for key, value in spread._asdict().items()}
        for q, spread in figures.items()
    ]


def _bands_document(bands: Any) -> list[dict[str, Any]]:
    """One per signal, from rows of low, median and high."""
    safe = np.where(np.isfinite(bands), bands, 0.0)
    return [
        dict(zip(("low", "median", "high"), safe[:, :, j].tolist(), strict=True))
        for j in range(bands.shape[2])
    ]
