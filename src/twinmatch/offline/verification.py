"""Judges a recorded session again and compares the verdicts with the recorded ones, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinmatch.comparing import Verdict
from twinmatch.dynamics import Plant
from twinmatch.errors import TwinmatchError
from twinmatch.fmu import is_fmu, unmarked
from twinmatch.importing import open_any
from twinmatch.offline.judging import Judgement, Watch, judge, prefix_of, recorded_terms
from twinmatch.record import Tree, comparable, differences, tree_of, tree_of_message
from twinmatch.sessions import Session
from twinmatch.sessions.cdr import decoded
from twinmatch.sessions.files import ProgressCallback
from twinmatch.signals import Sample
from twinmatch.twin import MatchReport

SCORES = "twin/model_score"
MATCHES = "twin/match"
DESCRIPTION = "plant/description"
AT_THE_END = 60
"""A verdict triggered so few samples, or seconds, before the end may be missing from the recording."""
SENTENCES = frozenset({"reason", "certainty", "suggestion", "determined"})
"""Text fields. Their content is in other fields too, so later versions may reword them."""


class VerifyError(TwinmatchError):
    """The session cannot be verified."""


@dataclass(frozen=True)
class Difference:
    """The first difference between recorded and recomputed verdicts or matches."""

    what: str
    """`verdict` or `match`."""
    number: int
    """Its number, from 1."""
    sample: int
    """Sample that triggered it."""
    candidate: str
    """Name of the candidate that the field belongs to; empty: none."""
    field: str
    recorded: Any
    computed: Any

    def __str__(self) -> str:
        of_candidate = f", candidate {self.candidate}" if self.candidate else ""
        return (
            f"{self.what} {self.number} at sample {self.sample}{of_candidate}: {self.field} was recorded as "
            f"{self.recorded!r} and is {self.computed!r} now"
        )


@dataclass(frozen=True)
class Verification:
    """Result of a comparison."""

    name: str
    samples: int
    verdicts: int
    """Recorded verdicts that were compared."""
    matches: int
    """Recorded matches that were compared."""
    difference: Difference | None
    notes: tuple[str, ...] = ()

    @property
    def identical(self) -> bool:
        """Whether not a single bit differs."""
        return self.difference is None


def verify_session(
    path: Path,
    *,
    topic: str | None = None,
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    watch: Watch | None = None,
    progress: ProgressCallback | None = None,
) -> Verification:
    """Judge a session again and compare matches and verdicts with the recorded ones.

    Args:
        path: session folder or `.mcap` file.
        topic: topic of the samples, if the session has several rigs.
        config, candidates: files to use instead of what was recorded.
        plant: name or file of the plant, if the session does not name it or it is in a file.
        watch, progress: called with the progress of judging and of reading.

    Raises:
        VerifyError: the session has no verdicts.
        TermsError: the parameters of the verdicts are not recorded, or cannot be used.
        ForeignError: the FMUs of the verdicts are missing.
        TwinmatchError: one of the files cannot be used.
    """
    session = open_any(path, topic, progress, plant=plant)
    if not holds_verdicts(session):
        raise VerifyError(
            f"session {session.name}: has no verdicts on {prefix_of(session)}{SCORES} to verify; "
            "judge it with twinmatch replay"
        )
    terms = recorded_terms(session, config, candidates)
    check_fmus(session.name, terms.settings.plant, _structures(session))
    return compare(session, judge(session, terms, watch=watch))


def _structures(session: Session) -> list[str]:
    """Names of the plant's structures at the time of recording; empty if they were not recorded."""
    described = _messages(session, prefix_of(session) + DESCRIPTION)
    return [str(s) for message in described for s in message.structures]


def holds_verdicts(session: Session) -> int:
    """How many verdicts were recorded with the session's samples."""
    return session.counts.get(prefix_of(session) + SCORES, 0)


def compare(session: Session, judgement: Judgement) -> Verification:
    """Compare the recorded matches and verdicts with a judgement of the samples, bit for bit."""
    prefix = prefix_of(session)
    stamps = judgement.stamps  # a verdict may be due at a lost sample
    matches = _without_repeats(_records_of(session, prefix + MATCHES))
    scores = _records_of(session, prefix + SCORES)
    computed_matches = [_computed_tree(m, stamps[m.sample]) for m in judgement.matches]
    computed_scores = [_computed_tree(v, stamps[v.sample]) for v in judgement.verdicts]
    comparison = _Comparison(session.samples[-1])
    difference = comparison.first("match", matches, computed_matches)
    difference = difference or comparison.first("verdict", scores, computed_scores)
    notes = [*session.notes, *comparison.notes()]
    missing = len(computed_scores) - len(scores)
    if difference is None and missing > 0:
        count = "1 verdict" if missing == 1 else f"{missing} verdicts"
        notes.append(f"{count} at the very end came after the recording had stopped")
    if session.samples[0].index:
        notes.append(
            f"the recording begins at sample {session.samples[0].index}; the twin may know more"
        )
    return Verification(
        session.name,
        len(session.samples),
        len(scores),
        len(matches),
        difference,
        tuple(notes),
    )


