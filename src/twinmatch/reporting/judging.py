"""From a path to everything that a report needs: the session judged anew, and what was recorded of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twinmatch.discrimination import Candidate
from twinmatch.errors import TwinmatchError
from twinmatch.nodes.twin_parameters import at_period, read_settings, recorded_values, settings_from
from twinmatch.replay import Judgement, judge_samples
from twinmatch.sessions import Session, open_any
from twinmatch.sessions.candidates import parse_candidates, read_candidates
from twinmatch.sessions.settings import CANDIDATES, parameters_of
from twinmatch.twin import TwinSettings
from twinmatch.verify import SAMPLE, SCORES, verify_session

__all__ = ["Judged", "judge"]

Watch = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Judged:
    """A session, its judgement, and how that came about."""

    session: Session
    judgement: Judgement
    parameters: str
    """Where the parameters came from, in words."""
    recorded: str
    """How the verdicts in the session compare with those of the judgement, in a sentence."""
    identical: bool | None
    """Whether they are the same bit for bit; None where there are none, or where it cannot be told."""


def judge(
    path: Path, *, config: Path | None = None, candidates: Path | None = None, watch: Watch | None = None
) -> Judged:
    """Judge a session, an `.mcap` file or a recording for a report.

    Without `config` the parameters are those that were recorded with the session, and without those the
    defaults; the same holds for the candidates to begin with.

    Raises:
        TwinmatchError: one of the files cannot be used.
    """
    session = open_any(path)
    settings, source, given = _begin(session, config, candidates)
    judgement = judge_samples(
        session.name, session.samples, settings, given=given, notes=session.notes, watch=watch
    )
    recorded, identical = _compare_recorded(path, session, config, candidates, watch)
    return Judged(session, judgement, source, recorded, identical)


def _begin(
    session: Session, config: Path | None, candidates: Path | None
) -> tuple[TwinSettings, str, Sequence[Candidate]]:
    """Settings, where they came from, and the candidates to begin with."""
    recorded = None if config else _recorded_parameters(session)
    if recorded is None:
        settings = at_period(read_settings(config), session.period, config)
        source = f"the file {config.name}" if config else "the defaults of this version"
        return settings, source, read_candidates(candidates) if candidates else []
    values, settings = recorded
    given: Sequence[Candidate] = read_candidates(candidates) if candidates else []
    if not given and values["candidates"]:
        text = session.records.get(CANDIDATES, {}).get("text", "")
        given = parse_candidates(text, f"session {session.name}: candidates") if text else []
    return settings, "those that were recorded with the session", given


def _recorded_parameters(session: Session) -> tuple[dict[str, object], TwinSettings] | None:
    """What the discriminator ran with, if that was recorded and this version understands it."""
    node = f"{_prefix(session)}discriminator"
    try:
        found = parameters_of(session.records, node)
        if found is None:
            return None
        values = recorded_values(f"session {session.name}: {node}", found)
        return values, settings_from(values)
    except TwinmatchError:
        return None


def _compare_recorded(
    path: Path, session: Session, config: Path | None, candidates: Path | None, watch: Watch | None
) -> tuple[str, bool | None]:
    count = session.counts.get(f"{_prefix(session)}{SCORES}", 0)
    if not count:
        return "The session holds no recorded verdicts; all of them were computed for this report.", None
    try:
        found = verify_session(path, topic=session.topic, config=config, candidates=candidates, watch=watch)
    except TwinmatchError as error:
        return (
            f"The session holds {count} recorded verdicts. They were computed anew for this report and could "
            f"not be compared with the recorded ones: {error}."
        ), None
    if found.identical:
        return (
            f"The session holds {found.verdicts} recorded verdicts and {_matches(found.matches)}. They were "
            "computed anew for this report and are the same, bit for bit."
        ), True
    return (
        f"The session holds {found.verdicts} recorded verdicts and {_matches(found.matches)}. Here they "
        f"are computed anew, and they differ from the recorded ones. First difference: {found.difference}."
    ), False


def _matches(count: int) -> str:
    return f"{count} match{'' if count == 1 else 'es'}"


def _prefix(session: Session) -> str:
    return session.topic.removesuffix(SAMPLE)
