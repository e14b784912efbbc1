"""What became of trying a controller, in lines and as a dictionary for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator
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
from twinmatch.controllers.whole_loop import ChannelMargins
from twinmatch.dynamics import Plant
from twinmatch.showing.quantities import shown_inputs, shown_outputs

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
    lines += [
        f"  {_figure_words(q, s, ran.get(q))}"
        for q, s in answer.courses.figures.items()
        if _known(s)
    ]
    return lines + [f"Note: {note}" for note in answer.notes]


def comparison_words(comparison: LawComparison) -> str:
    """Predicted and measured cost, and the rest of what a session has shown of an answer, in one sentence."""
    band = f"{comparison.median:.3g} {comparison.unit} ({comparison.low:.3g} to {comparison.high:.3g})"
    place = "inside" if comparison.inside else "outside"
    stability = "stable" if comparison.stable else "unstable or beyond the safe range"
    prediction = {
        None: "undecided before",
        True: "as predicted",
        False: "not as predicted",
    }[comparison.as_said]
    return (
        f"{comparison.name}: predicted cost {band}, measured {comparison.measured:.3g} {comparison.unit}: "
        f"{place}; {100 * comparison.share:.0f} % of the readings lay in their bands; {stability}, "
        f"{prediction}; largest error {comparison.error:.3g}, predicted {comparison.predicted_error:.3g} "
        f"{comparison.unit.removesuffix('²')}"
    )


def comparison_document(comparison: LawComparison) -> dict[str, Any]:
    """All of it for JSON."""
    values = {
        key: _finite(v) if isinstance(v, float) else v
        for key, v in asdict(comparison).items()
    }
    return values | {
        "inside": comparison.inside,
        "as_said": comparison.as_said,
        "half_widths": _finite(comparison.off),
    }


def retuned_words(retuned: Retuned, answer: ControllerAnswer) -> list[str]:
    """Old and new gains with their M_s, why, and what tuning cannot change, in lines."""
    lines = [retuned.reason]
    for name in ("proportional", "integral", "derivative"):
        before = getattr(retuned.before, name)
        after = getattr(retuned.after, name)
        lines.append(f"  {name}: {before:.4g} → {after:.4g}")
    lines.append(
        f"  largest M_s: {retuned.sensitivities[0]:.2f} → {retuned.sensitivities[1]:.2f}"
    )
    limited = [
        s.median
        for q, s in answer.courses.figures.items()
        if q.name == "time at a limit"
    ]
    if max(limited, default=0.0) > MAX_LIMITED:
        lines.append(
            f"  the drive is at a limit {max(limited):.0f} % of the time: tuning is not the trouble"
        )
    return lines


def experiment_words(experiment: NextExperiment) -> list[str]:
    """The course in one sentence, then what it brings beside others of its length."""
    period = experiment.terms.holding.period
    rows = experiment.course.rows
    brings = f"{experiment.course.bits:.3g} bits for {experiment.goal.name}"
    plan = ", then ".join(_held_levels(experiment))
    lines = [f"hold {plan}: after {period * len(rows):.4g} s, {brings} are expected"]
    for course in (experiment.course, *experiment.others):
        spreads = zip(experiment.leader.free, course.spreads.tolist(), strict=False)
        listed = ", ".join(f"{name} ± {spread:.2g}" for name, spread in spreads)
        warning = "" if course.within else "; leaves the range"
        lines.append(f"  {course.name}: {course.bits:.3g} bits; {listed}{warning}")
    return lines


def _held_levels(experiment: NextExperiment) -> Iterator[str]:
    """The levels of the course, and for how long each of them is held."""
    plant = experiment.leader.parameters.model.plant
    rows = experiment.course.rows
    holding = experiment.terms.holding
    signals = shown_inputs(plant) if holding.law is None else shown_outputs(plant)
    changes = [0, *(np.flatnonzero(np.any(np.diff(rows, axis=0), axis=1)) + 1)]
    for begin, end in zip(changes, [*changes[1:], len(rows)], strict=True):
        levels = ", ".join(
            f"{signal.name} {level:.4g} {signal.unit}".rstrip()
            for signal, level in zip(signals, rows[begin], strict=True)
        )
        yield f"{levels} for {holding.period * (end - begin):.4g} s"


def experiment_document(experiment: NextExperiment) -> dict[str, Any]:
    """The course and the others beside it for JSON."""
    return {
        "goal": experiment.goal.name,
        "contenders": [contender.twin.name for contender in experiment.goal.contenders],
        "period": experiment.terms.holding.period,
        "planned": "inputs" if experiment.terms.holding.law is None else "set-points",
        "most": experiment.most,
        "courses": [
            {
                "name": course.name,
                "levels": course.rows.T.tolist(),
                "bits": course.bits,
                "within": course.within,
                "spreads": dict(
                    zip(experiment.leader.free, course.spreads.tolist(), strict=False)
                ),
            }
            for course in (experiment.course, *experiment.others)
        ],
    }


def guarantee_words(guarantee: Guarantee, plant: type[Plant]) -> str:
    """What the theorem guarantees, and its premises, in one sentence."""
    units = zip(
        (*plant.outputs, *plant.drives),
        (*guarantee.scaling.outputs, *guarantee.scaling.inputs),
        strict=True,
    )
    scaled = ", ".join(f"{name} {value:.3g}" for name, value in units)
    gap = max(guarantee.scaling.gap, guarantee.drawn)
    margin = guarantee.scaling.margin
    gaps = f"b = {margin:.2f} against a largest ν-gap of {gap:.2f} between {guarantee.plants} plants"
    origin = f"{guarantee.member} at {levels_words(plant, guarantee.point)}"
    if not guarantee.holds:
        return f"not guaranteed: {gaps}, from {origin} (units: {scaled})"
    return (
        f"guaranteed for every linear plant within a ν-gap of {margin:.2f} of {origin}: "
        f"{gaps}; for small movements within the limits of the drives (units: {scaled})"
    )


def _stability_words(answer: ControllerAnswer) -> list[str]:
    worst = max(answer.stability, key=lambda stability: stability.eigenvalue)
    draws = sum(stability.eigenvalues.size for stability in answer.stability)
    unstable = sum(
        int(np.sum(stability.eigenvalues >= 1.0)) for stability in answer.stability
    )
    where = levels_words(answer.plant, worst.point)
    lines = [
        f"largest eigenvalue {worst.eigenvalue:.5f}, of {worst.member.name} at {where}; "
        f"{unstable} of {draws} draws unstable"
    ]
    if worst.eigenvalue >= 1.0:
        return lines
    for i, drive in enumerate(answer.plant.drives):
        margins = [stability.margins[i] for stability in answer.stability]
        gain = min(m.gain_change for m in margins)
        delay = min(m.delay for m in margins)
        lines.append(
            f"{drive}: unstable from {_or_never(gain, 'times', 'or 1/')} the gain, from "
            f"{_or_never(delay, 's')} more dead time; maximum sensitivity "
            f"{max(m.sensitivity for m in margins):.2f}"
        )
    return lines


def _or_never(value: float, unit: str, reciprocal: str = "") -> str:
    if math.isinf(value):
        return f"no {unit}"
    return f"{value:.2f} {unit}" + (f" ({reciprocal}{value:.2f})" if reciprocal else "")


def _known(spread: Spread) -> bool:
    return not math.isnan(spread.median)


def _figure_words(quantity: CourseFigure, spread: Spread, ran: Spread | None) -> str:
    signal = f" of {quantity.signal}" if quantity.signal else ""
    beside = "" if ran is None else f"; ran: {_spread_words(ran)}"
    return f"{quantity.name}{signal}: {_spread_words(spread)} {quantity.unit}{beside}".replace(
        " ;", ";"
    )


def _spread_words(spread: Spread) -> str:
    low, median, high = (f"{v:.3g}".replace("inf", "∞") for v in spread)
    return f"{median} ({low} to {high})"


def answer_document(answer: ControllerAnswer) -> dict[str, Any]:
    """The answer with all figures and bands; every value is a string, number, list, dictionary or None."""
    guarantee = answer.guarantee
    return {
        "decision": answer.decision.value,
        "sentence": answer.sentence,
        "twins": [_member_document(stability) for stability in answer.stability],
        "points": [list(point) for point in answer.points],
        "hangs_on": None
        if answer.question is None
        else {
            name: getattr(answer.question, name)
            for name in ("parameter", "drive", "step")
        },
        "guarantee": None
        if guarantee is None
        else {
            "holds": guarantee.holds,
            "twin": guarantee.member,
            "point": list(guarantee.point),
            "margin": guarantee.scaling.margin,
            "gap": guarantee.scaling.gap,
            "gap_of_draws": guarantee.drawn,
            "output_units": guarantee.scaling.outputs.tolist(),
            "input_units": guarantee.scaling.inputs.tolist(),
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


def _margin_document(margin: ChannelMargins) -> dict[str, Any]:
    return {key: _finite(value) for key, value in margin._asdict().items()}


def _member_document(stability: MemberStability) -> dict[str, Any]:
    return {
        "name": stability.member.name,
        "structure": stability.member.parameters.model.structure_name,
        "eigenvalue": _finite(stability.eigenvalue),
        "point": list(stability.point),
        "unstable": stability.unstable,
        "draws": int(stability.eigenvalues.size),
        "margins": list(map(_margin_document, stability.margins)),
        "sensitivity": _finite(stability.sensitivity),
    }


def _figures_document(figures: Any) -> list[dict[str, Any]]:
    documents = []
    for q, spread in figures.items():
        values = {key: _finite(value) for key, value in spread._asdict().items()}
        documents.append({"name": q.name, "signal": q.signal, "unit": q.unit} | values)
    return documents


def _bands_document(bands: Any) -> list[dict[str, Any]]:
    """One per signal, from rows of low, median and high."""
    safe = np.where(np.isfinite(bands), bands, 0.0)
    return [
        dict(zip(("low", "median", "high"), safe[:, :, j].tolist(), strict=True))
        for j in range(bands.shape[2])
    ]
