"""The result of a session in sentences, for readers who were not there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from twinmatch.comparing import CandidateScore, TrustLevel, Verdict, number_list
from twinmatch.offline.judging import Judgement
from twinmatch.offline.summary import ShownTwin, nominal_score, shown_twin
from twinmatch.showing.quantities import (
    ShownSignal,
    number,
    outputs_unit,
    percent,
    shown_inputs,
    shown_outputs,
)
from twinmatch.showing.series import compare, root_mean_square
from twinmatch.showing.summary import fault_spans, trust_words
from twinmatch.showing.verdicts import admitted, last_verdict
from twinmatch.signals import Sample, Signals
from twinmatch.twin import TwinSettings
from twinmatch.twin.schedule import Movements


def duration(seconds: float) -> str:
    """A duration in h, min and s."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.3g} s"
    hours, seconds_in_hour = divmod(whole, 3600)
    minutes, rest_seconds = divmod(seconds_in_hour, 60)
    parts = [(hours, "h"), (minutes, "min"), (rest_seconds, "s")]
    return " ".join(f"{value} {unit}" for value, unit in parts if value)


def session_facts(judgement: Judgement) -> list[tuple[str, str]]:
    """The session in numbers: pairs of name and value."""
    samples = judgement.samples
    settings = judgement.settings
    outputs = shown_outputs(settings.plant)
    inputs = shown_inputs(settings.plant)
    closed = settings.law is not None
    of_output = [f" of {y}" for y in outputs] if outputs[1:] else [""]
    facts = [
        ("samples", f"{len(samples)}, one every {settings.period:g} s"),
        ("duration", _duration(judgement)),
    ]
    if closed:
        for k, y in enumerate(outputs[: len(samples[0].references)]):
            facts.append(
                (
                    f"set-point{of_output[k]}",
                    y.text(*_ends(s.references[k] for s in samples)),
                )
            )
    for k, y in enumerate(outputs):
        facts.append((y.name, y.text(*_ends(s.outputs[k] for s in samples))))
    for k, (u, drive) in enumerate(
        zip(inputs, settings.plant.drives.values(), strict=True)
    ):
        reached = u.text(*_ends(s.inputs[k] for s in samples))
        limits = " to ".join(number(edge, u.decimals) for edge in drive.limits)
        facts.append((u.name, f"{reached} (limits {limits})"))
    facts.append(
        ("set-point steps" if closed else "control steps", _steps(samples, settings))
    )
    facts.append(("matches", _matches(judgement)))
    identified = judgement.summary.identified
    facts.append(
        (
            "verdicts",
            f"{len(judgement.verdicts)}, of which {identified} identified models",
        )
    )
    shown = shown_twin(judgement.verdicts[-1] if judgement.verdicts else None)
    if shown is not None:
        facts += _fit_facts(judgement, shown)
    return facts


def _ends(values: Iterable[float]) -> tuple[float, float]:
    """The least and the greatest of some values."""
    all_values = list(values)
    return min(all_values), max(all_values)


def _duration(judgement: Judgement) -> str:
    samples = judgement.samples
    return duration(
        (samples[-1].index - samples[0].index + 1) * judgement.settings.period
    )


def plain_words(judgement: Judgement) -> list[str]:
    """The session in a few sentences, one topic each."""
    last = judgement.verdicts[-1] if judgement.verdicts else None
    nominal = nominal_score(last_verdict(judgement.verdicts))
    shown = shown_twin(last)
    lines = [_what(judgement), _matching(judgement)]
    if last is None or shown is None:
        faulty = judgement.summary.trust.level is TrustLevel.FAULT
        return [*lines, _nothing(judgement), *([_health(judgement)] if faulty else [])]
    if last.leader is not None:
        lines.append(_leader(last, shown))
    if nominal is not None:
        lines.append(_choice(last, nominal))
    if last.certainty:
        lines.append(as_sentence(last.certainty))
    trust = as_sentence(trust_words(judgement.summary))
    return [*lines, _fit(judgement, shown), trust, _health(judgement)]


