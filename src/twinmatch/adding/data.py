"""Checks of a plant against a recording of it.

Noise, the declared loop, matches, and which of its equations the data support.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from twinmatch.adding.check import Shown
from twinmatch.adding.noise import noise_of
from twinmatch.adding.trial import CheckedPlant, Finding, time_constants
from twinmatch.comparing import FEW, Verdict, doubt_words
from twinmatch.dynamics import Law, Model, Parameters, Plant, PlantError, commands_of
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import FittingError, Noise, StructureFit, fit_structure, in_parts
from twinmatch.fitting.gate import Status
from twinmatch.fitting.lacks import LEFT, Lack, lack_of
from twinmatch.fitting.problem import LASTING
from twinmatch.importing import open_any
from twinmatch.importing.derived import with_derived
from twinmatch.importing.mapped import map_samples, with_plant_names
from twinmatch.importing.recordings import session_of
from twinmatch.importing.resampling import Gaps
from twinmatch.importing.table_files import open_table
from twinmatch.importing.tables import TEXTS
from twinmatch.offline.judging import judge, terms_from_files
from twinmatch.offline.separation import inseparable_in
from twinmatch.sampling.sources import SignalMap
from twinmatch.sampling.turns import angle_words, shown_turn
from twinmatch.sessions import Session
from twinmatch.sessions.files import ProgressCallback
from twinmatch.settings import Rule
from twinmatch.showing.series import root_mean_square
from twinmatch.signals import FloatArray, Sample, Window, only, stretches, unbroken
from twinmatch.twin import MatchReport, StructureScore, TwinSettings, choose_structure
from twinmatch.twin.structures import StructureChoice


class _NoiseRule(Rule):
    """How far a declared noise may be from what a recording shows."""

    small: float = 3.0
    """Noise declared smaller than measured by more than this factor is a finding: no fit would explain it."""
    large: float = 100.0
    """Noise that is declared larger by more than this factor is a finding; less is a choice of what
    counts."""
    unexplained: float = 4.0
    """Residuals of the whole recording, in units of the noise, above which a larger noise is suggested."""
    part: float = 3.0
    """What is left is suggested to be so many times the noise: the gate then accepts up to twice as much."""


_NOISE_RULE: Final = _NoiseRule()


_ROWS_AHEAD: Final = 0.5
"""Share of the mean square that is left with inputs a row ahead, below which rows have those of the interval
before: a wrong structure gains less by looking ahead."""
_TODO: Final = {
    Status.NO_EXCITATION: "record steps of the input (or the set-point) that move the output far "
    "above its noise",
    Status.NOT_EXPLAINED: "an effect is missing in the equations: see where the residuals are large "
    "(twinmatch replay --figure), add a part, or correct `noise` if it is far too small",
    Status.DID_NOT_CONVERGE: "start closer: give better defaults, or `starts` in the structure",
    Status.BOUNDS_HIT: "widen the bounds if such a value is possible, otherwise fix that parameter",
    Status.NOT_IDENTIFIABLE: "fix the parameter that the data do not determine (remove it from `free`), or "
    "record a richer experiment: more levels, longer than the slowest time constant",
    Status.NOT_BETTER: "nothing is wrong: the previous candidate predicts equally well",
}
_REST_FIRST: Final = (
    "rest first, then step: twinmatch experiment says for how long, and how far"
)
_NO_BETTER: Final = (
    "an effect is missing in the equations, such as an oscillation, a bend or a dead time, although what it "
    "leaves is within what a match may leave: add it as a part, with a structure that has it"
)
_FAULTY: Final = (
    "leave that part of the recording out; if the plant was healthy, correct what is declared: `span` of the "
    "output (a sensor may stay at its ends), `noise`, or the parameters in `typical`"
)


def data_for(
    path: Path,
    plant: type[Plant],
    signal_map: SignalMap,
    period: float | None = None,
    progress: ProgressCallback | None = None,
    *,
    longest: float | None = None,
    gaps: Gaps = "refuse",
) -> Session:
    """Read a recording as a session of the plant; a table needs a map unless its columns have the names of
    the signals, and a sampling period, s, unless it has times.

    `progress` is called with how much has been read, and of how much; `longest` and `gaps` are those of
    `map_samples`.
    """
    if path.suffix.lower() in TEXTS or signal_map.sources:
        table = open_table(path, progress)
        table, signal_map = with_derived(table, signal_map)
        full_map = with_plant_names(table, plant, signal_map)
        imported = map_samples(
            table,
            full_map.joined(SignalMap(period=period)),
            plant,
            longest=longest,
            gaps=gaps,
        )
        session = session_of(
            path,
            imported.samples,
            plant=plant.name,
            has_reference=imported.has_reference,
        )
        return replace(session, missing=imported.notes)
    return open_any(path, plant=plant.name, progress=progress)


def check_data(
    session: Session, plant: type[Plant], show: Shown = lambda *_: None
) -> CheckedPlant:
    """Check the plant against a recording: noise, duration, and results of the matches; with several loops,
    which are not matched, results of the fits to all of it.

    `show` is called with what is being done, how many samples of it are done, and of how many.
    """
    if len(plant.outputs) > 1 or len(plant.drives) > 1:
        return _check_fits(session, plant, show)
    terms = terms_from_files(session)
    judgement = judge(session, terms, watch=partial(show, "judging the recording"))
    faults = [verdict.reason for verdict in judgement.verdicts if verdict.fault]
    size = len(session.samples)
    show(f"fitting {len(plant.structures)} structures to {size} samples", size, size)
    compared = compare_structures(judgement.stretches, plant, terms.settings)
    findings, notes = _of_samples(session, plant, terms.settings.start, compared.least)
    findings += loop_findings(session, plant, terms.settings.law)
    inseparable = (
        None
        if judgement.matches or faults
        else inseparable_in(judgement.stretches, plant)
    )
    if inseparable is None:
        findings += _of_matches(judgement.matches, faults, terms.settings, size)
    else:
        problem = f"no window could be matched: {inseparable.sentence}"
        findings.append(Finding(problem, _REST_FIRST))
    findings += compared.on_rows
    notes += [*_accepted(judgement.matches), *compared.notes]
    matches = [report.match for report in judgement.matches]
    accepted = sum(match.accepted for match in matches)
    if 2 * accepted < len(matches):
        # where matches are accepted anyway, it is a remark
        findings += compared.findings
    else:
        findings += _of_forecasts(judgement.verdicts)
    if not accepted and any(match.status is Status.NOT_EXPLAINED for match in matches):
        findings += _of_what_is_left(compared.least, plant)
    return CheckedPlant(
        f"{plant.title} on {session.name}", tuple(findings), tuple(notes)
    )


def _check_fits(session: Session, plant: type[Plant], show: Shown) -> CheckedPlant:
    size = len(session.samples)
    show(f"fitting {len(plant.structures)} structures to {size} samples", size, size)
    without_gaps = stretches(session.samples, session.period)
    windows = [
        part for window in _windows(without_gaps) for part in in_parts(plant, window)
    ]
    compared = _compared(windows, plant, size, noise=Noise.of(plant), law=None)
    findings, notes = _of_samples(
        session, plant, plant.model().parameters(), compared.least
    )
    findings += [*compared.findings, *_of_what_is_left(compared.least, plant)]
    notes += [*_note_on_short(without_gaps), *compared.notes]
    return CheckedPlant(
        f"{plant.title} on {session.name}", tuple(findings), tuple(notes)
    )


def _of_samples(
    session: Session,
    plant: type[Plant],
    parameters: Parameters,
    least: tuple[float, ...],
) -> tuple[list[Finding], list[str]]:
    """The noise of every output, which may be what the best fit leaves at `least`, angles, and the duration."""
    findings = [*findings_of_angles(session, plant)]
    size = len(session.samples)
    outputs = plant.outputs
    longest = max(stretches(session.samples, session.period), key=len)
    inputs = [*longest.inputs.T, *longest.disturbances.T]
    measured = {
        n: noise_of(y, inputs) for n, y in zip(outputs, longest.outputs.T, strict=True)
    }
    listed = ", ".join(
        f"{noise:g}{f' ({name})' if len(outputs) > 1 else ''}"
        for name, noise in measured.items()
    )
    notes = [*session.missing]
    notes += [
        f"{session.name}: {size} samples, one every {session.period:g} s; measured noise {listed}"
    ]
    residuals = dict(zip(outputs, least, strict=False))
    for name, noise in measured.items():
        declared = outputs[name].noise
        of_output = f" {name}" if len(outputs) > 1 else ""
        largest_explained = max(noise, residuals.get(name, 0.0) / _NOISE_RULE.part)
        if (
            noise > declared * _NOISE_RULE.small
            or declared > _NOISE_RULE.large * largest_explained
        ):
            problem = f"the noise of the output{of_output} is declared as {declared:g}, but measured as {noise:g}"
            findings.append(
                Finding(
                    problem, "correct `noise`: every judgement of the fit depends on it"
                )
            )
        if _NOISE_RULE.small * noise < declared <= _NOISE_RULE.large * noise:
            ratio = f"{declared / noise:.2g} times the measured one"
            errors = f"errors of{of_output}" if of_output else "errors"
            notes.append(f"{errors} count in units of the declared noise, {ratio}")
    lags = time_constants(parameters)
    if lags.size and size * session.period < 2 * lags[-1]:
        problem = f"the recording lasts {size * session.period:g} s, less than twice the slowest time constant"
        todo = f"record at least {2 * lags[-1]:.3g} s, or check the default of that parameter"
        findings.append(Finding(f"{problem} ({lags[-1]:.3g} s)", todo))
    return findings, notes


def findings_of_angles(session: Session, plant: type[Plant]) -> Iterator[Finding]:
    """That an output begins again after a turn, which the plant's file does not say."""
    readings = np.array([sample.outputs for sample in session.samples])
    for column, output in zip(readings.T, plant.outputs.values(), strict=True):
        turn = 0.0 if output.turn else shown_turn(column, output.unit, output.name)
        if turn:
            yield Finding(
                f"{angle_words(output.name, turn)}, which no equations can follow",
                f"write turn={turn:.6g} in its Output: its turns are counted then",
            )


