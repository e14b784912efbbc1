"""Judges a recorded session again and compares the verdicts with the recorded ones, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinmatch.discrimination import Candidate
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.twin_parameters import read_settings, recorded_values, settings_from
from twinmatch.sessions import Session, Topic, read_session
from twinmatch.sessions.candidates import parse_candidates, read_candidates
from twinmatch.sessions.settings import CANDIDATES, parameters_of
from twinmatch.twin import Twin, TwinSettings
from twinmatch.verify_trees import Tree, differences, match_tree, message_tree, verdict_tree

__all__ = ["Difference", "Verification", "VerifyError", "verify_session"]

SAMPLE = "plant/sample"
SCORES = "twin/model_score"
MATCHES = "twin/match"
AT_THE_END = 60
"""What was set off within so many samples of the end may have come after the recorder had gone."""


class VerifyError(TwinmatchError):
    """A session that cannot be verified."""


@dataclass(frozen=True)
class Difference:
    """The first place where recorded and recomputed part."""

    what: str
    """`verdict` or `match`."""
    number: int
    """Which of them, from 1."""
    sample: int
    """Sample that set it off."""
    candidate: str
    """Name of the candidate the field belongs to; empty: none."""
    field: str
    recorded: Any
    computed: Any

    def __str__(self) -> str:
        whose = f", candidate {self.candidate}" if self.candidate else ""
        return (
            f"{self.what} {self.number} at sample {self.sample}{whose}: {self.field} was recorded as "
            f"{self.recorded!r} and is {self.computed!r} now"
        )


@dataclass(frozen=True)
class Verification:
    """What a comparison came to."""

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
    watch: Callable[[int, int], None] | None = None,
) -> Verification:
    """Recompute matches and verdicts from the recorded samples and compare them with the recorded ones.

    Args:
        path: session folder or `.mcap` file.
        topic: topic of the samples, if the session has several rigs.
        config: parameters to use instead of the recorded ones.
        candidates: candidates to begin with instead of the recorded ones.
        watch: called with (samples done, samples in all) now and then.

    Raises:
        VerifyError: no verdicts, or not the parameters they were made with.
        TwinmatchError: one of the files cannot be used.
    """
    session = read_session(path, topic)
    place = f"session {session.name}"
    prefix = session.topic.removesuffix(SAMPLE)
    scores, matches = _recorded(session, prefix + SCORES), _once(_recorded(session, prefix + MATCHES))
    if not scores:
        msg = (
            f"{place}: holds no verdicts on {prefix}{SCORES}; nothing to verify, twinmatch replay makes some"
        )
        raise VerifyError(msg)
    twin = _twin(session, prefix, config, candidates)
    computed_matches, computed_scores = _judge(session, twin, watch)
    last = session.samples[-1].index
    difference = _compare("match", matches, computed_matches, last) or _compare(
        "verdict", scores, computed_scores, last
    )
    notes = list(session.notes)
    if difference is None and len(scores) < len(computed_scores):
        notes.append(
            f"{len(computed_scores) - len(scores)} verdicts at the very end were not recorded any more"
        )
    if session.samples[0].index:
        notes.append(f"the recording begins at sample {session.samples[0].index}; the twin may know more")
    return Verification(
        session.name, len(session.samples), len(scores), len(matches), difference, tuple(notes)
    )


def _recorded(session: Session, name: str) -> list[Tree]:
    topic = next((t for t in session.topics if t.name == name), None)
    if topic is None:
        return []
    decode = _decoder(topic, session.name)
    return [message_tree(decode(message.data)) for message in session.messages([name])]


def _once(matches: list[Tree]) -> list[Tree]:
    """Without those that say what the one before says: one asked for twice is answered twice."""
    return [
        m
        for m, before in zip(matches, [None, *matches], strict=False)
        if before is None or _differ(m, before)
    ]


def _differ(one: Tree, other: Tree) -> bool:
    return next(differences(one, other), None) is not None


def _decoder(topic: Topic, name: str) -> Callable[[bytes], Any]:
    from mcap.records import Schema  # noqa: PLC0415 - the command line starts without it
    from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415

    schema = Schema(id=1, data=topic.schema.encode(), encoding="ros2msg", name=topic.type)
    decode = DecoderFactory().decoder_for("cdr", schema)
    if decode is None:
        msg = f"session {name}: {topic.name} cannot be decoded"
        raise VerifyError(msg)
    result: Callable[[bytes], Any] = decode
    return result


def _twin(session: Session, prefix: str, config: Path | None, candidates: Path | None) -> Twin:
    """The twin as it was when the session was recorded."""
    if config is not None:
        matching = judging = read_settings(config)
        begun_with = ""
    else:
        matching, _ = _settings(session, prefix + "matcher")
        judging, begun_with = _settings(session, prefix + "discriminator")
    given = read_candidates(candidates) if candidates is not None else _given(session, begun_with)
    return Twin(judging, given, matching=matching)


def _settings(session: Session, node: str) -> tuple[TwinSettings, str]:
    """Settings of a node, and the file of candidates it was given."""
    place = f"session {session.name}"
    recorded = parameters_of(session.records, node)
    if recorded is None:
        msg = (
            f"{place}: the parameters of {node} were not recorded; give them with --config, "
            "or record with the recorder running beside the twin"
        )
        raise VerifyError(msg)
    try:
        values = recorded_values(f"{place}: {node}", recorded)
        return settings_from(values), str(values["candidates"])
    except TwinmatchError as error:
        msg = f"{place}: the recorded parameters of {node} are of another version: {error}"
        raise VerifyError(msg) from error


def _given(session: Session, path: str) -> Sequence[Candidate]:
    if not path:
        return []
    text = session.records.get(CANDIDATES, {}).get("text", "")
    if not text:
        msg = (
            f"session {session.name}: began with the candidates of {path}, which were not recorded; "
            "give them with --candidates"
        )
        raise VerifyError(msg)
    return parse_candidates(text, f"session {session.name}: candidates")


def _judge(
    session: Session, twin: Twin, watch: Callable[[int, int], None] | None
) -> tuple[list[Tree], list[Tree]]:
    stamps: dict[int, int] = {}
    matches: list[Tree] = []
    scores: list[Tree] = []
    for done, sample in enumerate(session.samples):
        stamps[sample.index] = sample.stamp
        outcome = twin.push(sample)
        if outcome.match is not None:
            matches.append(match_tree(outcome.match, sample.stamp))
        scores += [verdict_tree(verdict, stamps[verdict.sample]) for verdict in outcome.verdicts]
        if watch is not None and done % 50 == 0:
            watch(done, len(session.samples))
    return matches, scores


def _compare(what: str, recorded: list[Tree], computed: list[Tree], last: int) -> Difference | None:
    for number, (one, other) in enumerate(zip(recorded, computed, strict=False), 1):
        for field, was, now in differences(one, other):
            return Difference(what, number, one["sample"], _owner(one, field), field, was, now)
    number = min(len(recorded), len(computed))
    if len(recorded) > number:
        return Difference(what, number + 1, recorded[number]["sample"], "", "all of it", "there", "absent")
    if len(computed) > number and computed[number]["sample"] <= last - AT_THE_END:
        return Difference(what, number + 1, computed[number]["sample"], "", "all of it", "absent", "there")
    return None


def _owner(tree: Mapping[str, Any], field: str) -> str:
    """Name of the candidate a field such as `candidates[2].nu_gap_sum` belongs to."""
    if not field.startswith("candidates["):
        return ""
    row = int(field.removeprefix("candidates[").split("]", 1)[0])
    return str(tree["candidates"][row]["name"])
