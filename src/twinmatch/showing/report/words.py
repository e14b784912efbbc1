"""The result of a session in sentences, for readers who were not there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from twinmatch.comparing import CandidateScore, TrustLevel, Verdict
from twinmatch.offline.judging import Judgement
from twinmatch.offline.summary import ShownTwin, nominal_score, shown_twin
from twinmatch.showing.quantities import ShownSignals, number, percent, signal_names
from twinmatch.showing.series import compare, root_mean_square
from twinmatch.showing.verdicts import admitted, last_verdict
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings
from twinmatch.twin.schedule import Movements


def duration(seconds: float) -> str:
    """A duration in h, min and s."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.3g} s"
    hours, rest = divmod(whole, 3600)
    minutes, left = divmod(rest, 60)
    parts = [(hours, "h"), (minutes, "min"), (left, "s")]
    return " ".join(f"{value} {unit}" for value, unit in parts if value)


def session_facts(judgement: Judgement) -> list[tuple[str, str]]:
    """The session in numbers: pairs of name and value."""
    samples, settings, signals = judgement.samples, judgement.settings, _signals(judgement)
    closed = settings.law is not None
    limits = " to ".join(number(edge, signals.input.decimals) for edge in settings.plant.drive.limits)
    facts = [
        ("samples", f"{len(samples)}, one every {settings.period:g} s"),
        ("duration", _duration(judgement)),
        *([("set-point", signals.output.text(*_ends(s.reference for s in samples)))] if closed else []),
        (signals.output.name, signals.output.text(*_ends(s.output for s in samples))),
        (signals.input.name, f"{signals.input.text(*_ends(s.input for s in samples))} (limits {limits})"),
        ("set-point steps" if closed else "control steps", _steps(samples, settings)),
        ("matches", _matches(judgement)),
        ("verdicts", f"{len(judgement.verdicts)}, of which {judgement.summary.identified} identified models"),
    ]
    shown = shown_twin(judgement.verdicts[-1] if judgement.verdicts else None)
    if shown is not None:
        facts += _fit_facts(judgement, shown)
    return facts


def _ends(values: Iterable[float]) -> tuple[float, float]:
    known = list(values)
    return min(known), max(known)


def _duration(judgement: Judgement) -> str:
    samples = judgement.samples
    return duration((samples[-1].index - samples[0].index + 1) * judgement.settings.period)


def plain_words(judgement: Judgement) -> list[str]:
    """The session in a few sentences, one topic each."""
    last = judgement.verdicts[-1] if judgement.verdicts else None
    nominal, shown = nominal_score(last_verdict(judgement.verdicts)), shown_twin(last)
    lines = [_what(judgement), _matching(judgement)]
    if last is None or shown is None:
        faulty = judgement.summary.level is TrustLevel.FAULT
        return [*lines, _nothing(judgement), *([_health(judgement)] if faulty else [])]
    if last.leader is not None:
        lines.append(_leader(last, shown))
    if nominal is not None:
        lines.append(_choice(last, nominal))
    if last.certainty:
        lines.append(as_sentence(last.certainty))
    return [*lines, _fit(judgement, shown), _trust(judgement), _health(judgement)]


def _what(judgement: Judgement) -> str:
    samples, period = judgement.samples, judgement.settings.period
    plant, signals = judgement.settings.plant, _signals(judgement)
    control = f"control ({plant.drive.text or plant.drive.name})"
    recorded = f"were recorded every {period:g} s, {len(samples)} samples in total"
    if judgement.settings.law is None:
        beside = "".join(f" and {d.text or d.name}" for d in plant.disturbances.values())
        return (
            f"For {_duration(judgement)} the {signals.output} of a plant ({plant.title}), its "
            f"{control}{beside} {recorded}; its controller is not known."
        )
    (low, high), unit = _ends(s.reference for s in samples), signals.output.unit
    levels = f"set-points from {low:g} to {high:g} {unit}" if high > low else f"a set-point of {low:g} {unit}"
    return (
        f"For {_duration(judgement)} a plant ({plant.title}) was controlled to {levels}; its "
        f"{signals.output} and the {control} {recorded}."
    )


def _matching(judgement: Judgement) -> str:
    count = sum(1 for v in judgement.verdicts if v.match)
    closed = judgement.settings.law is not None
    kind = "set-point" if closed else "control"
    twin = "of the plant with its controller" if closed else "of the plant under the recorded control"
    if not count:
        return (
            f"There was no {kind} step that a digital twin could be fitted to, so there is no match and no "
            "candidate."
        )
    joined = len(admitted(judgement.verdicts))
    refused = f" and {count - joined} refused (see section 2)" if count > joined else ""
    return (
        f"After {kind} steps a digital twin, a simulation {twin}, is fitted to the measurements: of {count} "
        f"match{'' if count == 1 else 'es'}, {joined} {'was' if joined == 1 else 'were'} admitted to the "
        f"family{refused}."
    )


def _nothing(judgement: Judgement) -> str:
    if any(v.match for v in judgement.verdicts):
        return "There is no valid match, so there is no twin to trust."
    step = f"{judgement.settings.schedule.min_step:g} {_signals(judgement).output.unit}".rstrip()
    if judgement.settings.law is None:
        return f"The control has to move so far and for so long that it moves the output by {step} or more."
    return (
        f"The loop needs set-point steps of {step} or more, some "
        "minutes apart; a recording of one or two set-points held for a few minutes each is enough."
    )