def _of_what_is_left(least: tuple[float, ...], plant: type[Plant]) -> Iterator[Finding]:
    """Advice for equations that no measurement noise explains, but that may be good enough."""
    for output, residual in zip(plant.outputs.values(), least, strict=False):
        if residual > _NOISE_RULE.unexplained * output.noise:
            of_output = f" of {output.name}" if len(plant.outputs) > 1 else ""
            size = f"{residual:.2g} {output.unit}".rstrip()
            noise = float(f"{residual / _NOISE_RULE.part:.2g}")
            yield Finding(
                f"over the whole recording, the best of the structures leaves {size}{of_output}",
                f"if errors of that size are good enough for you, declare noise={noise:g}: errors of fits "
                "and forecasts are judged in units of the noise",
            )


def _of_matches(
    matches: tuple[MatchReport, ...],
    faults: Sequence[str],
    settings: TwinSettings,
    size: int,
) -> Iterator[Finding]:
    least = settings.schedule.min_span
    period = settings.period
    if not matches and faults:
        problem = f"no window could be matched, because the plant seemed to be at fault: {faults[0]}"
        yield Finding(problem, _FAULTY)
    elif not matches and size <= least:
        problem = f"no window could be matched: the recording lasts {size * period:g} s"
        yield Finding(
            problem,
            f"record at least {2 * least * period:g} s, with steps of the input that stand out",
        )
    elif not matches:
        problem = (
            "no window could be matched: the signals did not move far enough, or not for long enough "
            f"({least * period:g} s without a gap, from one step to the next)"
        )
        yield Finding(problem, _TODO[Status.NO_EXCITATION])
    elif not any(report.match.accepted for report in matches):
        for status, number in Counter(
            report.match.status for report in matches
        ).most_common(2):
            first = next(
                report.match for report in matches if report.match.status is status
            )
            problem = f"{number} of {len(matches)} matches were refused as {status.value}: {first.reason}"
            yield Finding(
                problem,
                "; or ".join(filter(None, (first.suggestion, _TODO.get(status)))),
            )


