"""A file of initial candidates, such as the parameter sets of a paper or of an earlier session.

candidates:
  - name: paper, 50 °C
    operating_point: 50.0    # °C
    seebeck: 0.0825          # V/K
    conductance: 0.35        # W/K
    heat_capacity: 31.93     # J/K
    # other parameters of the structure: those of the plant file, unless given
    # plant: peltier          # the first of a plant's structures unless given
    # structure: held sink
  - name: remembered         # what earlier sessions have shown: forecasts from the first sample on
    operating_point: 50.0
    seebeck: 0.0825
    conductance: 0.35
    heat_capacity: 31.93
    deviations:              # of the free parameters, between those sessions: the prior of all fits
      seebeck: 0.005
      conductance: 0.02
      heat_capacity: 1.5
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml

from twinmatch.comparing.models import Candidate
from twinmatch.decoding import decoded
from twinmatch.dynamics import Parameters, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.plants import Peltier, find_plant, plant_named, written_name
from twinmatch.plants.records import parameters_from
from twinmatch.sessions.documents import parse_yaml, read_text, shown
from twinmatch.signals import FloatArray, point_of

MAX_NAME = 200
"""Longest name, characters."""


class _Entry(msgspec.Struct):
    """What an entry has besides its parameters."""

    name: str | float
    operating_point: float | list[float]
    plant: str | float = Peltier.name
    structure: str | float = ""
    deviations: dict[str, Any] = {}


class CandidateFileError(TwinmatchError):
    """A file of candidates cannot be used."""


def read_candidates(path: Path) -> list[Candidate]:
    """Read initial candidates from a file.

    Raises:
        DocumentError: the file does not exist, or is not YAML.
        CandidateFileError: an entry is incomplete or wrong.
    """
    return parse_candidates(read_text(path), str(path), find_plant)


def candidates_in(values: Mapping[str, Any]) -> list[Candidate]:
    """The candidates of the file that a node's parameters name, if they name one."""
    return read_candidates(Path(values["candidates"])) if values["candidates"] else []


def parse_candidates(
    text: str, path: str, find: Callable[[str], type[Plant]] = plant_named
) -> list[Candidate]:
    """Parse initial candidates from the text of a file; error messages start with `path`.

    `find` returns the plant of a name. A recorded text may not name plant files, since these are executed; a
    text that the user wrote may.

    Raises:
        DocumentError: the text is not YAML.
        CandidateFileError: an entry is incomplete or wrong.
    """
    content = parse_yaml(text, path)
    entries = content.get("candidates") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries:
        raise CandidateFileError(
            f"{path}: has no list 'candidates'; add one with an entry per candidate"
        )
    candidates = [
        _candidate(entry, f"{path}: candidate {k}", find)
        for k, entry in enumerate(entries, 1)
    ]
    names = [c.name for c in candidates]
    for name in names:
        if names.count(name) > 1:
            msg = f"{path}: two candidates are called {shown(name)}; give each its own name"
            raise CandidateFileError(msg)
    return candidates


def _candidate(entry: Any, place: str, find: Callable[[str], type[Plant]]) -> Candidate:
    written = decoded(entry, _Entry, place, CandidateFileError)
    further_entries = {
        name: value
        for name, value in entry.items()
        if name not in _Entry.__struct_fields__
    }
    try:
        numbers = {
            name: decoded(value, float, name) for name, value in further_entries.items()
        }
        name = _word("name", written.name)
        plant = _word("plant", written.plant)
        structure = _word("structure", written.structure)
        parameters = parameters_from(find(plant).name, structure, numbers)
        free, covariance = _spread(written.deviations, parameters)
    except TwinmatchError as error:
        raise CandidateFileError(f"{place}: {error}") from error
    values = np.atleast_1d(written.operating_point).tolist()
    outputs = parameters.model.plant.outputs
    if len(values) != len(outputs):
        raise CandidateFileError(
            f"{place}: operating_point has {len(values)} values; give one for each of {', '.join(outputs)}"
        )
    for value, output in zip(values, outputs.values(), strict=True):
        low, high = output.readable
        if not low <= value <= high:
            unit = f" {output.unit}".rstrip()
            raise CandidateFileError(
                f"{place}: operating_point is {value:g}{unit}; give a value within {low:g} and {high:g}{unit}"
            )
    return Candidate(name, point_of(values), parameters, None, free, covariance)


def _spread(
    entry: Mapping[str, Any], parameters: Parameters
) -> tuple[tuple[str, ...], FloatArray]:
    """The free parameters of a remembered candidate and their covariance; both empty for an exact one."""
    free = parameters.model.structure.free
    deviations = {
        name: decoded(value, float, f"deviation of {name}")
        for name, value in entry.items()
    }
    if deviations and deviations.keys() != {*free}:
        raise CandidateFileError(
            f"deviations are those of {', '.join(map(shown, deviations))}; the structure "
            f"{parameters.model.structure_name!r} needs those of {', '.join(free)}"
        )
    for name, deviation in deviations.items():
        if not 0.0 < deviation < math.inf:
            raise CandidateFileError(
                f"deviation of {name} is {deviation:g}; give a positive finite number"
            )
    values = [deviations[name] for name in free] if deviations else []
    return tuple(free) if deviations else (), np.diag(np.square(values))


def candidates_text(candidates: Sequence[Candidate]) -> str:
    """The file of these candidates: the inverse of `parse_candidates`."""
    entries = []
    for candidate in candidates:
        model = candidate.parameters.model
        deviations = (
            np.sqrt(np.diag(candidate.covariance)).tolist()
            if candidate.remembered
            else []
        )
        point = np.array(candidate.operating_point).tolist()
        entry: dict[str, Any] = {"name": candidate.name, "operating_point": point}
        entry |= {"plant": written_name(model.plant), "structure": model.structure_name}
        entry |= {name: candidate.parameters[name] for name in model.names}
        if deviations:
            entry["deviations"] = dict(zip(candidate.free, deviations, strict=True))
        entries.append(entry)
    return yaml.safe_dump({"candidates": entries}, allow_unicode=True, sort_keys=False)


def _word(key: str, value: str | float) -> str:
    if not str(value).isprintable() or len(str(value)) > MAX_NAME:
        raise CandidateFileError(
            f"{key} is {shown(value)}; give at most {MAX_NAME} printable characters"
        )
    return str(value)
