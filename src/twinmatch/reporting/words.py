"""What a session came to, in plain words, for someone who was not there."""

from __future__ import annotations

from collections.abc import Sequence

from twinmatch.discrimination import CandidateScore, TrustLevel, Verdict
from twinmatch.dynamics import Plant
from twinmatch.judging.judgement import Judgement
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings
from twinmatch.views.comparison import Comparison, compare, root_mean_square
from twinmatch.views.events import admitted, level_stretches
from twinmatch.views.quantities import number
from twinmatch.views.standing import Shown, last_verdict, nominal_score, shown_twin
from twinmatch.views.summary import UNEXPLAINED
from twinmatch.views.words import Words, words_of

__all__ = ["as_sentence", "duration", "plain_words", "session_facts"]


def duration(seconds: float) -> str:
    """A span of time as a person says it."""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.3g} s"
    hours, rest = divmod(whole, 3600)
    minutes, left = divmod(rest, 60)
    parts = [(hours, "h"), (minutes, "min"), (left, "s")]
    return " ".join(f"{value} {unit}" for value, unit in parts if value)


def session_facts(judgement: Judgement) -> list[tuple[str, str]]:
    """The session in figures."""
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
    """The story of the session in a few sentences, one thought each."""
    told = [_what(judgement)]
    last = judgement.verdicts[-1] if judgement.verdicts else None
    nominal, shown = nominal_score(last_verdict(judgement.verdicts)), shown_twin(last)
    told.append(_matching(judgement))
    if last is None or shown is None:
        told.append(_nothing(judgement))
        if judgement.summary.level is TrustLevel.FAULT:
            told.append(_health(judgement))
        return told
    if last.leader is not None:
        told.append(_leader(last, shown))
    if nominal is not None:
        told.append(_choice(last, nominal))
    if last.certainty:
        told.append(as_sentence(last.certainty))
    told.append(_fit(judgement, shown))
    told.append(_trust(judgement))
    told.append(_health(judgement))
    return told


def _what(judgement: Judgement) -> str:
    samples, period = judgement.samples, judgement.settings.period
    plant, words = _plant(judgement), _words(judgement)
    if judgement.settings.gains is None:
        return _what_is_known(judgement)
    low, high = min(s.reference for s in samples), max(s.reference for s in samples)
    unit = words.output_unit
    asked = f"set-points from {low:g} to {high:g} {unit}" if high > low else f"a set-point of {low:g} {unit}"
    time = duration((samples[-1].index - samples[0].index + 1) * period)
    return (
        f"For {time} a plant ({plant.title}) was held by its controller at {asked}; every {period:g} s its "
        f"{words.output} and the control ({plant.drive.text or plant.drive.name}) were recorded, "
        f"{len(samples)} times in all."
    )


def _what_is_known(judgement: Judgement) -> str:
    """The same where nobody tells of a loop."""
    samples, period, plant = judgement.samples, judgement.settings.period, _plant(judgement)
    time = duration((samples[-1].index - samples[0].index + 1) * period)
    beside = "".join(f" and {d.text or d.name}" for d in plant.disturbances.values())
    return (
        f"For {time} the {_words(judgement).output} of a plant ({plant.title}), its control "
        f"({plant.drive.text or plant.drive.name}){beside} were recorded every {period:g} s, {len(samples)} "
        "times in all; what controlled it is not known."
    )


def _matching(judgement: Judgement) -> str:
    count = sum(1 for v in judgement.verdicts if v.match)
    closed = judgement.settings.gains is not None
    kind = "set-point" if closed else "control"
    twin = "of the plant with its controller" if closed else "of the plant under the recorded control"
    if not count:
        return (
            f"No {kind} step was found that a digital twin could be fitted to, so there was no match and "
            "no candidate."
        )
    joined = len(admitted(judgement.verdicts))
    refused = count - joined
    return (
        f"After {kind} steps a digital twin, a simulation {twin}, is fitted to "
        f"what was measured: of {count} window{_s(count)}, {joined} "
        f"{'was' if joined == 1 else 'were'} admitted to the family"
        + (f" and {refused} refused (section 2 says why)." if refused else ".")
    )