def _of_forecasts(verdicts: Sequence[Verdict]) -> Iterator[Finding]:
    """That the leader at the end is of no use at any horizon, though its parameters could be matched."""
    leader = verdicts[-1].leading if verdicts else None
    if leader is None:
        return
    horizons = verdicts[-1].horizons
    doubts = leader.doubts(horizons)
    fails_everywhere = len(doubts) == len(horizons) and FEW not in (doubts.values())
    if fails_everywhere and any(doubt.certain for doubt in doubts.values()):
        yield Finding(
            f"matches are accepted, but the twin is of no use at the end: {doubt_words(doubts)}",
            _NO_BETTER,
        )


def _accepted(matches: tuple[MatchReport, ...]) -> list[str]:
    good = [report.match for report in matches if report.match.accepted]
    if not good:
        return []
    last = good[-1]
    values = ", ".join(
        f"{name} = {last.parameters[name]:.4g} ± {error:.1g}"
        for name, error in zip(last.free, last.standard_errors, strict=True)
        if name in last.parameters and math.isfinite(error)
    )
    shown = "; ".join(filter(None, (values, f"fit {last.fit.y:.1%}")))
    accepted = f"{len(good)} of {len(matches)} matches were accepted; the last: {shown}"
    return [accepted, *filter(None, [last.determined])]