def _what(judgement: Judgement) -> str:
    samples = judgement.samples
    period = judgement.settings.period
    plant = judgement.settings.plant
    outputs = number_list(map(str, shown_outputs(plant)))
    control = f"control ({number_list(drive.text or drive.name for drive in plant.drives.values())})"
    recorded = f"were recorded every {period:g} s, {len(samples)} samples in total"
    if judgement.settings.law is None:
        beside = "".join(
            f" and {d.text or d.name}" for d in plant.disturbances.values()
        )
        return (
            f"For {_duration(judgement)} the {outputs} of a plant ({plant.title}), its "
            f"{control}{beside} {recorded}; its controller is not known."
        )
    low, high = _ends(r for s in samples for r in s.references)
    unit = outputs_unit(plant)
    levels = (
        f"set-points from {low:g} to {high:g} {unit}"
        if high > low
        else f"a set-point of {low:g} {unit}"
    )
    return (
        f"For {_duration(judgement)} a plant ({plant.title}) was controlled to {levels}; its "
        f"{outputs} and the {control} {recorded}."
    )


def _matching(judgement: Judgement) -> str:
    count = sum(1 for v in judgement.verdicts if v.match)
    closed = judgement.settings.law is not None
    kind = "set-point" if closed else "control"
    twin = (
        "of the plant with its controller"
        if closed
        else "of the plant under the recorded control"
    )
    if not count:
        return (
            f"There was no {kind} step that a digital twin could be fitted to, so there is no match and no "
            "candidate."
        )
    n_admitted = len(admitted(judgement.verdicts))
    were = "was" if n_admitted == 1 else "were"
    refused = (
        f" and {count - n_admitted} refused (see section 2)"
        if count > n_admitted
        else ""
    )
    return (
        f"After {kind} steps a digital twin, a simulation {twin}, is fitted to the measurements: of {count} "
        f"match{'' if count == 1 else 'es'}, {n_admitted} {were} admitted to the "
        f"family{refused}."
    )


def _nothing(judgement: Judgement) -> str:
    if any(v.match for v in judgement.verdicts):
        return "There is no valid match, so there is no twin to trust."
    step = _step(judgement.settings)
    if judgement.settings.law is None:
        return f"The control has to move so far and for so long that it moves the output by {step} or more."
    return (
        f"The loop needs set-point steps of {step} or more, some "
        "minutes apart; a recording of one or two set-points held for a few minutes each is enough."
    )


def _leader(last: Verdict, shown: ShownTwin) -> str:
    count = len(last.forecasts)
    description = (
        f"structure “{shown.name}”" if shown.is_structure else f"twin “{shown.name}”"
    )
    description = f"match at {shown.name}" if shown.is_match else description
    why = ", the only one with forecasts"
    if count > 1:
        why = f": among {count} twins its forecasts have saved the most characters compared with assuming "
        why += "that nothing changes"
    return f"The twin to ask what comes next, the leader, is the {description}{why}."


def _choice(last: Verdict, nominal: CandidateScore) -> str:
    count = len(last.candidates)
    if count == 1:
        return (
            f"The family has one candidate, matched at {nominal.name}; it is nominal because there is no "
            "other candidate."
        )
    order = nominal.chosen_order
    described = (
        f" Its behaviour is described best by a Box–Jenkins model of order {order}."
        if order
        else ""
    )
    return (
        f"The family has {count} candidates, matches and structures. Its centre, the nominal candidate, is "
        f"{nominal.name}: it has the smallest sum of ν-gaps to the others, {nominal.nu_gap_sum:.3f} (0: the "
        f"same behaviour in closed loop, 1: entirely different).{described}"
    )


def _fit(judgement: Judgement, shown: ShownTwin) -> str:
    outputs, inputs, _ = _fitted(judgement, shown)
    closed = judgement.settings.law is not None
    driving = "only by the set-points" if closed else "by the recorded control"
    scale = "100 % is perfect, 0 % no better than a constant; "
    fits = [
        f"{y} {'over the whole session ' * (not k)}to {fit} % ({scale * (not k)}{y.text(error, finer=1)} RMS)"
        for k, (y, fit, error) in enumerate(outputs)
    ]
    fits += [
        f"the {u} to {fit} % ({u.text(error, finer=1)} RMS)" for u, fit, error in inputs
    ]
    faulty = any(v.level is TrustLevel.FAULT for v in judgement.verdicts)
    return (
        f"Driven {driving}, {shown.name} follows the measured {number_list(fits)}"
        f"{'; this includes the time in which the plant was faulty' if faulty else ''}."
    )


