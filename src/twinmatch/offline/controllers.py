"""A controller tried on what a session has taught: the twins at its end, the law in a file, the profile."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from twinmatch.comparing import Candidate, TrustLevel, Verdict, statements_of
from twinmatch.controllers import (
    ControllerError,
    ExperimentTerms,
    Holding,
    TriedTwin,
    law_from,
    suited,
)
from twinmatch.dynamics import SKIPPED, Law, Model, Plant, simulate_window
from twinmatch.dynamics.pace import plant_scale, time_scale
from twinmatch.errors import TwinmatchError
from twinmatch.fitting import fit_session, in_parts
from twinmatch.forecasting import ForecastError, SetPoints
from twinmatch.health.channel_alarms import ChannelAlarm
from twinmatch.health.channels import ChannelMonitor
from twinmatch.health.faults import TRAITS, Subject
from twinmatch.memory import Memory, digest_of, start_from
from twinmatch.memory.start import CENTRE
from twinmatch.offline.judging import Terms, Watch, judge, terms_from_files
from twinmatch.offline.outlooks import LONGEST
from twinmatch.offline.separation import inseparable_in
from twinmatch.plants import Peltier, plant_named
from twinmatch.plants.files import load_law
from twinmatch.sessions import Session
from twinmatch.sessions.documents import parse_json, read_text
from twinmatch.settings import Rule
from twinmatch.signals import MEDIAN_TO_SIGMA, FloatArray, Sample, Window, stretches
from twinmatch.twin import Outcome, Twin, TwinSettings
from twinmatch.twin.tried import tried_twins

SHARE = 0.1
"""Step of the usual profile, as a share of the range of the set-points."""
HOLD = 240
"""Time for which a level is held, s, on a plant with a time constant of 100 s."""
ALONE = 0.5
"""Share of an input's movement below which what is its own shows nothing of it."""
VISITED = 3.0
"""Margin around the visited levels, in the output's noise."""


class _SessionFits(Rule):
    """How a session is fitted where no verdicts are made."""

    window: float = 10.0
    """Length of the windows that are fitted, time constants of the plant."""
    shortest: int = 120
    """Samples of such a window, at least."""
    least_fit: float = 0.5
    """Least fit to the worst output of the whole session."""
    most_charge: float = 10.0
    """How much more than the best a structure may be charged for: twice the logarithm of the odds, below
    which a model has no support (Burnham and Anderson 2002)."""


FITS: Final = _SessionFits()


SMOOTHED = 10.0
"""Time over which what a twin does not explain is averaged, s, on a plant with a time constant of 100 s: the
noise counts by itself."""


def read_law(path: Path, plant: type[Plant], period: float) -> Law:
    """The law in a file: a document (.json), or Python (.py), which is run, with the law as `loop`.

    Raises:
        TwinmatchError: it cannot be read, or its law is not one for this plant and sample time, s.
    """
    try:
        if path.suffix == ".py":
            return suited(load_law(str(path)), plant, period)
        return law_from(parse_json(read_text(path), str(path)), plant, period)
    except TwinmatchError as error:
        names_file = str(error).startswith(str(path))
        raise ControllerError(
            str(error) if names_file else f"{path}: {error}"
        ) from error


def resting_point(path: Path) -> FloatArray | None:
    """The outputs y0 around which the regulator in a document was made, shape (o,); None without them."""
    try:
        return np.array(
            parse_json(read_text(path), str(path))["y0"], dtype=np.float64
        ).ravel()
    except (ValueError, LookupError, TypeError):
        return None


class NotTrustedError(ControllerError):
    """The twin that a session leaves is not trusted; `reason` says why, in words."""

    def __init__(self, session: str, level: TrustLevel, reason: str) -> None:
        super().__init__(
            f"session {session}: its twin ends {level.name.lower()} ({reason}), so it cannot say what a "
            "controller would do; twinmatch experiment says what to record until the twin is trusted"
        )
        self.reason = reason


class LeftOut(NamedTuple):
    """Samples of which nothing is learned, because a sensor was at fault."""

    first: int
    last: int
    why: str
    """The fault and its sensor, in words."""

    @property
    def sentence(self) -> str:
        """That they are left out, and why."""
        return f"samples {self.first} to {self.last} are left out: {self.why}"