class _LoopRule(Rule):
    """How the declared controller is run on recorded set-points and outputs."""

    stretch: int = 200
    """Samples over which the controller runs on its own: its integral shows wrong gains and wrong windup."""
    shortest: int = 20
    """Shorter stretches are left out."""
    share: float = 0.1
    """RMS error of the input, in standard deviations of the input, from which the loop is another one."""


_LOOP_RULE: Final = _LoopRule()


def loop_findings(
    session: Session, plant: type[Plant], law: Law | None
) -> Iterator[Finding]:
    """A finding if the declared controller does not give the recorded input from set-points and outputs."""
    if law is None or not session.has_reference:
        return
    rms = root_mean_square(
        [
            errors
            for run in _runs(session.samples, law.period)
            for errors in _errors(run, law)
        ]
    )
    usual = float(np.std([sample.input for sample in session.samples]))
    unit = plant.drive.unit
    if rms > max(_LOOP_RULE.share * usual, plant.drive.noise):
        # not a number without such a run
        yield Finding(
            "the loop in the file does not give the recorded input: run on the recorded set-points and "
            f"outputs, it is {rms:.2g} {unit} off (RMS; the input's own standard deviation is {usual:.2g} "
            f"{unit})",
            "correct gains, limits, anti-windup (`back_calculation`) or derivative of `loop`; if the "
            "controller is of another form, remove `loop`: the recorded input then drives the twin",
        )


def _runs(samples: Sequence[Sample], period: float) -> Iterator[Window]:
    """Stretches of consecutive samples."""
    for run in unbroken(samples):
        for first in range(0, len(run), _LOOP_RULE.stretch):
            part = run[first : first + _LOOP_RULE.stretch]
            if len(part) >= _LOOP_RULE.shortest:
                yield Window.from_samples(part, period)


def _errors(run: Window, law: Law) -> Iterator[FloatArray]:
    """Input of the declared controller minus the recorded one, from its first two samples within limits on:
    the controller's state follows from those."""
    within = [not law.saturates(float(u)) for u in run.input]
    begin = next(
        (
            k
            for k in range(len(run) - _LOOP_RULE.shortest)
            if within[k] and within[k + 1]
        ),
        None,
    )
    if begin is None:
        return
    part = run.part(run.first + begin, run.last)
    # A window cannot be written to; for such arrays numba would compile the law again.
    references = np.array(part.references[2:])
    outputs = np.array(part.outputs[2:])
    commands, _ = commands_of(law.code, law.state(part), references, outputs)
    yield only("input", commands) - part.input[2:]


class _Extent(Rule):
    """Stretches of a recording to which structures are fitted, in samples."""

    least: int = 63
    """The shortest that can be fitted: the first 62 samples are not counted."""
    shortest: int = 80
    """The shortest that is used beside a longer one."""
    part: float = 0.1
    """A stretch shorter than this share of the longest one is left out: it hardly tells more."""
    places: int = 4
    """Places per length at which a part of a longer stretch may begin."""
    livelier: float = 1.5
    """A part that moves by so much more is preferred to an earlier one."""
    total: int = 7200
    """All together at most: two hours at 1 s determine a structure, and longer fits take long."""


_EXTENT: Final = _Extent()


class Compared(NamedTuple):
    """Result of a comparison."""

    findings: list[Finding]
    """That another structure than the first one is preferred, which is matched to windows; what all lack."""
    notes: list[str]
    least: tuple[float, ...]
    """RMS of each output's smallest residuals, in its unit; empty if nothing could be fitted."""
    on_rows: tuple[Finding, ...] = ()
    """That the rows are not what the map says; no structure is preferred then."""


