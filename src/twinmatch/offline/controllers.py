"""A controller tried on what a session has taught: the twins at its end, the law in a file, the profile."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twinmatch.comparing import LEVEL_WORDS, TrustLevel, Verdict
from twinmatch.controllers import ControllerError, Holding, TriedTwin, law_from
from twinmatch.dynamics import Law, Plant, advance
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import ForecastError, SetPoints
from twinmatch.offline.judging import Terms, Watch, judge
from twinmatch.plants.files import load_law
from twinmatch.sessions import Session
from twinmatch.sessions.files import read_bounded
from twinmatch.signals import FloatArray, Sample
from twinmatch.twin import Outcome, Twin, TwinSettings

MAX_BYTES = 1 << 20
"""Largest file of a law, bytes."""
SHARE = 0.1
"""Step of the usual profile, as a share of the range of the set-points."""


def read_law(path: Path, plant: type[Plant], period: float) -> Law:
    """The law in a file: a document (.json), or Python (.py), which is run, with the law as `loop`.

    Raises:
        TwinmatchError: it cannot be read, or its law is not one for this plant and sample time, s.
    """
    try:
        if path.suffix == ".py":
            return _at_period(load_law(str(path)), plant, period)
        return law_from(json.loads(read_bounded(path, MAX_BYTES)), plant, period)
    except OSError as error:
        raise ControllerError(f"{path}: cannot be read ({error.strerror}); give a .json or .py") from error
    except TwinmatchError as error:
        known = str(error).startswith(str(path))
        raise ControllerError(str(error) if known else f"{path}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise ControllerError(f"{path}: is not JSON ({error}); give an object of keys and values") from error


def _at_period(law: Law, plant: type[Plant], period: float) -> Law:
    sizes, of = (law.n_outputs, law.n_inputs), (len(plant.outputs), len(plant.drives))
    if sizes != of:
        raise ControllerError(
            f"is a law for {sizes[0]} outputs and {sizes[1]} inputs; plant {plant.name} has {of[0]} and "
            f"{of[1]}"
        )
    if law.period not in (1.0, period):
        raise ControllerError(
            f"the law runs every {law.period:g} s, the samples come every {period:g} s; give a law for that "
            "period"
        )
    return law.at_period(period)


def members_from(session: Session, terms: Terms, *, watch: Watch | None = None) -> tuple[TriedTwin, ...]:
    """Judge a session, and collect the twins at its end.

    Raises:
        ControllerError: the session ends in a fault, its twin is not trusted, or there is none.
    """
    members: list[TriedTwin] = []

    def beside(twin: Twin, sample: Sample, _: Outcome) -> None:
        if sample is session.samples[-1]:
            members.extend(_members(twin))

    judged = judge(session, terms, watch=watch, beside=beside)
    _require_trusted(session.name, judged.verdicts[-1] if judged.verdicts else None)
    return tuple(members)


def holding_of(settings: TwinSettings) -> Holding:
    """How the plant of a session is held."""
    return Holding(settings.law, settings.period, settings.schedule.span)


def level_of(session: Session, settings: TwinSettings) -> FloatArray:
    """The set-points at a session's end, or the outputs where the loop is not known; shape (o,)."""
    last = session.samples[-1]
    return np.array(last.references if settings.law else last.outputs)


def _members(twin: Twin) -> list[TriedTwin]:
    forecaster, members = twin.discriminator.forecaster, []
    for name in forecaster.names:
        known = forecaster.outlook(name)
        n, sample = known.states.size, known.sample
        row = np.array(sample.disturbances) if sample.disturbances else None
        after = advance(known.parameters, known.states, sample.inputs, known.period, row)
        members.append(
            TriedTwin(
                name,
                known.parameters,
                known.unsure,
                known.covariance[n:, n:],
                after,
                np.array(sample.inputs),
                row,
            )
        )
    return members


def _require_trusted(name: str, verdict: Verdict | None) -> None:
    if verdict is None:
        raise ControllerError(f"session {name}: no verdict came of it, so no controller can be tried on it")
    if verdict.level is not TrustLevel.TRUSTED:
        reason = verdict.level_reason or LEVEL_WORDS[verdict.level]
        raise ControllerError(
            f"session {name}: its twin ends {verdict.level.name.lower()} ({reason}), so it cannot say what a "
            "controller would do; record until the twin is trusted"
        )


def usual_profile(plant: type[Plant], level: FloatArray, samples: int) -> FloatArray:
    """Set-points that each step up, back, down and back around these levels, one after the other; shape
    (N, r). Every level is held for `samples`; a step that would leave the safe range is shortened to it."""
    rows = [level]
    for j, output in enumerate(plant.outputs.values()):
        low, high = output.set_points or output.span
        for way in (1.0, -1.0):
            moved = level.copy()
            moved[j] = np.clip(level[j] + way * SHARE * (high - low), *output.safe)
            rows += [moved, level]
    return np.repeat(np.array(rows), samples, axis=0)


def recorded_profile(session: Session) -> FloatArray:
    """The set-points of a session, shape (N, r).

    Raises:
        ControllerError: it has none.
    """
    if not session.has_reference:
        raise ControllerError(
            f"session {session.name}: has no set-points; give a profile with --over or --set"
        )
    return np.array([sample.references for sample in session.samples], dtype=np.float64)


def planned_profile(
    plant: type[Plant], level: FloatArray, rows: Sequence[Sequence[Any]], period: float, samples: int
) -> FloatArray:
    """Set-points of rows of seconds and a level for each output, from these levels on, shape (N, r); the last
    row is held for `samples`.

    Raises:
        ControllerError: a row has another number of values, or a value cannot be used.
    """
    columns = []
    for j, (name, output) in enumerate(plant.outputs.items()):
        try:
            plan = SetPoints.planned([(row[0], row[j + 1]) for row in rows], float(level[j]), signal=output)
        except IndexError:
            raise ControllerError(
                f"profile: a row has no level for {name}; give seconds, then {', '.join(plant.outputs)}"
            ) from None
        except ForecastError as error:
            raise ControllerError(f"{name}: {error}") from error
        columns.append(plan)
    size = round(columns[0].times[-1] / period) + samples
    return np.column_stack([plan.ahead(period, size) for plan in columns])


def stepped_profile(
    plant: type[Plant], level: FloatArray, steps: Sequence[str], period: float, samples: int
) -> FloatArray:
    """Set-points of steps written NAME=LEVEL@S, from these levels on, shape (N, r); as `planned_profile`.

    Raises:
        ControllerError: a step is written otherwise, or of an unknown output.
    """
    rows: list[tuple[float, int, float]] = []
    for text in steps:
        name, _, rest = text.partition("=")
        value, _, at = rest.partition("@")
        try:
            rows.append((float(at or 0.0), list(plant.outputs).index(name), float(value)))
        except ValueError:
            names = ", ".join(plant.outputs)
            raise ControllerError(
                f"--set {text}: give NAME=LEVEL@S, with S in seconds and NAME of {names}"
            ) from None
    now, plan = level.copy(), {}
    for time, j, moved in sorted(rows):
        now = now.copy()
        now[j] = moved
        plan[time] = now
    return planned_profile(plant, level, [(t, *row.tolist()) for t, row in plan.items()], period, samples)
