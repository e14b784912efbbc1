"""The result of a session in sentences, for readers who were not there."""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.comparing import CandidateScore, TrustLevel, Verdict
from twinmatch.dynamics import Plant
from twinmatch.offline.judgement import Judgement
from twinmatch.showing.comparison import Comparison, compare, root_mean_square
from twinmatch.showing.events import admitted, level_stretches
from twinmatch.showing.quantities import number
from twinmatch.showing.standing import Shown, last_verdict, nominal_score, shown_twin
from twinmatch.showing.summary import UNEXPLAINED
from twinmatch.showing.words import Words, words_of
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings

__all__ = ["as_sentence", "duration", "plain_words", "session_facts"]


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
    samples, period = judgement.samples, judgement.settings.period
    reference = [s.reference for s in samples]
    measured = [s.output for s in samples]
    given = [s.input for s in samples]
    y, u = _words(judgement), _plant(judgement).drive
    a, b = y.output_decimals, y.input_decimals
    asked = f"{number(min(reference), a)} to {number(max(reference), a)} {y.output_unit}"
    facts = [
        ("samples", f"{len(samples)}, one every {period:g} s"),
        ("duration", duration((samples[-1].index - samples[0].index + 1) * period)),
        *([("set-point", asked)] if judgement.settings.gains is not None else []),
        (y.output, f"{number(min(measured), a)} to {number(max(measured), a)} {y.output_unit}"),
        (
            y.input,
            f"{number(min(given), b)} to {number(max(given), b)} {y.input_unit} "
            f"(limits {number(u.limits[0], b)} to {number(u.limits[1], b)})",
        ),
        (
            "control steps" if judgement.settings.gains is None else "set-point steps",
            _steps(samples, judgement.settings),
        ),
        ("matches", _matches(judgement)),
        ("verdicts", f"{len(judgement.verdicts)}, of which {judgement.summary.identified} identified models"),
    ]
    shown = shown_twin(judgement.verdicts[-1] if judgement.verdicts else None)
    if shown is not None:
        facts += _fit_facts(judgement, shown)
    return facts


def plain_words(judgement: Judgement) -> list[str]:
    """The session in a few sentences, one topic each."""
    lines = [_what(judgement)]
    last = judgement.verdicts[-1] if judgement.verdicts else None
    nominal, shown = nominal_score(last_verdict(judgement.verdicts)), shown_twin(last)
    lines.append(_matching(judgement))
    if last is None or shown is None:
        lines.append(_nothing(judgement))
        if judgement.summary.level is TrustLevel.FAULT:
            lines.append(_health(judgement))
        return lines
    if last.leader is not None:
        lines.append(_leader(last, shown))
    if nominal is not None:
        lines.append(_choice(last, nominal))
    if last.certainty:
        lines.append(as_sentence(last.certainty))
    lines.append(_fit(judgement, shown))
    lines.append(_trust(judgement))
    lines.append(_health(judgement))
    return lines


def _what(judgement: Judgement) -> str:
    samples, period = judgement.samples, judgement.settings.period
    plant, words = _plant(judgement), _words(judgement)
    if judgement.settings.gains is None:
        return _what_without_loop(judgement)
    low, high = min(s.reference for s in samples), max(s.reference for s in samples)
    unit = words.output_unit
    asked = f"set-points from {low:g} to {high:g} {unit}" if high > low else f"a set-point of {low:g} {unit}"
    time = duration((samples[-1].index - samples[0].index + 1) * period)
    return (
        f"For {time} a plant ({plant.title}) was controlled to {asked}; its {words.output} and the control "
        f"({plant.drive.text or plant.drive.name}) were recorded every {period:g} s, {len(samples)} samples "
        "in total."
    )


def _what_without_loop(judgement: Judgement) -> str:
    """The same where the loop is not known."""
    samples, period, plant = judgement.samples, judgement.settings.period, _plant(judgement)
    time = duration((samples[-1].index - samples[0].index + 1) * period)
    beside = "".join(f" and {d.text or d.name}" for d in plant.disturbances.values())
    return (
        f"For {time} the {_words(judgement).output} of a plant ({plant.title}), its control "
        f"({plant.drive.text or plant.drive.name}){beside} were recorded every {period:g} s, {len(samples)} "
        "samples in total; its controller is not known."
    )


