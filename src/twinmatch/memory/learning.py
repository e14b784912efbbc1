"""What a session teaches: one fit per structure to its healthy samples, with an honest covariance."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twinmatch.comparing import ForecastScore, Verdict
from twinmatch.dynamics import Law, Model, Plant
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import Noise, StructureFit, fit_structure, observed_covariance
from twinmatch.memory.lesson import Lesson, Span
from twinmatch.signals import FloatArray, Sample, Window

MIN_SAMPLES: Final = 180
"""Shortest healthy stretch that is used, samples: the first minute of each is not compared, and less than
that has too few independent residuals for a covariance."""
_REFITS: Final = 3
"""How often a fit is continued that has not converged."""


@dataclass(frozen=True, eq=False)
class SessionEvidence:
    """A session that has been judged, as far as its lessons depend on it."""

    session: str
    """Digest of its samples, see `digest_of`."""
    name: str
    rig: str
    plant: type[Plant]
    began: int
    """Stamp of the first sample, ns since the epoch of its clock."""
    stretches: Sequence[Window]
    """All its samples: those not seen are stand-ins for lost and refused ones."""
    verdicts: Sequence[Verdict]
    horizons: tuple[float, ...]
    """Horizons of the forecasts, s."""
    noise: Noise
    law: Law | None
    """That of the loop; None if it is not known."""

    @property
    def fault_at(self) -> int | None:
        """First sample of the first fault that was reported."""
        fault_starts = [
            v.fault_since
            for v in self.verdicts
            if v.fault and v.fault_since is not None
        ]
        return min(fault_starts, default=None)

    @property
    def healthy(self) -> list[Window]:
        """The stretches before the first fault, without those that are too short."""
        end = self.fault_at
        windows = []
        for window in self.stretches:
            if end is None or window.last < end:
                windows.append(window)
            elif window.first < end:
                windows.append(window.part(window.first, end - 1))
        return [window for window in windows if int(window.marks.sum()) >= MIN_SAMPLES]

    @property
    def before_fault(self) -> list[Verdict]:
        """The verdicts before the first fault."""
        end = self.fault_at
        return [v for v in self.verdicts if end is None or v.sample < end]


def digest_of(samples: Iterable[Sample]) -> str:
    """A digest of a session's samples, whatever its name and file."""
    digest = hashlib.sha256()
    for sample in samples:
        row = (sample.index, *sample.references, *sample.outputs, *sample.inputs)
        digest.update(np.array(row, dtype=np.float64).tobytes())
    return digest.hexdigest()[:16]


def lessons_of(judged: SessionEvidence) -> list[Lesson]:
    """The lessons of a session: of the plant's first structure, those that are watched, and those that have
    led or were chosen; without structures of which a parameter is not determined at all.

    None if the healthy part is too short.
    """
    windows = judged.healthy
    if not windows:
        return []
    lessons = (_lesson(judged, windows, model) for model in _worth_keeping(judged))
    return [lesson for lesson in lessons if lesson is not None]


def _worth_keeping(judged: SessionEvidence) -> list[Model]:
    """The models of which lessons are kept, each once."""
    structures = judged.plant.structures
    verdicts = judged.before_fault
    names = [next(iter(structures))]
    names += [name for name, structure in structures.items() if structure.watched]
    names += [verdict.structure for verdict in verdicts[-1:]]
    for verdict in verdicts:
        if verdict.leading is not None:
            names.append(verdict.leading.parameters.model.structure_name)
    models = [
        judged.plant.model(name) for name in dict.fromkeys(names) if name in structures
    ]
    return [model for model in models if not model.is_external and model.structure.free]


def _lesson(
    judged: SessionEvidence, windows: Sequence[Window], model: Model
) -> Lesson | None:
    """The lesson on one structure; None if a parameter is not determined."""
    try:
        fit = _converged_fit(judged, windows, model)
        covariance = observed_covariance(fit, windows, judged.noise, judged.law)
    except (TwinmatchError, np.linalg.LinAlgError):
        return None
    if (
        fit.bounds_hit
        or not np.isfinite(covariance).all()
        or np.linalg.eigvalsh(covariance)[0] <= 0.0
    ):
        return None
    last = judged.before_fault[-1] if judged.before_fault else None
    leader = None if last is None else last.leading
    score = None if last is None else _score_of(last, model)
    return Lesson(
        session=judged.session,
        name=judged.name.encode(errors="replace").decode(),
        plant=judged.plant.name,
        equations=model.equations,
        rig=judged.rig,
        structure=model.structure_name,
        began=judged.began,
        duration=sum(len(window) * window.period for window in windows),
        samples=sum(int(window.marks.sum()) for window in windows),
        parameters=dict(fit.parameters),
        free=model.structure.free,
        covariance=tuple(map(tuple, covariance.tolist())),
        outputs=_spans([window.outputs[window.marks] for window in windows]),
        inputs=_spans([window.inputs[window.marks] for window in windows]),
        led=leader is not None and leader.parameters.model is model,
        chosen=last is not None and last.structure == model.structure_name,
        level="" if last is None else last.level.value,
        horizons=judged.horizons if score else (),
        persistence_skill=score.persistence_skill if score else (),
        arx_skill=score.arx_skill if score else (),
        fault_at=judged.fault_at,
    )


def _score_of(verdict: Verdict, model: Model) -> ForecastScore | None:
    """The score of the twin in a structure that leads or, if none does, has gained most; None without one."""
    leader = verdict.leading
    if leader is not None and leader.parameters.model is model:
        return leader
    scores = [score for score in verdict.forecasts if score.parameters.model is model]
    return max(
        scores, key=lambda score: np.nan_to_num(score.gain, nan=-np.inf), default=None
    )


def _converged_fit(
    judged: SessionEvidence, windows: Sequence[Window], model: Model
) -> StructureFit:
    fit = fit_structure(windows, model, noise=judged.noise, law=judged.law)
    for _ in range(_REFITS):
        if fit.converged:
            break
        fit = fit_structure(
            windows, model, start=fit, noise=judged.noise, law=judged.law
        )
    return fit


def _spans(signals: Sequence[FloatArray]) -> tuple[Span, ...]:
    whole = np.concatenate(signals)
    return tuple(
        zip(whole.min(axis=0).tolist(), whole.max(axis=0).tolist(), strict=True)
    )
