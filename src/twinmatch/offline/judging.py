"""Judging a session: its samples run through the twin, with the parameters and candidates given."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from twinmatch import __version__
from twinmatch.comparing import Candidate, Verdict
from twinmatch.dynamics import (
    SKIPPED,
    Plant,
    Sensor,
    begin,
    commands_of,
    simulate_closed_loop,
)
from twinmatch.errors import TwinmatchError
from twinmatch.health import EstimatedReading
from twinmatch.kept import cache_folder
from twinmatch.offline.estimates import EstimatedCourse, courses_of
from twinmatch.offline.processes import held_interrupts
from twinmatch.offline.summary import SessionSummary, summarise
from twinmatch.parameters.twin import (
    at_period,
    outputs_named,
    read_settings,
    recorded_values,
    settings_from,
)
from twinmatch.sessions import Session, samples_of
from twinmatch.sessions.cdr import decoded
from twinmatch.sessions.metadata import CANDIDATES, parameters_of
from twinmatch.settings import Rule
from twinmatch.signals import Sample, Window, rms, stretches
from twinmatch.twin import FamilyModels, MatchReport, Outcome, Twin, TwinSettings
from twinmatch.twin.matcher import one_thread

SAMPLE = "plant/sample"


class TermsError(TwinmatchError):
    """The terms that a session was judged with are not recorded, or cannot be used."""


class Terms(NamedTuple):
    """Parameters and candidates with which a session is judged."""

    settings: TwinSettings
    given: tuple[Candidate, ...] = ()
    """Initial candidates."""
    matching: TwinSettings | None = None
    """Separate settings for matches, if any."""
    source: str = ""
    """Origin of the parameters, in words."""


def prefix_of(session: Session) -> str:
    """Common prefix of the rig's nodes and topics."""
    return session.topic.removesuffix(SAMPLE)


def terms_from_files(
    session: Session, config: Path | None = None, candidates: Path | None = None
) -> Terms:
    """Parameters and candidates of files; without files the defaults and no candidates."""
    source = f"the file {config.name}" if config else "the defaults of this version"
    settings_of_file = read_settings(
        config, session.plant, driven=not session.has_reference
    )
    settings = at_period(settings_of_file, session.period, config)
    if (
        config is None
        and not settings.plant.single
        and not _law_gives_inputs(settings, session)
    ):
        settings = at_period(
            read_settings(None, session.plant, driven=True), session.period, None
        )
        source += ", driven by the recorded inputs, which are not those of the loop in the plant file"
    settings = replace(
        settings,
        read_through=settings.read_through or _recorded_read_through(session, settings),
    )
    return Terms(settings, _candidates_of(candidates), source=source)


def _candidates_of(file: Path | None) -> tuple[Candidate, ...]:
    """The candidates of a file; none without one."""
    if file is None:
        return ()
    # what reads such files is loaded only for those who give one
    from twinmatch.parameters.candidates import read_candidates  # noqa: PLC0415

    return tuple(read_candidates(file))


def _recorded_read_through(session: Session, settings: TwinSettings) -> tuple[str, ...]:
    """The outputs whose estimates the law took, as recorded with the session.

    That is a fact of the plant that ran, which no file can choose otherwise: samples of a law that ran on an
    estimate are not matched.
    """
    recorded = (
        parameters_of(session.records, f"{prefix_of(session)}discriminator") or {}
    )
    names = str(recorded.get("read_through", ""))
    return outputs_named(f"session {session.name}", names, settings.plant)


