"""The report of a session: judged again, its provenance, its content for the template, and the file."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined

import twinmatch
from twinmatch.comparing import Verdict, number_list
from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.importing import open_any
from twinmatch.offline.backtest import (
    PEERS,
    Backtest,
    Choices,
    Listener,
    graded_outputs,
    portable,
)
from twinmatch.offline.judging import (
    Judgement,
    Terms,
    Watch,
    judge,
    recorded_terms,
    terms_from_files,
)
from twinmatch.offline.processes import Beside, beside
from twinmatch.offline.verification import compare, holds_verdicts
from twinmatch.parameters.twin import table_of, values_of
from twinmatch.sessions import Session
from twinmatch.sessions.files import ProgressCallback, part_of
from twinmatch.showing.family import CRITERIA, FIGURES, Member, family
from twinmatch.showing.forecasts import backtest_words
from twinmatch.showing.quantities import (
    outputs_unit,
    shown_inputs,
    shown_outputs,
    signal_names,
)
from twinmatch.showing.report import tables
from twinmatch.showing.report.pictures import Picture, fans_of, pictures
from twinmatch.showing.report.words import as_sentence, plain_words, session_facts
from twinmatch.showing.style import LEVELS
from twinmatch.showing.summary import sentence
from twinmatch.showing.verdicts import last_verdict
from twinmatch.signals import one_of_each, point_text
from twinmatch.twin import TwinSettings

_LIBRARIES = ("numpy", "scipy", "numba", "control", "mcap", "matplotlib", "Jinja2")
_CHUNK = 1 << 20


class FileHash(NamedTuple):
    """One file of the session, and its size in bytes."""

    name: str
    size: int
    sha256: str


class RecordedSetting(NamedTuple):
    """One parameter, and whether it differs from the default."""

    name: str
    value: str
    unit: str
    meaning: str
    changed: bool


@dataclass(frozen=True)
class Provenance:
    """Everything needed to repeat a report."""

    made: str
    """Date and time, with the offset from UTC."""
    command: str
    """The command line, or a description of the call."""
    versions: tuple[tuple[str, str], ...]
    files: tuple[FileHash, ...]
    settings: tuple[RecordedSetting, ...]


def provenance(
    path: Path, settings: TwinSettings, command: str, made: datetime
) -> Provenance:
    """Collect the provenance of a session, a file or a folder, judged with these settings."""
    files = (
        sorted(file for file in path.rglob("*") if file.is_file())
        if path.is_dir()
        else [path]
    )
    return Provenance(
        made=made.isoformat(sep=" ", timespec="seconds"),
        command=command,
        versions=_versions(),
        files=tuple(_hash(file, path) for file in files),
        settings=settings_of(settings),
    )


def settings_of(settings: TwinSettings) -> tuple[RecordedSetting, ...]:
    """Every parameter with unit and meaning, under its name in a parameter file."""
    values = values_of(settings)
    return tuple(
        RecordedSetting(
            p.name,
            _text(values[p.name]),
            p.unit,
            p.description,
            values[p.name] != p.default,
        )
        for p in table_of(settings)
        if p.name in values
    )


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(_text(v) for v in value) or "none"
    if isinstance(value, float):
        return f"{value:g}".replace("inf", "∞").replace("-", "−")
    return str(value)


def _versions() -> tuple[tuple[str, str], ...]:
    of_program = (
        ("twinmatch", twinmatch.__version__),
        ("Python", platform.python_version()),
    )
    libraries = ((name, _version(name)) for name in _LIBRARIES)
    return (
        *of_program,
        *libraries,
        ("system", f"{platform.system()} {platform.machine()}"),
    )


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:  # used from a folder that holds no metadata
        return "version unknown"


def _hash(file: Path, path: Path) -> FileHash:
    digest = hashlib.sha256()
    try:
        with file.open("rb") as stream:
            while chunk := stream.read(_CHUNK):
                digest.update(chunk)
            size = stream.tell()
    except OSError as error:
        raise TwinmatchError(f"{file}: cannot be read ({error.strerror})") from error
    name = str(file.relative_to(path)) if file != path else file.name
    return FileHash(name, size, digest.hexdigest())


@dataclass(frozen=True, eq=False)
class JudgedSession:
    """A session, its judgement, and the origin of its parameters and verdicts."""

    session: Session
    judgement: Judgement
    listener: Listener
    """Has the forecasts made during the judgement."""
    parameters: str
    """Where the parameters came from, in words."""
    recorded: str
    """How the verdicts in the session compare with those of the judgement, in a sentence."""
    identical: bool | None
    """Whether they are the same bit for bit; None if there are none, or they cannot be compared."""
    watch: Watch | None = None
    """Called with the progress of the backtest."""

    @cached_property
    def tests(self) -> tuple[Backtest, ...]:
        """The forecasts made during the judgement, compared with the measurements, output by output."""
        return graded_outputs(self.judgement, self.listener, watch=self.watch)

    @property
    def tested(self) -> Backtest:
        """The only one of these comparisons, of a plant with one output."""
        return one_of_each("output", self.tests)


def judge_for_report(path: Path, config: Path | None = None) -> JudgedSession:
    """Judge a session, an `.mcap` file or a recording for a report, with the parameters of a file, or those
    and the initial candidates recorded with it, otherwise the defaults.

    Raises:
        TwinmatchError: the file cannot be used.
    """
    session = open_any(path)
    return _judge(session, *_terms(session, config))


def _terms(
    session: Session, config: Path | None = None, candidates: Path | None = None
) -> tuple[Terms, str]:
    """The terms, and why the verdicts cannot be compared with the recorded ones; empty if they can."""
    try:
        return recorded_terms(session, config, candidates), ""
    except TwinmatchError as error:
        return terms_from_files(session, config, candidates), str(error)


def _judge(
    session: Session,
    terms: Terms,
    why_incomparable: str,
    *,
    peers: Sequence[str] = tuple(PEERS),
    watch: Watch | None = None,
) -> JudgedSession:
    listener = Listener(session.name, terms.settings, Choices(peers=tuple(peers)))
    judgement = judge(session, terms, watch=part_of(watch, 0, 2), beside=listener)
    recorded, identical = _verify(session, judgement, why_incomparable)
    watch_rest = part_of(watch, 1, 2)
    return JudgedSession(
        session, judgement, listener, terms.source, recorded, identical, watch_rest
    )


def _verify(
    session: Session, judgement: Judgement, why_incomparable: str
) -> tuple[str, bool | None]:
    """How recorded verdicts compare with those of the judgement, in words, and whether they are identical.

    `why_incomparable` is empty if they can be compared.
    """
    count = holds_verdicts(session)
    if not count:
        return (
            "The session has no recorded verdicts; all of them were computed for this report.",
            None,
        )
    recomputed = "They were computed again for this report and"
    try:
        comparison = None if why_incomparable else compare(session, judgement)
    except TwinmatchError as error:
        comparison = None
        why_incomparable = str(error)
    if comparison is None:
        recorded = f"The session has {count} recorded verdicts."
        return (
            f"{recorded} {recomputed} could not be compared with the recorded ones: {why_incomparable}.",
            None,
        )
    matches = f"{comparison.matches} match{'' if comparison.matches == 1 else 'es'}"
    recorded = f"The session has {comparison.verdicts} recorded verdicts and {matches}."
    if comparison.identical:
        return f"{recorded} {recomputed} are the same, bit for bit.", True
    return (
        f"{recorded} {recomputed} differ from the recorded ones. First difference: {comparison.difference}.",
        False,
    )


@dataclass(frozen=True, eq=False)
class SessionReport:
    """The content of a report, ready for layout."""

    judged: JudgedSession
    members: tuple[Member, ...]
    pictures: dict[str, Picture]
    provenance: Provenance
    memory: tuple[str, ...] = ()
    """What earlier sessions say about the rig, in sentences."""

    @property
    def name(self) -> str:
        """Name of the session."""
        return self.judged.judgement.name

    @property
    def sentence(self) -> str:
        """The summary in one line."""
        return sentence(self.judged.judgement.summary)

    @property
    def nominal(self) -> Member | None:
        """The nominal candidate; None without one, or if its window is not in the session."""
        return next((m for m in self.members if m.nominal), None)

    def html(self) -> str:
        """The report as one HTML document that loads nothing else."""
        # all text is escaped; a name the template does not know is an error
        environment = Environment(
            loader=PackageLoader("twinmatch.showing.report", "."),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters |= {
            "sentence": as_sentence,
            "short": lambda value: f"{value:g}",
        }
        return environment.get_template("report.html").render(self._content())

    def write(self, path: Path) -> None:
        """Write the document.

        Raises:
            TwinmatchError: the file cannot be written.
        """
        try:
            path.write_text(self.html(), encoding="utf-8")
        except OSError as error:
            raise TwinmatchError(
                f"{path}: the report cannot be written: {error.strerror}"
            ) from error

    def _content(self) -> dict[str, object]:
        judged = self.judged
        judgement = self.judged.judgement
        settings = self.judged.judgement.settings
        last = last_verdict(judgement.verdicts)
        nominal = self.nominal
        tests = judged.tests
        words = [
            *plain_words(judgement),
            *(line for tested in tests for line in backtest_words(tested)[-1:]),
        ]
        other_members = [m for m in self.members if not m.nominal and m.modelled]
        period = settings.period
        trust = judgement.summary.trust
        closed = settings.law is not None
        plant = settings.plant
        matched = settings.start.model.structure_name
        return {
            "name": self.name,
            "sentence": self.sentence,
            "level": trust.level.value,
            "level_colour": LEVELS[trust.level],
            "level_words": trust.reason,
            "words": [*words, *self.memory],
            "tested": [_tested(tested, judgement, k) for k, tested in enumerate(tests)],
            "estimates": [course.line(period) for course in judgement.estimates],
            "by_signal": tables.signal_table(last),
            "peers": _peer_words(judged.listener.common.peers, closed=closed),
            "horizons": ", ".join(f"{h:g}" for h in tests[0].horizons),
            "confidence": f"{100 * tests[0].confidence:.0f}",
            "forecast_notes": list(
                dict.fromkeys(note for tested in tests for note in tested.notes)
            ),
            "facts": session_facts(judgement),
            "notes": judgement.summary.notes,
            "pictures": self.pictures,
            "events": tables.event_table(judgement.verdicts, period),
            "match": nominal.match if nominal else None,
            "nominal_parameters": tables.nominal_table(nominal.score, nominal.match)
            if nominal
            else None,
            "family": tables.family_table(self.members),
            "matches": tables.match_table(
                judgement.matches, judgement.verdicts, period, closed=closed
            ),
            "meanings": {c.label: c.meaning for c in (*CRITERIA, *FIGURES)},
            **_of_verdict(last, plant),
            "coefficients": tables.coefficient_table(nominal)
            if nominal and nominal.modelled
            else None,
            "other_coefficients": list(map(tables.coefficient_table, other_members)),
            "limits": settings.limits,
            "schedule": settings.schedule,
            "judged": judged,
            **_of_plant(plant),
            "closed": closed,
            "asked": "set-point" if closed else "input",
            "others": ", ".join(n for n in plant.structures if n != matched),
            "provenance": self.provenance,
        }


def _of_plant(plant: type[Plant]) -> dict[str, object]:
    """The plant, and its signals in words."""
    return {
        "plant": plant,
        "called": signal_names(plant) if plant.single else None,
        "outputs": number_list(map(str, shown_outputs(plant))),
        "inputs": number_list(map(str, shown_inputs(plant))),
        "sensors": number_list(
            dict.fromkeys(output.sensor for output in plant.outputs.values())
        ),
        "unit": outputs_unit(plant),
    }


def _of_verdict(verdict: Verdict | None, plant: type[Plant]) -> dict[str, object]:
    """What the sections on models and distances show of the last verdict."""
    if verdict is None:
        empty = dict.fromkeys(("verdict", "weights", "structure", "gaps", "identified"))
        return {**empty, "criteria": [], "gap_points": []}
    return {
        "verdict": verdict,
        "criteria": tables.criterion_tables(verdict),
        "weights": tables.order_table(verdict),
        "structure": tables.structure_table(verdict),
        "gaps": tables.gap_table(verdict),
        "identified": tables.identified_table(verdict) if verdict.modelled else None,
        "gap_points": _points(verdict, plant),
    }


def _tested(tested: Backtest, judgement: Judgement, k: int) -> dict[str, object]:
    """What section 3 shows of the k-th output."""
    single = judgement.settings.plant.single
    ending = f"_{next(iter(tested.plant.outputs))}" if k else ""
    return {
        "name": "" if single else signal_names(tested.plant).output.name,
        "sentences": backtest_words(tested),
        "tables": tables.forecast_tables(tested),
        "picture": f"forecasts{ending}",
        "leader": f"leader_forecasts{ending}",
        "fans": tables.leader_forecast_table(
            fans_of(tested, judgement, k), tested.plant
        ),
    }


def _points(verdict: Verdict, plant: type[Plant]) -> list[str]:
    """The operating points at which plants are compared."""
    points = verdict.nu_gap_points
    size = len(plant.outputs)
    return [point_text(points[k : k + size]) for k in range(0, len(points), size)]


def _peer_words(names: Sequence[str], *, closed: bool) -> list[str]:
    """What the methods do that the forecasts are compared with."""
    words = {
        "persistence": "everything stays as it is (persistence)",
        "arx": "least squares (ARX)"
        if closed
        else "least squares on the same inputs (ARX)",
    }
    return [words[name] for name in words if name in names]


def build_report(
    judged: JudgedSession,
    path: Path,
    *,
    command: str = "from Python",
    made: datetime | None = None,
    work: Beside | None = None,
) -> SessionReport:
    """Build the report of a judged session; `path` is where the session was read from, `work` draws some of
    the figures."""
    judgement = judged.judgement
    last = last_verdict(judgement.verdicts)
    settings = judgement.settings
    members = family(
        judgement.samples, judgement.matches, last, settings, judgement.models
    )
    drawn = pictures(judgement, members, judged.tests, work or Beside())
    made = made or datetime.now().astimezone()
    return SessionReport(
        judged, members, drawn, provenance(path, settings, command, made)
    )


def _load_what_draws_and_is_drawn(judged: JudgedSession) -> None:
    """Do what both processes would do, each for itself, if it were left until the figures are drawn.

    The forecasts are scored here, too: to hand them over, and to load their kernels twice, takes as long as a second
    process would save.
    """
    for module in ("matplotlib.backends.backend_svg", "matplotlib.figure"):
        import_module(module)
    _ = judged.tests


def make_report(
    path: Path,
    *,
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    peers: Sequence[str] = tuple(PEERS),
    watch: Watch | None = None,
    progress: ProgressCallback | None = None,
    command: str = "from Python",
    second: bool = False,
    memory: Path | None = None,
    rig: str = "",
) -> SessionReport:
    """Judge a session, an `.mcap` file or a recording and build a report on it.

    Args:
        path: the session or recording.
        config: parameter file; without one the parameters recorded with the session, or the defaults.
        candidates: file of initial candidates.
        plant: name or file of the plant, if the session does not name it or it is in a file.
        peers: names of the methods that the forecasts are compared with.
        watch: called with the progress.
        progress: called with the amount of the file read and the total.
        command: command line shown in the report.
        second: whether a second process may draw some of the figures; it is a fork of this one.
        memory, rig: file of earlier sessions and name of the rig, for what has changed between them; without
            a file that of the rig, if one is named.

    Raises:
        TwinmatchError: one of the files cannot be used.
    """
    session = open_any(path, progress=progress, plant=plant)
    terms, why_incomparable = _terms(session, config, candidates)
    judged = _judge(session, terms, why_incomparable, peers=peers, watch=watch)
    _load_what_draws_and_is_drawn(judged)
    with beside(possible=second and portable(terms.settings.plant)) as work:
        report = build_report(judged, path, command=command, work=work)
    if memory is None and not rig:
        return report
    # a memory holds what laws have done, and loads all that judges laws
    from twinmatch.showing.memory import memory_words  # noqa: PLC0415

    return replace(
        report, memory=tuple(memory_words(terms.settings.plant, memory, rig))
    )
