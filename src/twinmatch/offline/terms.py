"""Parameters and candidates with which a session is judged: those recorded with it, or those of files."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from twinmatch.comparing import Candidate
from twinmatch.errors import TwinmatchError
from twinmatch.parameters.twin import at_period, read_settings, recorded_values, settings_from
from twinmatch.sessions import Session
from twinmatch.sessions.candidates import parse_candidates, read_candidates
from twinmatch.sessions.metadata import CANDIDATES, parameters_of
from twinmatch.twin import TwinSettings

__all__ = ["SAMPLE", "Terms", "TermsError", "prefix_of", "recorded_terms", "terms_from_files"]

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


def terms_from_files(session: Session, config: Path | None = None, candidates: Path | None = None) -> Terms:
    """Parameters and candidates of files; without files the defaults and no candidates.

    Raises:
        TwinmatchError: a file cannot be used, or has another sampling period than the session.
    """
    source = f"the file {config.name}" if config else "the defaults of this version"
    held = read_settings(config, session.plant, driven=not session.has_reference)
    settings = at_period(held, session.period, config)
    return Terms(settings, tuple(read_candidates(candidates)) if candidates else (), source=source)


def recorded_terms(session: Session, config: Path | None = None, candidates: Path | None = None) -> Terms:
    """Parameters and candidates recorded with the session; files override them.

    Raises:
        TermsError: they were not recorded, or are of an incompatible version.
        TwinmatchError: a file cannot be used.
    """
    if config is not None:
        return terms_from_files(session, config, candidates)
    prefix = prefix_of(session)
    matching, _ = _settings(session, f"{prefix}matcher")
    settings, file = _settings(session, f"{prefix}discriminator")
    given = tuple(read_candidates(candidates)) if candidates else _given(session, file)
    return Terms(settings, given, matching, "those recorded with the session")


def _settings(session: Session, node: str) -> tuple[TwinSettings, str]:
    """Recorded settings of a node, and its file of candidates."""
    place = f"session {session.name}"
    recorded = parameters_of(session.records, node)
    if recorded is None:
        msg = (
            f"{place}: the parameters of {node} were not recorded; give them with --config, "
            "or run the recorder together with the twin"
        )
        raise TermsError(msg)
    try:
        values = recorded_values(f"{place}: {node}", recorded)
        return settings_from(values), str(values["candidates"])
    except TwinmatchError as error:
        msg = f"{place}: the recorded parameters of {node} cannot be used: {error}"
        raise TermsError(msg) from error


def _given(session: Session, path: str) -> tuple[Candidate, ...]:
    if not path:
        return ()
    text = session.records.get(CANDIDATES, {}).get("text", "")
    if not text:
        msg = (
            f"session {session.name}: its initial candidates, from {path}, were not recorded; "
            "give them with --candidates"
        )
        raise TermsError(msg)
    return tuple(parse_candidates(text, f"session {session.name}: candidates"))