def _law_gives_inputs(settings: TwinSettings, session: Session) -> bool:
    """Whether the law of these settings gives the inputs recorded in the first minutes.

    It does if they agree within the noise of the drives, or if there is too little to compare.
    """
    law = settings.law
    samples, *_ = stretches(session.samples, session.period)
    if law is None or len(samples) <= _LAW_CHECK.begin:
        return True
    window = samples.part(
        samples.first, samples.first + min(len(samples), _LAW_CHECK.compared) - 1
    )
    state = law.state(window.part(window.first, window.first + _LAW_CHECK.begin - 1))
    errors = []
    # A window cannot be written to; for such arrays numba would compile the law again.
    all_references = np.array(window.references)
    all_outputs = np.array(window.outputs)
    for k in range(SKIPPED, len(window)):
        references = all_references[k]
        outputs = all_outputs[k]
        inputs = window.inputs[k]
        commands, _ = commands_of(law.code, state, references[None], outputs[None])
        errors.append(commands[0] - inputs)
        state = law.follow(state, references, outputs, inputs)
    noise = [drive.noise for drive in settings.plant.drives.values()]
    return bool((rms(np.array(errors).T) <= noise).all())


def recorded_terms(
    session: Session, config: Path | None = None, candidates: Path | None = None
) -> Terms:
    """Parameters and candidates recorded with the session; files override them."""
    if config is not None:
        return terms_from_files(session, config, candidates)
    prefix = prefix_of(session)
    matching, _ = _recorded_settings(session, f"{prefix}matcher")
    settings, candidates_file = _recorded_settings(session, f"{prefix}discriminator")
    initial_candidates = (
        _candidates_of(candidates)
        if candidates
        else _recorded_candidates(session, candidates_file)
    )
    return Terms(
        settings, initial_candidates, matching, "those recorded with the session"
    )


def _recorded_settings(session: Session, node: str) -> tuple[TwinSettings, str]:
    """Recorded settings of a node, and its file of candidates."""
    place = f"session {session.name}"
    recorded = parameters_of(session.records, node)
    if recorded is None:
        raise TermsError(
            f"{place}: the parameters of {node} were not recorded; give them with --config, "
            "or run the recorder together with the twin"
        )
    try:
        values = recorded_values(f"{place}: {node}", recorded)
        return settings_from(values), str(values["candidates"])
    except TwinmatchError as error:
        raise TermsError(
            f"{place}: the recorded parameters of {node} cannot be used: {error}"
        ) from error


def _recorded_candidates(session: Session, path: str) -> tuple[Candidate, ...]:
    """The initial candidates recorded with a session; `path` is the file that the twin had them from.

    Raises:
        TermsError: there was such a file, but they were not recorded.
    """
    if not path:
        return ()
    text = session.records.get(CANDIDATES, {}).get("text", "")
    if not text:
        raise TermsError(
            f"session {session.name}: its initial candidates, from {path}, were not recorded; "
            "give them with --candidates"
        )
    from twinmatch.parameters.candidates import parse_candidates  # noqa: PLC0415

    return tuple(parse_candidates(text, f"session {session.name}: candidates"))


class _LawCheck(Rule):
    """Samples on which a law is compared with a recording."""

    begin: int = 60
    """From these the state of the law is found."""
    compared: int = 900
    """On these, those of the beginning included, its commands are compared with the recorded ones."""


_LAW_CHECK: Final = _LawCheck()


Watch = Callable[[int, int], None]
"""Called with (samples done, total) every `EVERY` samples."""

EVERY = 50
"""Samples between two calls of `Watch`."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """All results of a session."""

    name: str
    samples: Sequence[Sample]
    settings: TwinSettings
    matches: tuple[MatchReport, ...]
    verdicts: tuple[Verdict, ...]
    summary: SessionSummary
    stretches: tuple[Window, ...]
    """The samples as the twin took them, with stand-ins, in the stretches that longer gaps leave."""
    stamps: Mapping[int, int]
    """Stamps of the samples and stand-ins, ns, by index."""
    estimates: tuple[EstimatedCourse, ...] = ()
    """What sensors should have read that were not believed."""
    models: FamilyModels = field(default_factory=dict)
    """Box–Jenkins models of the twins of the family at the end."""


def judge(
    session: Session,
    terms: Terms,
    *,
    watch: Watch | None = None,
    beside: Callable[[Twin, Sample, Outcome], None] | None = None,
) -> Judgement:
    """Judge a session with these terms; see `judge_samples`."""
    return judge_samples(
        session.name,
        session.samples,
        terms.settings,
        initial_candidates=terms.given,
        matching=terms.matching,
        notes=session.notes,
        trials=_trials(session),
        watch=watch,
        beside=beside,
    )


def _trials(session: Session) -> dict[int, float]:
    """First and last samples between which laws on trial drove, from the controller's reports."""
    name = f"{prefix_of(session)}plant/law"
    reports = map(decoded, session.messages([name]) if name in session.counts else ())
    driving = [report for report in reports if report.first]
    return {
        report.first: report.sample if report.phase_name == "back" else math.inf
        for report in driving
    }