def _leader(last: Verdict, shown: ShownTwin) -> str:
    count = len(last.forecasts)
    what = f"structure “{shown.name}”" if shown.is_structure else f"twin “{shown.name}”"
    what = f"match at {shown.name}" if shown.is_match else what
    why = ", the only one with forecasts"
    if count > 1:
        why = f": among {count} twins its forecasts have saved the most characters compared with assuming "
        why += "that nothing changes"
    return f"The twin to ask what comes next, the leader, is the {what}{why}."


def _choice(last: Verdict, nominal: CandidateScore) -> str:
    count = len(last.candidates)
    if count == 1:
        return (
            f"The family has one candidate, matched at {nominal.name}; it is nominal because there is no "
            "other candidate."
        )
    order = nominal.chosen_order
    described = f" Its behaviour is described best by a Box–Jenkins model of order {order}." if order else ""
    return (
        f"The family has {count} candidates, matches and structures. Its centre, the nominal candidate, is "
        f"{nominal.name}: it has the smallest sum of ν-gaps to the others, {nominal.nu_gap_sum:.3f} (0: the "
        f"same behaviour in closed loop, 1: entirely different).{described}"
    )


def _residuals(judgement: Judgement, shown: ShownTwin) -> tuple[float, float, float]:
    """RMS residuals of the closed-loop twin's output and input and of the driven twin's output; NaN without
    values."""
    parts = compare(judgement.stretches, shown.parameters, judgement.settings)
    y = root_mean_square([p.closed_residual_y for p in parts])
    u = root_mean_square([p.closed_residual_u for p in parts])
    return y, u, root_mean_square([p.driven_residual_y for p in parts])


def _fit(judgement: Judgement, shown: ShownTwin) -> str:
    s, signals = judgement.summary, _signals(judgement)
    y, u, driven = _residuals(judgement, shown)
    by, off, control = "by the recorded control", driven, ""
    if judgement.settings.law is not None:
        by, off = "only by the set-points", y
        control = f" and the {signals.input} to {percent(s.fit_u)} % ({signals.input.text(u, finer=1)} RMS)"
    faulty = any(v.level is TrustLevel.FAULT for v in judgement.verdicts)
    return (
        f"Driven {by}, {shown.name} follows the measured {signals.output} over the whole session to "
        f"{percent(s.fit_y)} % (100 % is perfect, 0 % no better than a constant; "
        f"{signals.output.text(off, finer=1)} RMS){control}"
        f"{'; this includes the time in which the plant was faulty' if faulty else ''}."
    )


def _trust(judgement: Judgement) -> str:
    s = judgement.summary
    if s.range is None:
        return f"There is no range of the {_signals(judgement).output} in which its forecasts have held."
    held, but = f"Its forecasts have held {s.range}", f", but {s.doubts}" if s.doubts else ""
    if s.level is TrustLevel.TRUSTED:
        return f"{held}, and at the end of the session the twin can be trusted there{but}."
    doubt = "doubtful" if s.level is TrustLevel.DOUBTFUL else "not to be trusted"
    return f"{held}, but at the end of the session the twin is {doubt}: {s.why}."


def _health(judgement: Judgement) -> str:
    stretches = judgement.summary.stretches
    faults, doubts = (
        ", ".join(
            f"t = {stretch.times(judgement.settings.period)}"
            for stretch in stretches
            if stretch.level is level
        )
        for level in (TrustLevel.FAULT, TrustLevel.DOUBTFUL)
    )
    if faults:
        named = sorted({v.fault for v in judgement.verdicts} - {""})
        what = f" ({', '.join(named)})" if named else ""
        todo = "Look at the plant (drive, sensor, cables) before anything else."
        return f"The plant had a fault{what}: {faults}. {todo}"
    if doubts:
        return f"No fault was found; the twin was doubtful: {doubts}."
    return "No fault was found: plant and twin never differed by more than is normal for a healthy plant."


def _fit_facts(judgement: Judgement, shown: ShownTwin) -> list[tuple[str, str]]:
    s, signals = judgement.summary, _signals(judgement)
    y, u, driven = _residuals(judgement, shown)
    loop, open_loop = f"closed-loop twin of {shown.name}, ", f"driven twin of {shown.name}, {signals.output}"
    trusted = ("trusted", str(s.range) if s.range else "–")
    if judgement.settings.law is None:
        return [(open_loop, f"fit {percent(s.fit_y)} %, {signals.output.text(driven, finer=2)} RMS"), trusted]
    return [
        (f"{loop}{signals.output}", f"fit {percent(s.fit_y)} %, {signals.output.text(y, finer=2)} RMS"),
        (f"{loop}{signals.input}", f"fit {percent(s.fit_u)} %, {signals.input.text(u, finer=1)} RMS"),
        (open_loop, f"{signals.output.text(driven, finer=1)} RMS"),
        trusted,
    ]


def _matches(judgement: Judgement) -> str:
    counts = judgement.summary.matches
    parts = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(counts.items()))
    return f"{sum(counts.values())}" + (f" ({parts})" if parts else "")


def _steps(samples: Sequence[Sample], settings: TwinSettings) -> str:
    movements = Movements(settings.schedule, settings.effect, settings.units)
    movements.rest(samples[0])
    count = sum(movements.push(sample) is not None for sample in samples)
    means = "" if settings.effect is None else "the output moved by the input "
    least = f"{settings.schedule.min_step:g} {settings.plant.output.unit}"
    return f"{count} of {means}{least} or more, or of less that lasts"


def _signals(judgement: Judgement) -> ShownSignals:
    return signal_names(judgement.settings.plant)


def as_sentence(text: str) -> str:
    """A remark with an initial capital and a full stop."""
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."