@dataclass(frozen=True, eq=False)
class Ground:
    """A session on which controllers are tried."""

    session: Session
    plant: type[Plant]
    terms: Terms | None
    """How it is judged; None for a plant with several loops, whose windows are fitted instead."""
    settings: TwinSettings | None = None
    """The settings of a twin of a plant with several loops."""

    @property
    def loops(self) -> Law | None:
        """The law of several loops, if the recorded inputs are those of the plant file's; None: not known."""
        return None if self.settings is None else self.settings.law

    @cached_property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Samples of a plant with several loops that its twins are not fitted to.

        Looked for when asked: it takes longer than all that may refuse a session before.
        """
        if self.settings is None:
            return ()
        return _faults_of_sensors(self.session, self.settings)

    @cached_property
    def sound(self) -> list[Sample]:
        """The samples without those that are left out."""
        return [
            sample
            for sample in self.session.samples
            if not any(
                part.first <= sample.index <= part.last for part in self.left_out
            )
        ]

    @property
    def holding(self) -> Holding:
        """How its plant is brought to an operating point."""
        if self.terms is not None:
            settings = self.terms.settings
            return Holding(settings.law, settings.period, settings.schedule.span)
        period = self.session.period
        return Holding(
            None, period, round(HOLD * plant_scale(self.plant, period) / period)
        )

    @property
    def level(self) -> FloatArray:
        """The set-points at its end or, if it has none, the median of the outputs, shape (o,)."""
        if self.session.has_reference:
            return np.array(self.session.samples[-1].references)
        return np.median([sample.outputs for sample in self.session.samples], axis=0)

    @property
    def noise(self) -> FloatArray:
        """Standard deviations of readings, shape (o,): from their second differences, since a plant hardly
        bends within three samples; of a reading that mostly repeats itself, that of the plant file."""
        bends = np.diff([sample.outputs for sample in self.sound], n=2, axis=0)
        measured = MEDIAN_TO_SIGMA * np.median(np.abs(bends), axis=0) / np.sqrt(6.0)
        declared = np.array([output.noise for output in self.plant.outputs.values()])
        return np.where(measured > 0.0, measured, declared)

    def seen_by(self, twin: TriedTwin) -> TriedTwin:
        """The twin with the noise of the recorded readings and what it does not explain of them; without the
        second where it does not follow the recording by its commands alone, as of an unstable plant."""
        noise = self.noise
        period = self.session.period
        averages = [np.zeros((0, noise.size))]
        samples = round(SMOOTHED * plant_scale(self.plant, period) / period)
        sound = self.sound
        for window in stretches(sound, period):
            if len(window) > SKIPPED + samples:
                response = simulate_window(twin.parameters, window, law=None)
                sums = np.cumsum(window.outputs[SKIPPED:] - response.outputs, axis=0)
                averages.append((sums[samples:] - sums[:-samples]) / samples)
        unexplained = np.concatenate(averages)
        moved = np.ptp([sample.outputs for sample in sound], axis=0)
        follows_recording = unexplained.size and (np.abs(unexplained) <= moved).all()
        if not follows_recording:
            return replace(twin, noise=noise)
        return replace(twin, noise=noise, unexplained=unexplained)

    def unvisited(self, references: FloatArray) -> tuple[str, ...]:
        """A note for each output whose set-points, shape (N, r), are beyond its readings."""
        visited = np.array([sample.outputs for sample in self.session.samples])
        notes = []
        for j, (name, output) in enumerate(self.plant.outputs.items()):
            low = visited[:, j].min()
            high = visited[:, j].max()
            margin = VISITED * output.noise
            asked = references[:, j].min(), references[:, j].max()
            if asked[0] < low - margin or asked[1] > high + margin:
                notes.append(
                    f"{name} from {asked[0]:.4g} to {asked[1]:.4g} {output.unit}, of which only {low:.4g} to "
                    f"{high:.4g} was visited: the rest is the plant's equations"
                )
        return tuple(notes)


def ground_of(
    session: Session, config: Path | None = None, candidates: Path | None = None
) -> Ground:
    """A session with the terms on which it is judged, if its plant has one loop.

    Raises:
        TwinmatchError: the plant is not known, or a file cannot be used.
    """
    plant = plant_named(session.plant) if session.plant else Peltier
    if len(plant.outputs) == len(plant.drives) == 1:
        return Ground(session, plant, terms_from_files(session, config, candidates))
    if len(plant.outputs) != len(plant.drives):
        raise ControllerError(_unequal(plant))
    settings = terms_from_files(session, config, candidates).settings
    return Ground(session, plant, None, settings)


def _unequal(plant: type[Plant]) -> str:
    """That a plant has not as many inputs as outputs, and which part of it has."""
    outputs = len(plant.outputs)
    inputs = len(plant.drives)
    if outputs > inputs:
        part = f"write a plant of {inputs} of the outputs (twinmatch new-plant, the others left out of --map)"
    else:
        part = (
            f"write a plant of {outputs} of the inputs, with the others as disturbances (twinmatch new-plant, "
            "names of their own in --map)"
        )
    return (
        f"plant {plant.name}: has {outputs} outputs and {inputs} inputs; controllers are tried, and what to "
        f"record next is said, for as many inputs as outputs; {part} and import the recording with its map"
    )


def _faults_of_sensors(session: Session, settings: TwinSettings) -> tuple[LeftOut, ...]:
    """The samples at which a sensor was named as faulty."""
    monitor = ChannelMonitor(settings.health.followed, session.period)
    alarms: dict[int, ChannelAlarm] = {}
    for sample in session.samples:
        monitor.push(sample)
        for alarm in monitor.alarms:
            # few are kept; one that has ended replaces what was known of it
            alarms[alarm.flagged] = alarm
    parts = []
    for alarm in alarms.values():
        if TRAITS[alarm.fault].subject is Subject.OUTPUT and not alarm.withdrawn:
            last = session.samples[-1].index if alarm.last is None else alarm.last
            sensor = settings.plant.outputs[alarm.signal].text or alarm.signal
            parts.append(LeftOut(alarm.first, last, f"{alarm.fault.value} of {sensor}"))
    return tuple(parts)


def members_from(
    ground: Ground, *, watch: Watch | None = None
) -> tuple[TriedTwin, ...]:
    """The twins that a session leaves: at its end those of its verdicts, or fits of its windows.

    Raises:
        ControllerError: the session ends in a fault, its twin is not trusted, or nothing explains it.
    """
    if ground.terms is None:
        return _fitted(ground, watch)
    members: list[TriedTwin] = []
    session = ground.session

    def beside(twin: Twin, sample: Sample, _: Outcome) -> None:
        if sample is session.samples[-1]:
            members.extend(tried_twins(twin.discriminator.forecaster.snapshot()))

    judged = judge(session, ground.terms, watch=watch, beside=beside)
    _require_trusted(ground, judged.verdicts[-1] if judged.verdicts else None)
    return tuple(map(ground.seen_by, members))


def _fitted(ground: Ground, watch: Watch | None) -> tuple[TriedTwin, ...]:
    """Fits of the session's windows in the structures that explain the whole session best.

    What changes from window to window, such as the room, shows as their differences.
    """
    whole = _stretches_to_fit(ground)
    supported = _supported_models(ground, whole)
    windows = _windows_to_fit(ground.plant, whole)
    members = []
    total = len(windows) * len(supported)
    for count, (model, window) in enumerate(product(supported, windows), 1):
        fit = fit_session(model, window)
        if watch is not None:
            watch(count, total)
        if fit.converged:
            free = model.structure.free
            name = f"{model.structure_name}, {window.first} to {window.last}"
            members.append(
                ground.seen_by(TriedTwin(name, fit.parameters, free, fit.covariance))
            )
    return tuple(members)


def _stretches_to_fit(ground: Ground) -> tuple[Window, ...]:
    """The stretches of a session without gaps.

    Raises:
        ControllerError: none is long enough.
    """
    session = ground.session
    whole = stretches(ground.sound, session.period)
    if not any(len(stretch) >= FITS.shortest for stretch in whole):
        reasons = "; ".join(part.sentence for part in ground.left_out)
        raise ControllerError(
            f"session {session.name}: no stretch of {FITS.shortest} samples is left to fit twins to"
            f"{reasons and f' ({reasons})'}; record more samples"
        )
    return whole


def _supported_models(ground: Ground, whole: Sequence[Window]) -> list[Model]:
    """The models of a plant that explain all of its stretches best, or nearly as well.

    Raises:
        ControllerError: none explains enough.
    """
    plant = ground.plant
    models = [
        plant.model(name)
        for name, structure in plant.structures.items()
        if structure.watched
    ]
    fits = [fit_session(model, whole) for model in models]
    best = min(fits, key=lambda fit: fit.charge)
    if not best.fit[0] >= FITS.least_fit:
        together = moved_together(ground)
        advice = (
            "record steps of every input" if together is None else together.sentence
        )
        explained = 100 * max(best.fit[0], 0.0)
        raise ControllerError(
            f"session {ground.session.name}: {best.model.title} explains only {explained:.0f} % "
            f"of its movement, so it cannot say what a controller would do; {advice}"
        )
    most = best.charge + FITS.most_charge
    return [fit.model for fit in fits if fit.charge <= most]


def _windows_to_fit(plant: type[Plant], whole: Iterable[Window]) -> list[Window]:
    """Parts of stretches, each long enough to fit a twin to."""
    samples_without_time_constant = FITS.window * HOLD
    windows = []
    for stretch in whole:
        parts = in_parts(
            plant, stretch, FITS.window, otherwise=samples_without_time_constant
        )
        windows += [part for part in parts if len(part) >= FITS.shortest]
    return windows


def remembered(
    ground: Ground, path: Path, rig: str | None = None, *, apart: Session | None = None
) -> tuple[TriedTwin, ...]:
    """The twins of earlier sessions in a memory, and the centre of all, whose draws have their spread;
    without what the session `apart` has taught, in which the answer is to be checked.

    Raises:
        MemoryFaultError: the file is not a memory, or cannot be read.
        ControllerError: no session in it says anything of this plant.
    """
    memory = Memory(path)
    name = ground.plant.name
    digest_apart = "" if apart is None else digest_of(apart.samples)
    candidates = start_from(
        [
            lesson
            for lesson in memory.lessons(name, rig)
            if lesson.session != digest_apart
        ],
        ground.plant,
    )
    if not candidates and apart is None and not memory.comparisons(name, rig):
        raise ControllerError(
            f"{path}: remembers nothing of plant {ground.plant.name}; leave --memory out"
        )
    return tuple(
        ground.seen_by(_tried_from_memory(candidate)) for candidate in candidates
    )


def _tried_from_memory(candidate: Candidate) -> TriedTwin:
    """A candidate from a memory as a twin to be tried; only the centre of all sessions has a spread."""
    if candidate.name.startswith(CENTRE):
        return TriedTwin(
            candidate.name,
            candidate.parameters,
            candidate.free,
            candidate.known_covariance,
        )
    return TriedTwin(
        f"{CENTRE}: {candidate.name}", candidate.parameters, candidate.free, None
    )


def _require_trusted(ground: Ground, verdict: Verdict | None) -> None:
    name = ground.session.name
    trust = None if verdict is None else statements_of(verdict).trust
    if trust is not None and trust.level is TrustLevel.TRUSTED:
        return
    level = TrustLevel.UNKNOWN if trust is None else trust.level
    reason = "no verdict came of it" if trust is None else trust.reason
    if level is TrustLevel.FAULT:
        raise ControllerError(
            f"session {name}: its twin ends fault ({reason}), so it cannot say what a controller would do; "
            "record it again once the plant is sound"
        )
    inseparable = inseparable_in(
        stretches(ground.session.samples, ground.session.period), ground.plant
    )
    raise NotTrustedError(
        name, level, reason if inseparable is None else inseparable.sentence
    )


def experiment_terms(
    ground: Ground, minutes: float | None = None, within: Sequence[float] | None = None
) -> ExperimentTerms:
    """What an experiment on a session's plant may do, from its end on.

    Raises:
        ControllerError: as `ExperimentTerms.of`.
    """
    size = None if minutes is None else round(60.0 * minutes / ground.session.period)
    holding = ground.holding
    if ground.loops is not None:
        holding = replace(holding, law=ground.loops)
    return ExperimentTerms.of(
        ground.plant, holding, ground.level, size=size, within=within
    )


@dataclass(frozen=True)
class MovedTogether:
    """Inputs that moved only as the others did: what each of them does alone does not show."""

    inputs: tuple[str, ...]
    """Their names in the plant file, at least one."""
    hold: float
    """How long a step has to be held to show what it does, s."""

    @property
    def sentence(self) -> str:
        """That it is so, and what to record."""
        names = f"{', '.join(self.inputs[:-1])} and {self.inputs[-1]}".removeprefix(
            " and "
        )
        return (
            f"{names} moved only together with the other inputs, so what each does alone does not show; record "
            f"a step of each input alone, the others held (or of the set-points, one after the other), for "
            f"{self.hold:.3g} s each"
        )


def moved_together(ground: Ground) -> MovedTogether | None:
    """The inputs of a plant with several whose movement the others explain nearly; None without one."""
    inputs = np.array([sample.inputs for sample in ground.session.samples])
    together = []
    for j, name in enumerate(ground.plant.drives):
        others = np.delete(inputs, j, axis=1)
        table = np.column_stack([np.ones(len(inputs)), others])
        coefficients = np.linalg.lstsq(table, inputs[:, j], rcond=None)[0]
        alone = float(np.std(inputs[:, j] - table @ coefficients))
        if alone < ALONE * float(np.std(inputs[:, j])):
            together.append(name)
    if not together:
        return None
    hold = ground.holding.samples * ground.session.period
    return MovedTogether(tuple(together), hold)


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
    plant: type[Plant],
    level: FloatArray,
    rows: Sequence[Sequence[Any]],
    period: float,
    samples: int,
) -> FloatArray:
    """Set-points of rows of seconds and a level for each output, from these levels on, shape (N, r); the last
    row is held for `samples`.

    Raises:
        ControllerError: a row has another number of values, or a value cannot be used.
    """
    columns = []
    for j, (name, output) in enumerate(plant.outputs.items()):
        try:
            plan = SetPoints.planned(
                [(row[0], row[j + 1]) for row in rows], float(level[j]), signal=output
            )
        except IndexError:
            raise ControllerError(
                f"profile: a row has no level for {name}; give seconds, then {', '.join(plant.outputs)}"
            ) from None
        except ForecastError as error:
            raise ControllerError(f"{name}: {error}") from error
        columns.append(plan)
    if columns[0].times[-1] > (longest := LONGEST * time_scale(period)):
        raise ControllerError(
            f"profile: its last row is at {columns[0].times[-1]:g} s; give times of at most {longest:g} s"
        )
    size = round(columns[0].times[-1] / period) + samples
    return np.column_stack([plan.ahead(period, size) for plan in columns])


def stepped_profile(
    plant: type[Plant],
    level: FloatArray,
    steps: Sequence[str],
    period: float,
    samples: int,
) -> FloatArray:
    """Set-points of steps written NAME=LEVEL@S, from these levels on, shape (N, r); as `planned_profile`.

    Raises:
        ControllerError: a step is written otherwise, or of an unknown output.
    """
    rows: list[tuple[float, int, float]] = []
    for text in steps:
        name, _, level_and_time = text.partition("=")
        value, _, time_text = level_and_time.partition("@")
        try:
            rows.append(
                (float(time_text or 0.0), list(plant.outputs).index(name), float(value))
            )
        except ValueError:
            names = ", ".join(plant.outputs)
            raise ControllerError(
                f"--set {text}: give NAME=LEVEL@S, with S in seconds and NAME of {names}"
            ) from None
    levels = level.copy()
    levels_from = {}
    for begin, j, new_level in sorted(rows):
        levels = levels.copy()
        levels[j] = new_level
        levels_from[begin] = levels
    plan = [(begin, *levels.tolist()) for begin, levels in levels_from.items()]
    return planned_profile(plant, level, plan, period, samples)