def compare_structures(
    without_gaps: Sequence[Window], plant: type[Plant], settings: TwinSettings
) -> Compared:
    """Fit every structure of the plant file to a recording, its stretches without a gap, and choose one as
    the twin does."""
    windows = _windows(without_gaps)
    total = sum(map(len, without_gaps))
    first = settings.start.model.structure_name
    compared = _compared(
        windows, plant, total, noise=settings.noise, law=settings.law, first=first
    )
    return compared._replace(notes=[*_note_on_short(without_gaps), *compared.notes])


def _compared(
    windows: Sequence[Window],
    plant: type[Plant],
    total: int,
    *,
    noise: Noise,
    law: Law | None,
    first: str = "",
) -> Compared:
    names = [
        name
        for name, structure in plant.structures.items()
        if structure.external is None
    ]
    if not windows:
        return Compared([], [], ())
    models = [plant.model(name) for name in names]
    try:
        choice = choose_structure(windows, models, noise=noise, law=law)
    except (FittingError, PlantError) as error:
        return Compared(
            [], [f"the structures cannot be compared on this recording: {error}"], ()
        )
    used = sum(len(window) for window in windows)
    extent = f"all {used}" if used == total else f"{used} of {total}"
    notes = [f"each structure fitted to {extent} samples:"]
    notes += [f"  {_line(score, plant)}" for score in choice.scores]
    notes += [choice.sentence] if len(names) > 1 else []
    least = tuple(
        np.min([_rms(score.fitted) for score in choice.scores], axis=0).tolist()
    )
    if on_rows := tuple(_of_rows(choice, windows, noise, law)):
        return Compared([], notes, least, on_rows)
    chosen = choice.chosen
    findings = []
    first = first or names[0]
    if chosen != first:
        problem = (
            f"the recording supports the structure {chosen!r} rather than {first!r}"
        )
        todo = "put it first in `structures`: single windows are matched with the first one"
        findings.append(Finding(problem, todo))
    lack = _lack(choice.score, windows, noise, law)
    if lack is not None and _is_chosen(lack.model, models, windows, noise, law):
        problem = f"the structure {chosen!r} leaves residuals: {lack} (squared)"
        findings.append(Finding(problem, "add the lines above to the plant file"))
        notes += [
            f"lines that add {lack.what} to the plant file:",
            *(f"  {line}" for line in lack.lines),
        ]
    return Compared(findings, notes, least)


def _of_rows(
    choice: StructureChoice, windows: Sequence[Window], noise: Noise, law: Law | None
) -> Iterator[Finding]:
    """That the rows have the inputs of the interval before them: with those a row ahead, far less is left.

    No plant answers to an input before it comes, so nothing else explains that.
    """
    left_now = _left(choice.score.fitted, noise)
    if law is not None or left_now <= LEFT:
        return
    windows_ahead = [_a_row_ahead(window) for window in windows]
    simplest = min(
        choice.scores, key=lambda score: len(score.fitted.model.structure.free)
    )
    for score in {score.name: score for score in (simplest, choice.score)}.values():
        try:
            ahead = fit_structure(
                windows_ahead,
                score.fitted.model,
                start=score.fitted,
                noise=noise,
                law=None,
            )
        except TwinmatchError:
            continue
        left_ahead = _left(ahead, noise)
        if left_ahead < _ROWS_AHEAD * left_now:
            yield Finding(
                "each row seems to have the input of the interval before it: with the inputs a row earlier, "
                f"{score.name} leaves {_of_noise(left_ahead)} instead of {_of_noise(left_now)}",
                "map the input with '; interval=before' behind its column",
            )
            return


def _of_noise(left: float) -> str:
    return f"{math.sqrt(left):.2g} × noise"


def _a_row_ahead(window: Window) -> Window:
    """The window without its last sample, each sample with the inputs of the next one."""
    shorter = window.part(window.first, window.first + len(window) - 2)
    return replace(shorter, inputs=window.inputs[1:])


def _left(fitted: StructureFit, noise: Noise) -> float:
    """Mean square of the residuals of all outputs, in terms of their noise."""
    return float(np.mean(np.square(_rms(fitted) / np.atleast_1d(noise.outputs))))