def _matching(judgement: Judgement) -> str:
    count = sum(1 for v in judgement.verdicts if v.match)
    closed = judgement.settings.gains is not None
    kind = "set-point" if closed else "control"
    twin = "of the plant with its controller" if closed else "of the plant under the recorded control"
    if not count:
        return (
            f"There was no {kind} step that a digital twin could be fitted to, so there is no match and no "
            "candidate."
        )
    joined = len(admitted(judgement.verdicts))
    refused = count - joined
    return (
        f"After {kind} steps a digital twin, a simulation {twin}, is fitted to the measurements: of {count} "
        f"match{'' if count == 1 else 'es'}, {joined} {'was' if joined == 1 else 'were'} admitted to the "
        "family" + (f" and {refused} refused (see section 2)." if refused else ".")
    )


def _nothing(judgement: Judgement) -> str:
    if any(v.match for v in judgement.verdicts):
        return "There is no valid match, so there is no twin to trust."
    if judgement.settings.gains is None:
        unit, least = _plant(judgement).drive.unit, judgement.settings.least_movement
        step = f"{least:g} {unit}".rstrip()
        return f"The control has to move by {step} or more, for some minutes in total."
    return (
        f"The loop needs set-point steps of {judgement.settings.schedule.min_step:g} "
        f"{_words(judgement).output_unit} or more, some "
        "minutes apart; a recording of one or two set-points held for a few minutes each is enough."
    )


def _leader(last: Verdict, shown: Shown) -> str:
    count = len(last.forecasts)
    what = f"structure “{shown.name}”" if shown.is_structure else f"match at {shown.name}"
    if count <= 1:
        return f"The twin to ask what comes next, the leader, is the {what}, the only one with forecasts."
    return (
        f"The twin to ask what comes next, the leader, is the {what}: among {count} twins its forecasts have "
        "saved the most characters compared with assuming that nothing changes."
    )


def _choice(last: Verdict, nominal: CandidateScore) -> str:
    count = len(last.candidates)
    if count == 1:
        return (
            f"The family has one candidate, matched at {nominal.name}; it is nominal because there is no "
            "other candidate."
        )
    described = (
        f" Its behaviour is described best by a Box–Jenkins model of order {nominal.chosen_order}."
        if nominal.chosen_order
        else ""
    )
    return (
        f"The family has {count} candidates, matches and structures. Its centre, the nominal candidate, is "
        f"{nominal.name}: it has the smallest sum of ν-gaps to the others, {nominal.nu_gap_sum:.3f} (0: the "
        f"same behaviour in closed loop, 1: entirely different).{described}"
    )


def _compared(judgement: Judgement, shown: Shown) -> tuple[Comparison, ...]:
    settings = judgement.settings
    return compare(judgement.samples, shown.parameters, settings.gains, settings.period)


def _driven_fit(judgement: Judgement, shown: Shown) -> str:
    s, words = judgement.summary, _words(judgement)
    y = root_mean_square([p.driven_residual_y for p in _compared(judgement, shown)])
    faulty = any(v.level is TrustLevel.FAULT for v in judgement.verdicts)
    return (
        f"Driven by the recorded control, {shown.name} follows the measured {words.output} over the whole "
        f"session to {number(100 * s.fit_y, 1)} % (100 % is perfect, 0 % no better than a constant; "
        f"{number(y, words.output_decimals + 1)} {words.output_unit} RMS)"
        f"{'; this includes the time in which the plant was faulty' if faulty else ''}."
    )


def _fit(judgement: Judgement, shown: Shown) -> str:
    if judgement.settings.gains is None:
        return _driven_fit(judgement, shown)
    s, words = judgement.summary, _words(judgement)
    parts = _compared(judgement, shown)
    y = root_mean_square([p.closed_residual_y for p in parts])
    u = root_mean_square([p.closed_residual_u for p in parts])
    faulty = any(v.level is TrustLevel.FAULT for v in judgement.verdicts)
    return (
        f"Driven only by the set-points, {shown.name} follows the measured {words.output} over the whole "
        f"session to {number(100 * s.fit_y, 1)} % (100 % is perfect, 0 % no better than a constant; "
        f"{number(y, words.output_decimals + 1)} {words.output_unit} RMS) and the {words.input} to "
        f"{number(100 * s.fit_u, 1)} % ({number(u, words.input_decimals + 1)} {words.input_unit} RMS)"
        f"{'; this includes the time in which the plant was faulty' if faulty else ''}."
    )


