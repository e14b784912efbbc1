"""A session through the twin, and everybody's forecasts against what came."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from twinmatch.backtest.choices import Choices
from twinmatch.backtest.constant import with_constant_band
from twinmatch.backtest.origins import Origin, ask, mark, origins, regular, stretches
from twinmatch.backtest.peer import Peer
from twinmatch.backtest.peers import peers
from twinmatch.backtest.result import CONSTANT, LEADER, NEWEST, NOMINAL, Backtest
from twinmatch.backtest.scoring import samples_within
from twinmatch.backtest.summary import Marked, best_in_hindsight, common
from twinmatch.dynamics import SKIPPED
from twinmatch.forecasting import CONFIDENCE, Forecast, Outlook
from twinmatch.judging.interrupt import held_interrupts
from twinmatch.judging.judgement import Judgement, Watch, judge
from twinmatch.judging.terms import Terms, terms_from_files
from twinmatch.sessions import Session, open_any
from twinmatch.signals import Sample, Window
from twinmatch.twin import Outcome, Twin
from twinmatch.twin.threads import one_thread

__all__ = ["Listener", "backtest", "backtest_session", "graded", "halves"]


class _Asked(NamedTuple):
    """What every candidate knew at one sample, and who was who."""

    outlooks: dict[str, Outlook]
    who: dict[str, str]
    """Name of the candidate by its part: leader, nominal, newest."""


@dataclass
class Listener:
    """Sits beside the twin while a session is judged, and keeps what its candidates know at some samples."""

    wanted: frozenset[int]
    """Samples at which that is kept, beside those of the verdicts."""
    asked: dict[int, _Asked] = field(default_factory=dict)
    twin: Twin | None = None

    @classmethod
    def to(cls, samples: Sequence[Sample], period: float, choices: Choices) -> Listener:
        """One for these samples.

        Raises:
            BacktestError: a horizon or the time between two forecasts is shorter than one sample.
        """
        choices.ahead(period)
        return cls(frozenset(regular(stretches(samples, period), choices.pace(period))))

    def __call__(self, twin: Twin, sample: Sample, outcome: Outcome) -> None:
        """Take what one sample brought about."""
        self.twin = twin
        if not (outcome.verdicts or sample.index in self.wanted):
            return
        forecaster, nominal = twin.discriminator.forecaster, twin.discriminator.nominal
        names, structures = forecaster.names, twin.settings.plant.structures
        who = {
            LEADER: forecaster.leader,
            NOMINAL: nominal.name if nominal else None,
            NEWEST: next((name for name in names if name not in structures), None),
        }
        parts = {part: name for part, name in who.items() if name in names}
        self.asked[sample.index] = _Asked({name: forecaster.outlook(name) for name in names}, parts)

    def spoilt(self, first: int, last: int) -> bool:
        """Whether the plant was found to be at fault between two samples."""
        monitor = self.twin.discriminator.monitor if self.twin else None
        return monitor is not None and monitor.fault_between(first, last) is not None


def backtest_session(
    path: Path,
    choices: Choices | None = None,
    *,
    config: Path | None = None,
    candidates: Path | None = None,
    plant: str | None = None,
    watch: Watch | None = None,
) -> Backtest:
    """Test the twin on a session, an .mcap file or a recording.

    Args:
        path: what to test on.
        choices: how far ahead, how often, and against whom.
        config: file of parameters; without it the defaults.
        candidates: file of candidates to begin with.
        plant: name or file of the plant, where the session does not say it or it is in a file.
        watch: called now and then.

    Raises:
        TwinmatchError: one of the files cannot be used, or a horizon is too short for the session.
    """
    session = open_any(path, plant=plant)
    return backtest(session, terms_from_files(session, config, candidates), choices, watch=watch)


def backtest(
    session: Session, terms: Terms, choices: Choices | None = None, *, watch: Watch | None = None
) -> Backtest:
    """Test the twin on a session, on these terms; see `backtest_session`."""
    choices = choices or Choices()
    listener = Listener.to(session.samples, terms.settings.period, choices)
    first, second = halves(watch)
    judgement = judge(session, terms, watch=first, beside=listener)
    return graded(judgement, listener, choices, watch=second)


def halves(watch: Watch | None) -> tuple[Watch | None, Watch | None]:
    """Who is told of two works of equal length, one after the other, as of one."""
    if watch is None:
        return None, None
    told = watch
    return (lambda done, total: told(done, 2 * total)), (lambda done, total: told(total + done, 2 * total))


def graded(
    judgement: Judgement, listener: Listener, choices: Choices, *, watch: Watch | None = None
) -> Backtest:
    """Hold what a listener kept, and what the peers say, against what came.

    A forecast whose path meets a fault of the plant is left out: nobody can foresee one.
    """
    plant, period, driven = (
        judgement.settings.plant,
        judgement.settings.period,
        judgement.settings.gains is None,
    )
    held = stretches(judgement.samples, period)
    horizons = choices.ahead(period)
    found = origins(held, listener.asked, horizons, driven=driven)
    others, absent = peers(plant, choices.peers, driven=driven)
    grading = _Grading(judgement, listener, horizons)
    with held_interrupts() as check_interrupt:
        for done, origin in enumerate(found):
            grading.at(origin, others)
            if watch is not None:
                watch(done * len(judgement.samples) // len(found), len(judgement.samples))
            check_interrupt()
    marked = common(grading.marked)
    judged = {one.sample for one in marked}
    return Backtest(
        name=judgement.name,
        plant=plant,
        period=period,
        horizons=horizons,
        confidence=CONFIDENCE,
        marked=tuple(marked),
        came=held,
        shown=_one_after_another(f for f in grading.shown if f.sample in judged),
        absent=tuple(absent),
        notes=tuple(_notes(len(found), judged, grading)),
    )


class _Grading:
    """The marks of one session, gathered origin by origin."""

    def __init__(self, judgement: Judgement, listener: Listener, horizons: tuple[float, ...]) -> None:
        self._judgement, self._listener, self._horizons = judgement, listener, horizons
        self.marked: list[Marked] = []
        self.shown: list[Forecast] = []
        self.spoilt = 0
        """Origins whose nearest horizon already met a fault."""
        self.unasked = 0
        """Origins at which there was no candidate."""

    def at(self, origin: Origin, others: Sequence[Peer]) -> None:
        """Ask everybody who can answer, and judge the answers."""
        horizons = [h for h in self._horizons if not self._meets_fault(origin, h)]
        if not horizons:
            self.spoilt += 1
            return
        asked = self._listener.asked[origin.sample]
        if LEADER not in asked.who:
            self.unasked += 1
            return

        def add(who: str, forecast: Forecast, candidate: str = "") -> list[Marked]:
            plant = self._judgement.settings.plant
            name = self._judgement.name
            return mark(name, who, forecast, origin, horizons=horizons, plant=plant, candidate=candidate)

        with one_thread():
            rows = origin.disturbances
            said = {n: outlook.forecast(origin.ahead, rows) for n, outlook in asked.outlooks.items()}
            for part, name in asked.who.items():
                self.marked += add(part, said[name], name)
            if NOMINAL in asked.who and len(origin.past) > SKIPPED + 1:
                self.marked += add(CONSTANT, self._constant(asked, said, origin.past), asked.who[NOMINAL])
        self.marked += best_in_hindsight(
            m for name, forecast in said.items() for m in add(name, forecast, name)
        )
        self.shown.append(said[asked.who[LEADER]])
        for peer in others:
            forecast = ask(peer, origin)
            if forecast is not None:
                self.marked += add(peer.name, forecast)

    def _meets_fault(self, origin: Origin, horizon: float) -> bool:
        count = samples_within(horizon, self._judgement.settings.period)
        return self._listener.spoilt(origin.sample, origin.sample + count)

    def _constant(self, asked: _Asked, said: dict[str, Forecast], past: Window) -> Forecast:
        name = asked.who[NOMINAL]
        gains = self._judgement.settings.gains
        return with_constant_band(said[name], asked.outlooks[name].parameters, past, gains)


def _one_after_another(forecasts: Iterable[Forecast]) -> tuple[Forecast, ...]:
    """Those that begin where the one before ends."""
    found: list[Forecast] = []
    for forecast in forecasts:
        if not found or forecast.sample >= found[-1].sample + found[-1].time.size:
            found.append(forecast)
    return tuple(found)


def _notes(asked: int, judged: set[int], grading: _Grading) -> Iterable[str]:
    """What was left out and why."""
    if grading.unasked:
        yield f"{grading.unasked} of {asked} forecasts could not be made: there was no candidate yet"
    if grading.spoilt:
        yield f"{grading.spoilt} of {asked} forecasts are left out: nobody foresees a fault of the plant"
    answered: dict[int, set[str]] = {}
    for one in grading.marked:
        answered.setdefault(one.sample, set()).add(one.who)
    everybody = {one.who for one in grading.marked}
    short = [everybody - names for sample, names in answered.items() if sample not in judged]
    if short:
        names = ", ".join(sorted(set().union(*short) - {CONSTANT}))
        yield f"{len(short)} of {asked} forecasts are left out: not everybody could answer yet ({names})"
