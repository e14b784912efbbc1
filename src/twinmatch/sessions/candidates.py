"""A file of candidates to begin with, such as the parameter sets of a paper or of an earlier session.

candidates:
  - name: paper, 50 °C
    operating_point: 50.0    # °C
    seebeck: 0.0825          # V/K
    conductance: 0.35        # W/K
    heat_capacity: 31.93     # J/K
    # other parameters of the structure: as the plant file has them unless given
    # plant: peltier          # the first of a plant's structures unless given
    # structure: held sink
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from twinmatch.discrimination.family import Candidate
from twinmatch.errors import TwinmatchError
from twinmatch.plants import Peltier
from twinmatch.plants.written import parameters_from

__all__ = ["CandidateFileError", "parse_candidates", "read_candidates"]

_WORDS = ("name", "plant", "structure")


class CandidateFileError(TwinmatchError):
    """A file of candidates that cannot be used."""


def read_candidates(path: Path) -> list[Candidate]:
    """Read a family to begin with.

    Raises:
        CandidateFileError: the file is not there, is no YAML, or an entry is incomplete or wrong.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise CandidateFileError(msg) from error
    except UnicodeDecodeError as error:
        msg = f"{path}: is no YAML file: {error}"
        raise CandidateFileError(msg) from error
    return parse_candidates(text, str(path))


def parse_candidates(text: str, path: str) -> list[Candidate]:
    """A family to begin with from the text of a file; `path` begins the messages.

    Raises:
        CandidateFileError: the text is no YAML, or an entry is incomplete or wrong.
    """
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        msg = f"{path}: is no YAML file: {str(error).splitlines()[0]}"
        raise CandidateFileError(msg) from error
    entries = content.get("candidates") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries:
        msg = f"{path}: has no list 'candidates'"
        raise CandidateFileError(msg)
    candidates = [_candidate(entry, f"{path}: candidate {k}") for k, entry in enumerate(entries, 1)]
    names = [c.name for c in candidates]
    for name in names:
        if names.count(name) > 1:
            msg = f"{path}: two candidates are called {name!r}; give each a name of its own"
            raise CandidateFileError(msg)
    return candidates


def _candidate(entry: Any, place: str) -> Candidate:
    if not isinstance(entry, dict):
        msg = f"{place}: is {entry!r}; give name, operating_point and the parameters"
        raise CandidateFileError(msg)
    for key in ("name", "operating_point"):
        if key not in entry:
            msg = f"{place}: {key} is missing"
            raise CandidateFileError(msg)
    try:
        numbers = {str(key): _number(key, value) for key, value in entry.items() if key not in _WORDS}
        operating_point = numbers.pop("operating_point")
        plant, structure = str(entry.get("plant", Peltier.name)), str(entry.get("structure", ""))
        parameters = parameters_from(plant, structure, numbers)
    except TwinmatchError as error:
        msg = f"{place}: {error}"
        raise CandidateFileError(msg) from error
    return Candidate(str(entry["name"]), operating_point, parameters, None)


def _number(key: Any, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        msg = f"{key} is {value!r}; give a number"
        raise CandidateFileError(msg)
    return float(value)