def _trust(judgement: Judgement) -> str:
    s = judgement.summary
    if s.range is None:
        return f"There is no range of the {_words(judgement).output} in which its forecasts have held."
    held = f"Its forecasts have held between {s.range}"
    if s.level is TrustLevel.TRUSTED:
        return f"{held}, and at the end of the session the twin can be trusted there."
    if s.level is TrustLevel.DOUBTFUL:
        return f"{held}, but at the end of the session the twin and the plant have drifted apart."
    return f"{held}, but at the end of the session the twin is not to be trusted."


def _health(judgement: Judgement) -> str:
    period = judgement.settings.period
    stretches = level_stretches(judgement.verdicts, judgement.samples[0].index)
    faults = [s for s in stretches if s.level is TrustLevel.FAULT]
    doubts = [s for s in stretches if s.level is TrustLevel.DOUBTFUL]
    named = sorted({v.fault for v in judgement.verdicts} - {"", UNEXPLAINED})
    if faults:
        when = ", ".join(f"t = {s.first * period:.0f} to {s.last * period:.0f} s" for s in faults)
        what = f" ({', '.join(named)})" if named else ""
        return (
            f"The plant had a fault{what}: {when}. Look at the plant (drive, sensor, cables) before anything "
            "else."
        )
    if doubts:
        when = ", ".join(f"t = {s.first * period:.0f} to {s.last * period:.0f} s" for s in doubts)
        return f"No fault was found; the twin was doubtful: {when}."
    return "No fault was found: plant and twin never differed by more than is normal for a healthy plant."


def _fit_facts(judgement: Judgement, shown: Shown) -> list[tuple[str, str]]:
    parts = _compared(judgement, shown)
    s, words = judgement.summary, _words(judgement)
    fine = words.output_decimals + 1
    driven = root_mean_square([p.driven_residual_y for p in parts])
    range_ = ("trusted between", str(s.range) if s.range else "–")
    if judgement.settings.gains is None:
        of_driven = f"fit {number(100 * s.fit_y, 1)} %, {number(driven, fine + 1)} {words.output_unit} RMS"
        return [(f"driven twin of {shown.name}, {words.output}", of_driven), range_]
    y = root_mean_square([p.closed_residual_y for p in parts])
    u = root_mean_square([p.closed_residual_u for p in parts])
    return [
        (
            f"closed-loop twin of {shown.name}, {words.output}",
            f"fit {number(100 * s.fit_y, 1)} %, {number(y, fine + 1)} {words.output_unit} RMS",
        ),
        (
            f"closed-loop twin of {shown.name}, {words.input}",
            f"fit {number(100 * s.fit_u, 1)} %, {number(u, words.input_decimals + 1)} {words.input_unit} RMS",
        ),
        (f"driven twin of {shown.name}, {words.output}", f"{number(driven, fine)} {words.output_unit} RMS"),
        range_,
    ]


def _matches(judgement: Judgement) -> str:
    counts = judgement.summary.matches
    parts = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(counts.items()))
    return f"{sum(counts.values())}" + (f" ({parts})" if parts else "")


def _steps(samples: Sequence[Sample], settings: TwinSettings) -> str:
    least = settings.least_movement
    moving = [s.input if settings.gains is None else s.reference for s in samples]
    count, anchor = 0, moving[0]
    for value in moving:
        if abs(value - anchor) >= least:
            count, anchor = count + 1, value
    unit = settings.plant.drive.unit if settings.gains is None else settings.plant.output.unit
    return f"{count} of {least:g} {unit} or more"


def _plant(judgement: Judgement) -> type[Plant]:
    return judgement.settings.plant


def _words(judgement: Judgement) -> Words:
    return words_of(judgement.settings.plant)


def _s(count: int) -> str:
    return "" if count == 1 else "s"


def as_sentence(text: str) -> str:
    """A remark with an initial capital and a full stop."""
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."