def _health(judgement: Judgement) -> str:
    period = judgement.settings.period
    doubtful = [
        s for s in judgement.summary.stretches if s.level is TrustLevel.DOUBTFUL
    ]
    doubts = ", ".join(f"t = {stretch.times(period)}" for stretch in doubtful)
    if faults := fault_spans(judgement.summary):
        todo = "Look at the plant (drive, sensor, cables) before anything else."
        return f"The plant had a fault: {'; '.join(faults)}. {todo}"
    if doubts:
        return f"No fault was found; the twin was doubtful: {doubts}."
    return "No fault was found: plant and twin never differed by more than is normal for a healthy plant."


def _fit_facts(judgement: Judgement, shown: ShownTwin) -> list[tuple[str, str]]:
    s = judgement.summary
    outputs, inputs, driven = _fitted(judgement, shown)
    loop = f"closed-loop twin of {shown.name}, "
    open_loop = f"driven twin of {shown.name}, "
    bands_held = ("forecasts have held", str(s.range) if s.range else "–")
    closed = judgement.settings.law is not None
    facts = [
        (
            f"{loop if closed else open_loop}{y}",
            f"fit {fit} %, {y.text(error, finer=2)} RMS",
        )
        for y, fit, error in outputs
    ]
    facts += [
        (f"{loop}{u}", f"fit {fit} %, {u.text(error, finer=1)} RMS")
        for u, fit, error in inputs
    ]
    if closed:
        facts += [
            (f"{open_loop}{y}", f"{y.text(error, finer=1)} RMS")
            for y, _, error in driven
        ]
    return [*facts, bands_held]


def _matches(judgement: Judgement) -> str:
    counts = judgement.summary.matches
    parts = ", ".join(
        f"{count} {status.replace('_', ' ')}"
        for status, count in sorted(counts.items())
    )
    return f"{sum(counts.values())}" + (f" ({parts})" if parts else "")


def _steps(samples: Sequence[Sample], settings: TwinSettings) -> str:
    movements = Movements(settings.schedule, settings.effect, settings.units)
    movements.rest(samples[0])
    count = sum(movements.push(sample) is not None for sample in samples)
    means = "" if settings.effect is None else "the output moved by the input "
    return f"{count} of {means}{_step(settings)} or more, or of less that lasts"


def _step(settings: TwinSettings) -> str:
    """The least step of each output that counts, alike ones once."""
    least = settings.schedule.min_step
    steps = [
        f"{least * scale:.3g} {output.unit}".rstrip()
        for scale, output in zip(
            settings.units, shown_outputs(settings.plant), strict=True
        )
    ]
    return " or ".join(dict.fromkeys(steps))


_Fitted = list[tuple[ShownSignal, str, float]]
"""Signals with their fit in per cent and the RMS residual."""


def _fitted(judgement: Judgement, shown: ShownTwin) -> tuple[_Fitted, _Fitted, _Fitted]:
    """How the closed-loop twin fits outputs and inputs, and how the driven one fits outputs.

    If the loop is not known, the driven twin stands for the closed-loop one, and no input is fitted.
    """
    plant = judgement.settings.plant
    fits = judgement.summary.fits
    if fits is None:
        return [], [], []
    parts = compare(judgement.stretches, shown.parameters, judgement.settings)

    def rows(signals: list[ShownSignal], shares: Signals, residual: str) -> _Fitted:
        alone = [
            [getattr(part.alone(k), residual) for part in parts]
            for k in range(len(signals))
        ]
        return list(
            zip(
                signals, map(percent, shares), map(root_mean_square, alone), strict=True
            )
        )

    driven = rows(shown_outputs(plant), fits.outputs, "driven_residual_y")
    if judgement.settings.law is None:
        return driven, [], driven
    outputs = rows(shown_outputs(plant), fits.outputs, "closed_residual_y")
    return outputs, rows(shown_inputs(plant), fits.inputs, "closed_residual_u"), driven


def as_sentence(text: str) -> str:
    """A remark with an initial capital and a full stop."""
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."