def _is_chosen(
    grown: Model,
    models: Sequence[Model],
    windows: Sequence[Window],
    noise: Noise,
    law: Law | None,
) -> bool:
    """Whether a plant with an effect added is chosen beside the structures of the file."""
    others = [model for model in models if model.structure_name != grown.structure_name]
    try:
        choice = choose_structure(windows, [*others, grown], noise=noise, law=law)
    except (FittingError, PlantError):
        return False
    return choice.chosen == grown.structure_name


def _lack(
    score: StructureScore, windows: Sequence[Window], noise: Noise, law: Law | None
) -> Lack | None:
    """The effect that explains most of what the chosen structure leaves, if it leaves much."""

    def fit(start: Parameters) -> tuple[Parameters, float] | None:
        try:
            fitted = fit_structure(windows, start.model, noise=noise, law=law)
        except TwinmatchError:  # too fast for these samples
            return None
        return None if fitted.bounds_hit else (fitted.parameters, _left(fitted, noise))

    left = _left(score.fitted, noise)
    if left <= LEFT:
        return None
    independent = sum(len(window) for window in windows) / LASTING
    return lack_of(score.parameters, windows[0].period, left, independent, fit)


def _windows(without_gaps: Sequence[Window]) -> list[Window]:
    """The stretches to which structures are fitted: the first ones that are long enough, up to a total.

    Of one that exceeds it, the part in which its outputs move most: at rest all structures are alike.
    """
    least = _least_length(without_gaps)
    windows = []
    samples_left = _EXTENT.total
    for stretch in without_gaps:
        count = min(samples_left, len(stretch))
        if count >= least:
            first = stretch.first + _liveliest_part(stretch.outputs, count)
            windows.append(stretch.part(first, first + count - 1))
            samples_left -= count
    return windows


def _liveliest_part(outputs: FloatArray, count: int) -> int:
    """Where to begin so that the outputs, shape (N, o), move most within `count` samples."""
    scales = np.std(outputs, axis=0)
    scales[scales == 0.0] = 1.0
    best = 0
    most = -math.inf
    last = len(outputs) - count
    for begin in (*range(0, last, max(count // _EXTENT.places, 1)), last):
        movement = float(
            np.sum(np.std(outputs[begin : begin + count], axis=0) / scales)
        )
        if movement > _EXTENT.livelier * most or begin == 0:
            best = begin
            most = movement
    return best


def _least_length(without_gaps: Sequence[Window]) -> float:
    """Samples of the shortest stretch that is used."""
    longest = max(map(len, without_gaps), default=0)
    return max(min(_EXTENT.shortest, longest), _EXTENT.part * longest, _EXTENT.least)


def _note_on_short(without_gaps: Sequence[Window]) -> list[str]:
    """A note on stretches that are too short to be compared beside others."""
    least = _least_length(without_gaps)
    short = [len(stretch) for stretch in without_gaps if len(stretch) < least]
    if not short or len(short) == len(without_gaps):
        return []
    stretches_are = "1 stretch is" if len(short) == 1 else f"{len(short)} stretches are"
    return [
        f"{stretches_are} left out of the comparison: {sum(short)} samples, fewer than {least:.0f} each"
    ]


def _line(score: StructureScore, plant: type[Plant]) -> str:
    values = ", ".join(
        f"{name} = {score.parameters[name]:.4g}"
        for name in score.fitted.model.structure.free
    )
    fit = "" if math.isnan(score.fit[0]) else f", fit {score.fit[0]:.1%}"
    pairs = zip(plant.outputs.values(), _rms(score.fitted), strict=True)
    residuals = " and ".join(
        f"{rms:.3g} {y.unit} ({rms / y.noise:.3g} × noise)" for y, rms in pairs
    )
    return f"{score.name}: leaves {residuals}{fit}; held back, it is off by {score.off:.3g} × noise; {values}"


def _rms(fitted: StructureFit) -> list[float]:
    """Of each output, in its unit."""
    pairs = list(zip(fitted.measured, fitted.simulated, strict=True))
    outputs = len(fitted.model.plant.outputs)
    return [root_mean_square([m[k] - s[k] for m, s in pairs]) for k in range(outputs)]