def _nothing(judgement: Judgement) -> str:
    if any(v.match for v in judgement.verdicts):
        return "No fit stands, so there is no twin to trust."
    if judgement.settings.gains is None:
        unit, least = _plant(judgement).drive.unit, judgement.settings.least_movement
        return f"The control has to move by {f'{least:g} {unit}'.rstrip()} or more, for some minutes in all."
    return (
        f"The loop needs set-point steps of {judgement.settings.schedule.min_step:g} "
        f"{_words(judgement).output_unit} or more, some "
        "minutes apart; a recording of one or two set-points held for a few minutes each is enough."
    )


def _leader(last: Verdict, shown: Shown) -> str:
    count = len(last.forecasts)
    what = f"structure “{shown.name}”" if shown.words == shown.name else f"match at {shown.name}"
    whose = f"of the {count} twins that foretell" if count > 1 else "of the only twin that foretells"
    return (
        f"The twin to ask what comes next is the {what}. It leads: {whose}, its forecasts have saved the "
        "most characters against saying that nothing changes."
    )


def _choice(last: Verdict, nominal: CandidateScore) -> str:
    count = len(last.candidates)
    if count == 1:
        return (
            f"The family has one candidate, matched at {nominal.name}; it is nominal because there is no "
            "other to compare it with."
        )
    written = (
        f" Its behaviour is written best by a Box–Jenkins model of order {nominal.chosen_order}."
        if nominal.chosen_order
        else ""
    )
    return (
        f"The family has {count} candidates, matches and structures. Its centre, the nominal one, is "
        f"{nominal.name}: its plant's ν-gaps to the others (0: behaves the same in a loop, 1: does not) have "
        f"the smallest sum, {nominal.nu_gap_sum:.3f}.{written}"
    )


def _compared(judgement: Judgement, shown: Shown) -> tuple[Comparison, ...]:
    settings = judgement.settings
    return compare(judgement.samples, shown.parameters, settings.gains, settings.period)


def _driven_fit(judgement: Judgement, shown: Shown) -> str:
    s, words = judgement.summary, _words(judgement)
    y = root_mean_square([p.driven_residual_y for p in _compared(judgement, shown)])
    faulty = any(v.level is TrustLevel.FAULT for v in judgement.verdicts)
    return (
        f"Given the recorded control, {shown.name} follows the measured {words.output} over the whole "
        f"session to {number(100 * s.fit_y, 1)} % (100 % is perfect, 0 % no better than a constant; "
        f"{number(y, words.output_decimals + 1)} {words.output_unit} RMS)"
        f"{'; the time in which the plant was faulty is part of that' if faulty else ''}."
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
        f"Given only the set-points, {shown.name} follows the measured {words.output} over the whole "
        f"session to {number(100 * s.fit_y, 1)} % (100 % is perfect, 0 % no better than a constant; "
        f"{number(y, words.output_decimals + 1)} {words.output_unit} RMS) and the {words.input} to "
        f"{number(100 * s.fit_u, 1)} % ({number(u, words.input_decimals + 1)} {words.input_unit} RMS)"
        f"{'; the time in which the plant was faulty is part of that' if faulty else ''}."
    )


def _trust(judgement: Judgement) -> str:
    s = judgement.summary
    if s.range is None:
        return f"There is no range of the {_words(judgement).output} in which it has been seen to hold."
    held = f"It has been seen to hold between {s.range}"
    if s.level is TrustLevel.TRUSTED:
        return f"{held}, and at the end of the session it is to be trusted there."
    if s.level is TrustLevel.DOUBTFUL:
        return f"{held}, but at the end of the session it is doubtful: twin and plant have drifted apart."
    return f"{held}, but at the end of the session it is not to be trusted."


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
            f"The plant did what no twin explains{what}: {when}. Look at the plant (drive, sensor, cables) "
            "before anything else."
        )
    if doubts:
        when = ", ".join(f"t = {s.first * period:.0f} to {s.last * period:.0f} s" for s in doubts)
        return f"No fault was seen; the twin was doubtful at {when}."
    return "No fault was seen: plant and twin never differed by more than healthy ones do."


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
    told = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(counts.items()))
    return f"{sum(counts.values())}" + (f" ({told})" if told else "")


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
    """A remark with a capital and a full stop."""
    text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."