def judge_samples(
    name: str,
    samples: Sequence[Sample],
    settings: TwinSettings,
    *,
    initial_candidates: Sequence[Candidate] = (),
    matching: TwinSettings | None = None,
    notes: Sequence[str] = (),
    trials: Mapping[int, float] = MappingProxyType({}),
    watch: Watch | None = None,
    beside: Callable[[Twin, Sample, Outcome], None] | None = None,
) -> Judgement:
    """Push samples through a twin, one by one, as the live nodes do; Ctrl-C takes effect between two of them.

    `matching` are separate settings for matches, if any; `beside` is called after every sample with the twin
    in its current state, the sample and the outcome.
    """
    twin = Twin(settings, initial_candidates, matching=matching)
    for first, last in trials.items():
        twin.discriminator.tell_of_trial(first, last)
    matches: list[MatchReport] = []
    verdicts: list[Verdict] = []
    settled: list[Sample] = []
    estimates: list[EstimatedReading] = []
    # one limit on the threads of linear algebra for all windows, as each would set its own
    with held_interrupts() as check_interrupt, one_thread():
        for count, sample in enumerate(samples):
            outcome = twin.push(sample)
            if outcome.match is not None:
                matches.append(outcome.match)
            verdicts += outcome.verdicts
            settled += outcome.settled
            estimates += outcome.estimates
            if beside is not None:
                beside(twin, sample, outcome)
            if watch is not None and count % EVERY == 0:
                watch(count, len(samples))
            check_interrupt()
        usable = [sample for sample in settled if sample.usable]
        without_gaps = stretches(usable, settings.period)
        summary = summarise(without_gaps, verdicts, settings.law, notes)
    stamps = {sample.index: sample.stamp for sample in settled}
    courses = courses_of(estimates, settings.plant)
    return Judgement(
        name,
        samples,
        settings,
        tuple(matches),
        tuple(verdicts),
        summary,
        without_gaps,
        stamps,
        courses,
        twin.discriminator.models,
    )


LEVELS = (0.2, 0.6, 0.3)
"""Set-points, as shares of the usual range: enough for a match, a second candidate and ν-gaps."""
HOLD = 240
"""Samples for which each of them is held."""


def rehearse(
    plant: type[Plant], settings: TwinSettings, watch: Callable[[int, int], None]
) -> None:
    """Judge a simulated run, unless this version has done so on this machine; the verdicts are discarded.

    Compiled code is kept, so this takes a minute or two the first time. Without it that time would pass while
    the rig already runs, and matches would come too late. A plant without a loop is not rehearsed.
    """
    mark = cache_folder() / f"rehearsed-{plant.name}-{__version__}"
    if plant.loop is None or mark.exists():
        return
    low, high = plant.output.set_points or plant.output.span
    reference = np.repeat([low + (high - low) * share for share in LEVELS], HOLD)
    parameters = plant.model().parameters()
    response = simulate_closed_loop(
        parameters,
        reference,
        states=begin(parameters, float(reference[0])),
        law=settings.law,
        sensor=Sensor(noise=plant.output.noise).realise(
            reference.size, settings.period, seed=1
        ),
    )
    window = Window(reference, response.output, response.input, period=settings.period)
    judge_samples("rehearsal", samples_of(window), settings, watch=watch)
    mark.parent.mkdir(parents=True, exist_ok=True)
    mark.touch()
