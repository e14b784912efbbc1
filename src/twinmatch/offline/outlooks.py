"""Forecasts from chosen samples of a session: the twin's outlook at each, and the set-points ahead."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from twinmatch.dynamics import Drive, Output
from twinmatch.dynamics.pace import time_scale
from twinmatch.errors import TwinmatchError
from twinmatch.forecasting import Forecast, ForecastError, Outlook, SetPoints
from twinmatch.offline.judging import EVERY, Terms, Watch
from twinmatch.offline.processes import held_interrupts
from twinmatch.sessions import Session
from twinmatch.sessions.files import read_bounded
from twinmatch.signals import FloatArray, Sample, Signals, Window, stretches
from twinmatch.twin import Twin, TwinSettings
from twinmatch.twin.forecaster import Forecaster

LONGEST: Final = 86_400.0
"""Longest horizon, s; for samples more than 5 s or less than 0.5 s apart in proportion to the sample time. A
longer one is a typing error: bands are learned up to a 288th of that."""
_WINDOWS: Final = 5
"""The twin begins so many longest windows before the instant asked: two memories of the forecasts' scores, so
that what is older has lost six sevenths of its weight."""
_FARTHER: Final = 4
"""Factor on that stretch if it is too short; all shorter ones cost at most a third of the last one."""
RECORDED: Final = "recorded"
MAX_BYTES = 1 << 20
"""Largest file of set-points, bytes: a day of them, one per second."""


class Prospect(NamedTuple):
    """A candidate ready to forecast from a sample, and the leader at that sample."""

    outlook: Outlook
    leader: str
    leader_confidence: float
    """How often so far the leader's error was within 3 % of the best candidate's, 0 to 1."""
    since: int | None = None
    """The first sample that the twin took; None: that of the session."""
    stretches: tuple[Window, ...] = ()
    """The samples from there to the end of the session, as the twin settled them; those that it has not
    taken, as its door would."""

    @property
    def leads(self) -> bool:
        """Whether the candidate is the leader."""
        return self.outlook.candidate == self.leader


def prospects(
    session: Session,
    terms: Terms,
    indices: Collection[int],
    *,
    candidate: str | None = None,
    whole: bool = False,
    watch: Watch | None = None,
) -> dict[int, Prospect]:
    """Run a session through the twin once, up to the last of these samples, and collect the outlook at each.

    The outlook at a sample depends only on that sample and those before it, and says from which one on. It is
    that of `candidate`, by default of the leader at each sample. Unless the `whole` session is wanted, the
    twin begins some windows before the first of these samples: earlier if no match has been accepted in the
    first half of that stretch, or if the candidate is older.

    Raises:
        ForecastError: the session has no such sample, or the candidate does not exist at it.
    """
    wanted = samples_at(session, indices)
    places = [
        place for place, sample in enumerate(session.samples) if sample.index in wanted
    ]
    if not places:
        return {}
    first = places[0]
    ends = places[-1] + 1
    reach = first if whole else _WINDOWS * terms.settings.schedule.capacity
    while True:
        begin = max(first - reach, 0)
        middle = (begin + first) // 2
        places_to_run = range(begin, ends)
        prospect_of = _run(
            session,
            terms,
            places_to_run,
            wanted,
            middle=middle,
            candidate=candidate,
            watch=watch,
        )
        if prospect_of is not None:
            return prospect_of
        reach *= _FARTHER


def _run(
    session: Session,
    terms: Terms,
    places: range,
    wanted: Collection[int],
    *,
    middle: int,
    candidate: str | None,
    watch: Watch | None,
) -> dict[int, Prospect] | None:
    """Run the samples at these places through the twin; None if it has to begin earlier, since there is no
    candidate at the one in the `middle`, or not the one asked for at a wanted sample."""
    samples = session.samples
    prospect_of = {}
    settled: list[Sample] = []
    begin = places.start
    ends = places.stop
    may_begin_earlier = begin > 0
    since = samples[begin].index if may_begin_earlier else None
    twin = Twin(terms.settings, terms.given, matching=terms.matching)
    with held_interrupts() as check_interrupt:
        for place in places:
            sample = samples[place]
            settled += twin.push(sample).settled
            forecaster = twin.discriminator.forecaster
            has_wanted_one = bool(forecaster.names) and candidate in {
                None,
                *forecaster.names,
            }
            if may_begin_earlier and place == middle and not forecaster.names:
                return None
            if sample.index in wanted:
                if may_begin_earlier and not has_wanted_one:
                    return None
                if not forecaster.names:
                    raise _no_candidate(session.name, twin, samples[place:])
                prospect_of[sample.index] = _prospect(
                    forecaster, sample.index, candidate, since
                )
            if watch is not None and (place - begin) % EVERY == 0:
                watch(place - begin, ends - begin)
            check_interrupt()
    settled += twin.discriminator.settle_rest(samples[ends:])
    without_gaps = stretches(
        [sample for sample in settled if sample.usable], terms.settings.period
    )
    return {
        index: prospect._replace(stretches=without_gaps)
        for index, prospect in prospect_of.items()
    }


def samples_at(session: Session, indices: Collection[int]) -> dict[int, Sample]:
    """The samples with these indices.

    Raises:
        ForecastError: the session does not have one of them.
    """
    wanted = set(indices)
    by_index = {
        sample.index: sample for sample in session.samples if sample.index in wanted
    }
    absent = sorted(wanted - by_index.keys())
    if absent:
        first = session.samples[0].index
        last = session.samples[-1].index
        why = " without that one" if first < absent[0] < last else ""
        raise ForecastError(
            f"session {session.name}: has no sample {absent[0]} to forecast from; it has {first} to "
            f"{last}{why}"
        )
    return by_index


def _prospect(
    forecaster: Forecaster, sample: int, candidate: str | None, since: int | None
) -> Prospect:
    leader = forecaster.leader
    assert leader is not None  # noqa: S101
    name = leader if candidate is None else candidate
    if name not in forecaster.names:
        names = "; ".join(forecaster.names)
        raise ForecastError(
            f"sample {sample}: there is no candidate {name!r}; there are: {names}"
        )
    outlook = forecaster.outlook(name)
    if not forecaster.forecasts_of(name):
        note = (
            "no forecast of this candidate has been compared with measurements yet, so the band is only its "
            "own estimate"
        )
        outlook = replace(outlook, notes=(*outlook.notes, note))
    if since is not None:
        note = f"the twin took only the samples from {since} on; --from-the-beginning gives it all of them"
        outlook = replace(outlook, notes=(*outlook.notes, note))
    return Prospect(outlook, leader, forecaster.confidence, since)


def _no_candidate(
    session: str, twin: Twin, remaining: Sequence[Sample]
) -> ForecastError:
    """The error for a sample without candidates, with the first sample that has one."""
    absent = f"session {session}: there is no candidate at sample {remaining[0].index}"
    for sample in remaining[1:]:
        twin.push(sample)
        if twin.discriminator.forecaster.names:
            return ForecastError(
                f"{absent}; there is one from sample {sample.index} on"
            )
    needed = "record set-point steps far above the noise, some minutes apart,"
    if twin.settings.law is None:
        needed = "move the input far above its noise, for some minutes in total,"
    return ForecastError(
        f"{absent} or later, since no match was accepted; {needed} or give candidates with --candidates"
    )


class Ahead(NamedTuple):
    """Set-points, or inputs where the loop is not known, ahead of one sample."""

    values: FloatArray
    """From the next sample on, shape (N,); of several, shape (N, r)."""
    words: str
    """Their description."""
    notes: tuple[str, ...] = ()
    disturbances: FloatArray | None = None
    """As recorded from this sample on, shape (N + 1, d); None: held at their last values."""


def planned_rows(path: Path) -> list[str]:
    """The lines of a file of set-points.

    Raises:
        TwinmatchError: it cannot be read, or is not text.
    """
    try:
        return read_bounded(path, MAX_BYTES).decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        msg = f"{path}: does not exist; give a .csv with seconds ahead and set-point, or {RECORDED!r}"
        raise TwinmatchError(msg) from None
    except OSError as error:
        raise TwinmatchError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError:
        raise TwinmatchError(
            f"{path}: not a text file; give a .csv with seconds ahead and set-point"
        ) from None


def planned_ahead(
    sample: Sample,
    size: int,
    *,
    settings: TwinSettings,
    reference: str | None,
    hold: Sequence[float],
    rows: list[str] | None,
) -> Ahead:
    """The set-points, or inputs, planned for the `size` samples after this one.

    `reference` names a file of set-points, whose lines are `rows`; `hold` are values to hold, one for each
    set-point or input. Without both, those of the sample are held.

    Raises:
        TwinmatchError: the plant does not take a set-point or input, or a profile cannot be read.
    """
    closed = settings.law is not None
    plant = settings.plant
    planned = _Planned(
        _kind_ahead(settings),
        [*(plant.outputs if closed else plant.drives).values()],
        sample.references if closed else sample.inputs,
    )
    if rows is not None and reference is not None:
        words, profiles = planned.from_file(reference, rows)
    elif hold:
        words, profiles = planned.held(hold)
    else:
        words, profiles = planned.standing_held()
    notes = [note for profile in profiles for note in profile.notes]
    return Ahead(
        _beside_each_other(profiles, settings.period, size), words, tuple(notes)
    )


class _Planned(NamedTuple):
    """What is planned ahead of a sample: set-points, or inputs where the loop is not known."""

    kind: str
    """What they are called."""
    signals: Sequence[Output | Drive]
    """Of which outputs they are the set-points, or the drives."""
    standing: Signals
    """Their values at the sample."""

    def from_file(self, reference: str, rows: list[str]) -> tuple[str, list[SetPoints]]:
        """The profile that the lines of a file give, in words and as it is."""
        if len(self.standing) > 1:
            raise ForecastError(
                f"{reference}: the plant has {len(self.standing)} {self.kind}s, and this file has those of one; give "
                f"--hold once for each of them, or --reference {RECORDED}"
            )
        profile = _checked(
            reference,
            lambda: SetPoints.planned(rows, self.standing[0], signal=self.signals[0]),
        )
        return f"{self.kind}s of {Path(reference).name}", [profile]

    def held(self, levels: Sequence[float]) -> tuple[str, list[SetPoints]]:
        """Levels that were given, each held."""
        if len(levels) != len(self.standing):
            given = f"{len(levels)} of the plant's {len(self.standing)} {self.kind}s"
            raise ForecastError(f"--hold: {given}; give it once for each of them")
        profiles = [
            _checked("--hold", partial(SetPoints.constant, level, signal))
            for level, signal in zip(levels, self.signals, strict=False)
        ]
        return f"{_levels_text(levels, self.signals)} held", profiles

    def standing_held(self) -> tuple[str, list[SetPoints]]:
        """The values at the sample, held."""
        several = "s" if len(self.standing) > 1 else ""
        profiles = [
            _checked("--hold", partial(SetPoints.constant, level))
            for level in self.standing
        ]
        levels = _levels_text(self.standing, self.signals)
        return f"its {self.kind}{several} of {levels} held", profiles


def _checked(place: str, make: Callable[[], SetPoints]) -> SetPoints:
    """A profile; `place` is named if it is not one."""
    try:
        return make()
    except ForecastError as error:
        raise ForecastError(f"{place}: {error}") from error


def _levels_text(levels: Sequence[float], signals: Sequence[Output | Drive]) -> str:
    """Levels with their units."""
    texts = [
        f"{level:g} {signal.unit}".rstrip()
        for level, signal in zip(levels, signals, strict=False)
    ]
    return ", ".join(texts)


def _beside_each_other(
    profiles: Sequence[SetPoints], period: float, size: int
) -> FloatArray:
    """The next samples of some profiles, shape (size, profiles); of a single one shape (size,)."""
    columns = [profile.ahead(period, size) for profile in profiles]
    return columns[0] if len(columns) == 1 else np.column_stack(columns)


def recorded_ahead(
    session: Session,
    sample: Sample,
    size: int,
    settled: Sequence[Window],
    settings: TwinSettings,
) -> Ahead:
    """The set-points, or inputs, recorded for the `size` samples after this one, or for as many as there are.

    `settled` are the stretches of the session, as the twin settled its samples.

    Raises:
        TwinmatchError: nothing was recorded right after the sample.
    """
    period = settings.period
    closed = settings.law is not None
    kind = _kind_ahead(settings)
    stretch = next(
        (part for part in settled if part.first <= sample.index <= part.last), None
    )
    if stretch is None:  # the sample itself is not usable
        raise _nothing_recorded(session, sample, settings)
    recorded_samples = stretch.part(
        sample.index, min(sample.index + size, stretch.last)
    )
    levels = recorded_samples.references if closed else recorded_samples.inputs
    count = len(recorded_samples) - 1
    if not count:
        raise _nothing_recorded(session, sample, settings)
    notes: tuple[str, ...] = ()
    if count < size:
        why = (
            "a sample is missing"
            if stretch.last < session.samples[-1].index
            else "the session ends"
        )
        notes = (f"shortened to {count * period:g} s: {why} there",)
    rows = recorded_samples.disturbances if sample.disturbances else None
    profiles = [SetPoints.recorded(column, period) for column in levels.T]
    return Ahead(
        _beside_each_other(profiles, period, count),
        f"the recorded {kind}s",
        notes,
        rows,
    )


def check_recorded_ahead(
    session: Session, samples: Iterable[Sample], settings: TwinSettings
) -> None:
    """Check, before the session is judged, that something was recorded after each of these samples.

    Raises:
        TwinmatchError: nothing was recorded right after one of them.
    """
    following = {
        before.index: after.index for before, after in pairwise(session.samples)
    }
    for sample in samples:
        next_index = following.get(sample.index)
        if next_index is None or next_index - sample.index > settings.schedule.gap + 1:
            raise _nothing_recorded(session, sample, settings)


def _nothing_recorded(
    session: Session, sample: Sample, settings: TwinSettings
) -> TwinmatchError:
    return TwinmatchError(
        f"session {session.name}: nothing was recorded right after sample {sample.index}, so no "
        f"{_kind_ahead(settings)} ahead is known; choose an earlier sample, or give --hold"
    )


def _kind_ahead(settings: TwinSettings) -> str:
    """The kind of signal that is known ahead, in words."""
    return "input" if settings.law is None else "set-point"


def samples_ahead(horizon: float | None, settings: TwinSettings) -> int:
    """Samples within the horizon, s; without one, within the longest at which forecasts are scored."""
    period = settings.period
    horizon = max(*settings.forecasts.horizons, period) if horizon is None else horizon
    longest = LONGEST * time_scale(period)
    if not (math.isfinite(horizon) and 0 < horizon <= longest):
        raise TwinmatchError(
            f"forecast: the horizon is {horizon:g} s; give a positive number of seconds, at most {longest:g}"
        )
    size = int(horizon / period * (1 + 1e-9))
    if size < 1:
        msg = f"forecast: the horizon of {horizon:g} s is shorter than one sample, {period:g} s; give more"
        raise TwinmatchError(msg)
    return size


def forecast_of(prospect: Prospect, ahead: Ahead, period: float) -> Forecast:
    """The forecast of a candidate, with notes on what is known ahead; `period` is the sample time, s."""
    forecast = prospect.outlook.forecast(ahead.values, ahead.disturbances)
    learned = prospect.outlook.leads[-1] * period
    beyond: tuple[str, ...] = ()
    if forecast.time[-1] > learned:
        beyond = (
            f"the width of the band is learned up to {learned:g} s ahead, and not beyond",
        )
    return replace(forecast, notes=forecast.notes + beyond + ahead.notes)