def _records_of(session: Session, name: str) -> list[Tree]:
    return [
        comparable(tree_of_message(message)) for message in _messages(session, name)
    ]


def _computed_tree(record: Verdict | MatchReport, stamp: int) -> Tree:
    """A computed verdict or match in the form in which recorded ones are compared."""
    return comparable({"stamp": stamp, **tree_of(record)})


def _without_repeats(matches: list[Tree]) -> list[Tree]:
    """The matches without repeated ones: a match requested twice is answered twice."""
    distinct = []
    before: Tree = {}
    for match in matches:
        if next(differences(match, before), None) is not None:
            distinct.append(match)
        before = match
    return distinct


def _messages(session: Session, name: str) -> Iterator[Any]:
    """The messages of a topic, if the session has it."""
    return map(decoded, session.messages([name]) if name in session.counts else ())


class _Comparison:
    """Compares recorded trees with computed ones, and collects what does not count as a difference."""

    def __init__(self, last: Sample) -> None:
        """Begin without records; `last` is the last sample of the session."""
        self._last = last
        self._in_one_form_only: set[str] = set()
        """Fields that only the recorded or only the computed form has."""
        self._reworded: set[str] = set()
        """Fields of text that differ."""

    def first(
        self, kind: str, recorded: list[Tree], computed: list[Tree]
    ) -> Difference | None:
        """The first difference between records of a kind, match or verdict, if there is one."""
        for number, (before, after) in enumerate(
            zip(recorded, computed, strict=False), 1
        ):
            difference = next(self._differences(before, after), None)
            if difference is not None:
                field, was, is_now = difference
                return Difference(
                    kind,
                    number,
                    before["sample"],
                    _owner(before, field),
                    field,
                    was,
                    is_now,
                )
        number = min(len(recorded), len(computed))
        if len(recorded) > number:
            sample = recorded[number]["sample"]
            return Difference(
                kind, number + 1, sample, "", "all of it", "there", "absent"
            )
        if len(computed) > number and not self._at_the_end(computed[number]):
            sample = computed[number]["sample"]
            return Difference(
                kind, number + 1, sample, "", "all of it", "absent", "there"
            )
        return None

    def notes(self) -> list[str]:
        """Notes on what was not compared."""
        notes = []
        for fields, why in (
            (
                self._in_one_form_only,
                "recorded in another form; fields that only one form has",
            ),
            (self._reworded, "this version words some texts differently; they"),
        ):
            if fields:
                notes.append(f"{why} were not compared: {', '.join(sorted(fields))}")
        return notes

    def _differences(
        self, recorded: Tree, computed: Tree
    ) -> Iterator[tuple[str, Any, Any]]:
        """Field, recorded and computed value of each difference that counts."""
        in_one_only: set[str] = set()
        all_differences = list(differences(recorded, computed, apart=in_one_only))
        self._in_one_form_only |= {
            field.removeprefix("candidates.") for field in in_one_only
        }
        for field, was, is_now in all_differences:
            if field.rsplit(".", 1)[-1] in SENTENCES:
                self._reworded.add(field)
            else:
                yield field, was, is_now

    def _at_the_end(self, tree: Tree) -> bool:
        """Whether the session may have ended before this could be published."""
        samples = self._last.index - tree["sample"]
        seconds = (self._last.stamp - tree["stamp"]) / 1e9
        return bool(min(samples, seconds) < AT_THE_END)


def _owner(tree: Mapping[str, Any], field: str) -> str:
    """Name of the candidate a field such as `candidates[2].nu_gap_sum` belongs to."""
    if not field.startswith("candidates["):
        return ""
    row = int(field.removeprefix("candidates[").split("]", 1)[0])
    return str(tree["candidates"][row]["name"])


class ForeignError(TwinmatchError):
    """The FMUs that a session was judged with are missing, or there are others."""


def check_fmus(name: str, plant: type[Plant], recorded: Sequence[str]) -> None:
    """Compare the FMUs among the recorded structures with those of the plant now.

    Raises:
        ForeignError: they differ.
    """
    recorded_fmus = [structure for structure in recorded if is_fmu(structure)]
    usable_fmus = [
        name
        for name, structure in plant.structures.items()
        if structure.external and not structure.external.lost and is_fmu(name)
    ]
    missing = [name for name in recorded_fmus if name not in usable_fmus]
    additional = [name for name in usable_fmus if name not in recorded_fmus]
    if missing:
        same_name = [
            name for name in additional if unmarked(name) == unmarked(missing[0])
        ]
        hint = (
            f"; the one given, {same_name[0]!r}, is another FMU or has another map"
            if same_name
            else ""
        )
        raise ForeignError(
            f"session {name}: was judged with the structure {missing[0]!r}, an FMU{hint}; give that FMU's "
            "map file with --allow-fmu FILE"
        )
    if additional:
        raise ForeignError(
            f"session {name}: was judged without the FMU {additional[0]!r}; leave out --allow-fmu"
        )
