"""The forecaster: every candidate forecasts, and its forecasts are compared with the samples."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinmatch.comparing import Candidate, ForecastScore
from twinmatch.dynamics import Foresight, Law, Plant, PlantError
from twinmatch.dynamics.forecasts import TwinsNow, Wanted
from twinmatch.forecasting import (
    Arx,
    ArxForecast,
    Calibration,
    Followers,
    ForecastError,
    Ledger,
    Outlook,
    StateFilter,
    leads_of,
)
from twinmatch.signals import BoolArray, FloatArray, Sample, Signals, finite, rms
from twinmatch.twin.entrants import Entrant, Entrants, Standings
from twinmatch.twin.sample_rows import SampleRows
from twinmatch.twin.settings import ForecastSettings
from twinmatch.twin.trust import BandCheck, LeaderConfidence, check_band

_RUN_IN: Final = (60.0, 300.0)
"""Newest stretch over which a new candidate tracks the plant before use, s: if its states are known, and if
the hidden ones have to be estimated. It scales with the time between two forecasts."""
_OTHERS_EVERY: Final = 3
"""The bands of candidates that do not lead learn from every third forecast only."""
_NOTED_EVERY: Final = 4
"""What has been learned is noted at every fourth forecast, so that it can be taken back."""
_NOTES_KEPT: Final = 16
"""Notes that are kept, the newest: what has lasted longer is how the plant is now. On the rig half an hour."""


class Snapshot(NamedTuple):
    """Outlooks of all candidates at one sample; immutable, so it can be used from any thread."""

    leader: str | None = None
    """The candidate whose forecasts have saved the most characters; None without candidates."""
    outlooks: Mapping[str, Outlook] = MappingProxyType({})
    """Outlooks by name of the candidate."""
    leading: ForecastScore | None = None
    """The leader's score."""

    def outlook(self, name: str | None = None) -> Outlook:
        """The outlook of a candidate, by default the leader.

        Raises:
            ForecastError: there is no candidate yet, or none of that name.
        """
        return self.outlooks[
            _check_name(self.leader if name is None else name, self.outlooks)
        ]


class _Conditions(NamedTuple):
    """What forecasts from a sample are made for."""

    ahead: FloatArray
    """Set-points after it or, if the loop is not known, inputs, shape (N, r)."""
    disturbances: FloatArray | None
    """Those from it on, shape (N + 1, d), if there are any."""


class _Forecast(NamedTuple):
    """What one candidate forecast."""

    means: FloatArray
    """Outputs, then inputs, shape (o + m, N)."""
    variances: FloatArray
    """Those of outputs, then inputs, shape (o + m, N); meaningless unless bands were wanted."""


class _Departure(NamedTuple):
    """All that is needed to forecast from one sample later, once the samples after it are there."""

    leader: str
    outlooks: Mapping[str, Outlook]
    """Those of the leader, and of the candidates whose equations are external."""
    names: tuple[str, ...]
    """Those of the other candidates, in the order of `now`."""
    foresight: Foresight | None
    now: TwinsNow | None
    arx: ArxForecast
    widths: Mapping[str, FloatArray]
    """Widths of the bands of the candidates that learn from this forecast, by name."""


class _ComparedForecasts(NamedTuple):
    """What became of the forecasts from one departure; N samples came after it."""

    forecasts: Mapping[str, _Forecast]
    """By name of the candidate."""
    errors: FloatArray
    """Readings minus means, shape (candidates, signals, N)."""
    baseline_errors: FloatArray
    """Those of the baselines, shape (baselines, signals, N)."""
    is_received: BoolArray
    """Which samples were received, shape (N,)."""

    @property
    def received(self) -> NDArray[np.intp]:
        """Places of the samples that were received."""
        return np.flatnonzero(self.is_received)


class _Learned(NamedTuple):
    """What forecasts had taught up to a sample."""

    sample: int
    ledger: Ledger
    calibrations: Mapping[str, Calibration]
    """Those of the candidates' bands, by name."""
    leader_confidence: LeaderConfidence


class Forecaster:
    """Runs every candidate beside the plant and compares its forecasts with the samples.

    At every sample each twin's states are corrected by the reading. Every `every` seconds the state of all
    twins is saved; when the samples up to a horizon are there, each twin forecasts them from the saved state,
    under the actual set-points, and ledger and bands learn from the errors. Twins whose loop is not known
    forecast the output under the actual inputs. All this depends only on samples and candidates.
    """

    def __init__(
        self,
        law: Law | None,
        settings: ForecastSettings | None = None,
        spoilt: Callable[[int, int], bool] = lambda _first, _last: False,
        period: float = 1.0,
    ) -> None:
        """Begin without candidates.

        Args:
            law: that of the running controller; None if the loop is not known.
            settings: horizons and intervals.
            spoilt: whether the plant is known to have been at fault between two samples; nothing is learned
                from such a stretch.
            period: sample time if the loop is not known, s; otherwise the controller's is used.
        """
        self.settings = settings or ForecastSettings()
        self._law = law
        self._spoilt = spoilt
        self.period = period = law.period if law is not None else period
        self.horizons = tuple(max(round(h / period), 1) for h in self.settings.horizons)
        self._longest = max(self.horizons)
        self._stride = max(round(self.settings.every / period), 1)
        self._kept = float(np.exp(-self.settings.every / self.settings.memory))
        scale = self.settings.scale
        self._leads = leads_of(period / scale, self._longest)
        self._twins = Entrants()
        self.standings = Standings()
        """How the candidates' forecasts stand."""
        self._ledger: Ledger | None = None
        self._leader_confidence = LeaderConfidence(self._kept)
        self._departures: dict[int, _Departure] = {}
        self._learned: deque[_Learned] = deque(maxlen=_NOTES_KEPT)
        self._run_in = tuple(round(stretch * scale / period) for stretch in _RUN_IN)
        self._recent: deque[Sample] = deque(
            maxlen=max(self._longest + self._stride, *self._run_in) + 1
        )
        self._waiting: list[tuple[Sample, Signals]] = []
        """Samples, each with what the law was given as its outputs."""
        self._controller = np.zeros(0)
        self._rows: SampleRows | None = None
        """Those of the recent samples, without the ones that are waiting; None before the first."""
        self._followers = Followers()
        self._begin()
        self._arx = Arx(law, float(np.exp(-period / self.settings.memory)))
        self.notes: tuple[str, ...] = ()
        """Reservations to be shown with forecasts made now."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates, in the order that decides ties."""
        return tuple(self._twins)

    @property
    def leader(self) -> str | None:
        """The candidate whose forecasts have saved the most characters; None without candidates."""
        return self.standings.leader

    @property
    def confidence(self) -> float:
        """Probability that the leader is within 3 % of the best in hindsight, estimated from the past."""
        return self._leader_confidence.share

    @property
    def scores(self) -> tuple[ForecastScore, ...]:
        """Scores of all candidates, in their order."""
        return self.standings.scores

    @property
    def sentence(self) -> str:
        """A sentence on which candidate leads and how certain that is; empty without candidates."""
        return self.standings.sentence(self.confidence)

    def forecasts_of(self, name: str) -> float:
        """Effective number of a candidate's forecasts that could be scored, older ones weighted less."""
        return 0.0 if self._ledger is None else self._ledger.forecasts(name)

    def push(self, sample: Sample, taken: Signals | None = None) -> None:
        """Take one sample: correct every twin, and learn from the forecasts whose horizon it completes.

        The law was given `taken`; None: the outputs.

        Twins whose equations are not external take it later, with the next ones, before they are used.
        """
        if self._recent and not sample.follows(self._recent[-1]):
            self._begin()
        self._recent.append(sample)
        self._waiting.append((sample, sample.outputs if taken is None else taken))
        self._arx.push(sample)
        for name in self._twins.external:
            with self._removing_lost(name):
                self._twins[name].state_filter.push(sample)
        if len(self._waiting) >= self._stride:
            self._catch_up()
        if self._twins and sample.index % self._stride == 0:
            self._departures[sample.index] = self._departure()
        for number, horizon in enumerate(self.horizons):
            departure = self._departures.get(sample.index - horizon)
            if departure is not None:
                self._learn(departure, sample.index - horizon, number)
        if sample.index % (_NOTED_EVERY * self._stride) == 0:
            self._note_learned(sample.index)
        # One forecast more is kept: `check_bands` needs one that is old enough at every sample.
        self._departures.pop(sample.index - self._longest - self._stride, None)

    def _note_learned(self, sample: int) -> None:
        """Note what forecasts have taught up to a sample."""
        if self._ledger is None:
            return
        calibrations = {
            name: twin.calibration.copy() for name, twin in self._twins.items()
        }
        self._learned.append(
            _Learned(
                sample,
                self._ledger.copy(),
                calibrations,
                self._leader_confidence.copy(),
            )
        )

    def forget_since(self, sample: int) -> None:
        """Take back what forecasts have taught since a sample, and a little before it; if it is too long ago,
        nothing. Candidates that were not there start over."""
        earlier = [learned for learned in self._learned if learned.sample < sample]
        if not earlier:
            return
        before = earlier[-1]
        self._learned = deque(earlier, self._learned.maxlen)
        self._ledger = before.ledger.copy()
        self._leader_confidence = before.leader_confidence.copy()
        for name, twin in self._twins.items():
            noted = before.calibrations.get(name)
            twin.calibration = (
                self._new_calibration(twin.candidate) if noted is None else noted.copy()
            )
        self._set(self._twins)

    def _catch_up(self) -> None:
        """Have the twins, and the controller's state, take the samples that are waiting."""
        if not self._waiting:
            return
        samples = [sample for sample, _ in self._waiting]
        outputs_taken = np.array([taken for _, taken in self._waiting])
        self._waiting = []
        new_rows = SampleRows.of(samples)
        if not finite(new_rows.values):
            is_finite = np.isfinite(new_rows.values).all(axis=1)
            bad = samples[int(np.argmin(is_finite))].index
            raise PlantError(f"forecaster: sample {bad} has a value that is not finite")
        most = self._recent.maxlen or 1
        self._rows = (
            new_rows.newest(most)
            if self._rows is None
            else self._rows.followed_by(new_rows, most)
        )
        if self._law is not None:
            for references, outputs, inputs in zip(
                new_rows.references, outputs_taken, new_rows.inputs, strict=True
            ):
                self._controller = self._law.follow(
                    self._controller, references, outputs, inputs
                )
        self._followers.push(
            [self._twins[name].state_filter for name in self._twins.native], samples
        )

    def _newest_rows(self, count: int) -> SampleRows:
        """The newest so many rows, once all samples have been taken; there is at least one."""
        assert self._rows is not None  # noqa: S101
        return self._rows.newest(count)

    def _departure(self) -> _Departure:
        """What forecasts from the newest sample need."""
        self._catch_up()
        leader = self.leader or self.names[0]
        outlooks = {
            name: self._outlook(name) for name in {*self._twins.external, leader}
        }
        names = self._twins.native
        foresight = None
        loop_state = None
        if names:
            filters = [self._twins[name].state_filter for name in names]
            foresight = self._twins.foresight(self._law, self.period)
            states = [f.states for f in filters]
            covariances = [f.joint for f in filters]
            loop_state = foresight.at(
                states, covariances, self._recent[-1].inputs, self._controller
            )
        forecast_number = self._recent[-1].index // self._stride
        learning = self._twins if forecast_number % _OTHERS_EVERY == 0 else (leader,)
        widths = {name: self._twins[name].calibration.widths for name in learning}
        return _Departure(
            leader, outlooks, names, foresight, loop_state, self.arx, widths
        )

    def enter(
        self,
        candidates: Sequence[Candidate],
        successors: Mapping[str, str] | None = None,
    ) -> None:
        """Set the candidates; those already present with the same parameters continue.

        Args:
            candidates: all of them; of two with equal savings, the one named first leads.
            successors: by name of a new candidate, the earlier one whose score it inherits.
        """
        self._catch_up()
        successors = successors or {}
        if self._ledger is None and candidates:
            noise = forecast_noise(candidates[0].parameters.model.plant, self._law)
            new = np.minimum(self._stride / np.array(self.horizons), 1.0)
            self._ledger = Ledger(new, noise, self._kept)
        twins = {}
        for candidate in candidates:
            twin = self._twins.get(candidate.name)
            if twin is None or twin.candidate.parameters != candidate.parameters:
                earlier = twin or self._twins.get(successors.get(candidate.name, ""))
                try:
                    twin = self._built(candidate, earlier)
                except PlantError:
                    if not candidate.parameters.model.is_external:
                        raise
                    continue
            twins[candidate.name] = twin
        if self._ledger is not None:
            for name, before in successors.items():
                if name not in self._twins:
                    self._ledger.inherit(name, before)
        self._set(twins)

    def _set(self, twins: Mapping[str, Entrant]) -> None:
        self._twins = Entrants(twins)
        if self._ledger is not None:
            self._ledger.keep(twins)
        self.standings = Standings(twins, self._ledger, self.horizons)

    def snapshot(self) -> Snapshot:
        """The outlooks of all candidates at the newest sample."""
        if not self._recent:
            return Snapshot()
        self._catch_up()
        outlooks = {name: self._outlook(name) for name in self._twins}
        return Snapshot(self.leader, outlooks, self.standings.leading)

    def outlook(self, name: str | None = None) -> Outlook:
        """The outlook of a candidate, by default the leader, at the newest sample.

        Raises:
            ForecastError: there is no candidate yet, or none of that name.
        """
        self._catch_up()
        twins = self._twins if self._recent else {}
        return self._outlook(_check_name(self.leader if name is None else name, twins))

    def _outlook(self, name: str) -> Outlook:
        twin = self._twins[name]
        return Outlook(
            sample=self._recent[-1],
            candidate=name,
            parameters=twin.candidate.parameters,
            states=twin.state_filter.states,
            covariance=twin.state_filter.joint,
            unsure=twin.state_filter.free,
            controller=self._controller,
            law=self._law,
            period=self.period,
            leads=self._leads,
            widths=twin.calibration.widths,
            visited=self._arx.visited,
            notes=self.notes,
        )

    @property
    def arx(self) -> ArxForecast:
        """The ARX model at the newest sample."""
        departure = (
            self._departures.get(self._recent[-1].index) if self._recent else None
        )
        if departure is not None:
            return departure.arx
        self._catch_up()
        return self._arx.departure(self._controller)

    def check_bands(self, samples: int) -> BandCheck | None:
        """How the newest readings, of so many samples, lie in the bands forecast for them.

        The forecast is that of the leader at its time, from the last saved state before these samples, under
        the actual set-points (or inputs) and disturbances. Samples that were lost or refused are not
        compared. At the beginning of a session a forecast that covers half of these samples is compared with
        them.

        Returns:
            The comparison; None without a forecast, without a reading, or if no candidate is left that leads.
        """
        if not self._recent or self.leader is None:
            return None
        newest = self._recent[-1].index
        old_enough = [
            sample for sample in self._departures if sample <= newest - samples
        ]
        is_beginning = len(self._recent) <= samples
        if not old_enough and is_beginning:
            old_enough = [
                sample
                for sample in self._departures
                if sample <= newest - (samples - 1) // 2
            ]
            samples = newest - max(old_enough, default=newest)
        if not old_enough:
            return None
        self._catch_up()
        departure = self._departures[old_enough[-1]]
        outlook = departure.outlooks[departure.leader]
        rows_since = self._newest_rows(newest - old_enough[-1] + 1)
        try:
            forecast = outlook.forecast(*self._conditions(rows_since))
        except PlantError:
            if not outlook.parameters.model.is_external:
                raise
            return None
        rows = rows_since.newest(samples)
        is_received = rows.is_received
        if not is_received.any():
            return None
        measured_inputs = None if self._law is None else rows.inputs.T
        counted = None if is_received.all() else is_received
        return check_band(forecast, rows.outputs.T, measured_inputs, counted)

    @contextmanager
    def _removing_lost(self, name: str) -> Iterator[None]:
        """Remove a candidate whose equations run elsewhere if they fail there; the others continue."""
        try:
            yield
        except PlantError:
            if not self._twins[name].candidate.parameters.model.is_external:
                raise
            self._set(
                {
                    twin_name: twin
                    for twin_name, twin in self._twins.items()
                    if twin_name != name
                }
            )

    def _conditions(self, rows_since: SampleRows) -> _Conditions:
        """What forecasts are made for, from the rows of the sample they depart from and of those after it."""
        given = rows_since.inputs if self._law is None else rows_since.references
        disturbances = np.ascontiguousarray(rows_since.disturbances)
        return _Conditions(
            ahead=np.ascontiguousarray(given[1:]),
            disturbances=disturbances if disturbances.size else None,
        )

    def _begin(self) -> None:
        """Start over, also after a gap; what was learned stays."""
        self._recent.clear()
        self._waiting.clear()
        self._departures.clear()
        self._learned.clear()
        self._rows = None
        self._controller = np.zeros(0 if self._law is None else self._law.n_states)
        for twin in self._twins.values():
            twin.state_filter.restart()

    def _built(self, candidate: Candidate, before: Entrant | None) -> Entrant:
        """Build a twin and run it over the newest samples, as far back as its states need.

        Its bands begin with what those of `before` have learned.
        """
        calibration = (
            before.calibration.copy() if before else self._new_calibration(candidate)
        )
        for stretch in self._run_in:
            recent = list(self._recent)[-stretch:]
            states = candidate.states_at(recent[0].index) if recent else None
            if states is not None:
                break
        state_filter = StateFilter(
            candidate.parameters,
            self.period,
            states=states,
            free=candidate.free,
            covariance=candidate.known_covariance,
        )
        state_filter.follow(recent)
        return Entrant(candidate, state_filter, calibration)

    def _new_calibration(self, candidate: Candidate) -> Calibration:
        """One that has learned nothing."""
        plant = candidate.parameters.model.plant
        return Calibration(
            self._leads,
            self._kept,
            float(np.exp(-self._stride / self._longest)),
            forecast_noise(plant, self._law).size,
            self._stride,
            outputs=len(plant.outputs),
        )

    def _learn(self, departure: _Departure, sample: int, number: int) -> None:
        """Score the forecasts made at a sample on those after it, up to the horizon of this number."""
        ahead = self.horizons[number]
        ledger = self._ledger
        if ledger is None or self._spoilt(sample, sample + ahead):
            return
        self._catch_up()
        rows_since = self._newest_rows(ahead + 1)
        scored_before = self._longest_below(ahead)
        if not rows_since.is_received[1 + scored_before :].any():
            return
        compared = self._compared(departure, rows_since, ledger.noise.size)
        self._learn_bands(departure.widths, compared, scored_before)
        received = compared.received
        new = received[received >= scored_before]
        ledger.add(
            tuple(compared.forecasts),
            compared.errors[:, :, new],
            compared.baseline_errors[:, :, new],
            number,
        )
        self.standings = Standings(self._twins, ledger, self.horizons)
        if ahead == self._longest and departure.leader in compared.forecasts:
            self._learn_confidence(departure.leader, compared, ledger.noise)

    def _longest_below(self, ahead: int) -> int:
        """The longest horizon that is shorter than one, samples, up to which forecasts have been scored already; 0 if
        there is none."""
        shorter = (horizon for horizon in self.horizons if horizon < ahead)
        return max(shorter, default=0)

    def _compared(
        self, departure: _Departure, rows_since: SampleRows, signals: int
    ) -> _ComparedForecasts:
        """What became of the forecasts of so many signals, by the rows of the departure and of the samples after
        it."""
        conditions = self._conditions(rows_since)
        measured = np.ascontiguousarray(rows_since.signals(signals).T)[:, 1:]
        banded = departure.widths.keys() & self._twins.keys()
        forecasts = self._forecasts(departure, conditions, banded)
        means = np.array([forecast.means[:signals] for forecast in forecasts.values()])
        baselines = departure.arx.referees(*conditions)[:, :signals]
        return _ComparedForecasts(
            forecasts,
            errors=measured - means.reshape(-1, *measured.shape),
            baseline_errors=measured - baselines,
            is_received=rows_since.is_received[1:],
        )

    def _learn_bands(
        self,
        widths: Mapping[str, FloatArray],
        compared: _ComparedForecasts,
        before: int,
    ) -> None:
        """Have bands learn from the sizes of the errors, at the leads after `before`.

        `widths` are those that they had, by names of the candidates whose bands learn from this forecast.
        """
        sizes = np.where(compared.is_received, np.abs(compared.errors), np.nan)
        for of_candidate, (name, forecast) in zip(
            sizes, compared.forecasts.items(), strict=True
        ):
            if name in widths:
                self._twins[name].learn(
                    of_candidate, forecast.variances, before, widths[name]
                )

    def _learn_confidence(
        self, leader: str, compared: _ComparedForecasts, noise: FloatArray
    ) -> None:
        """Compare the leader with the best in hindsight, by errors in units of the noise, shape (signals,)."""
        in_noise = rms(compared.errors[:, :, compared.received], noise[:, None])
        of_candidates = rms(in_noise)
        of_leader = of_candidates[list(compared.forecasts).index(leader)]
        self._leader_confidence.add(float(of_leader), float(of_candidates.min()))

    def _forecasts(
        self, departure: _Departure, conditions: _Conditions, banded: Collection[str]
    ) -> dict[str, _Forecast]:
        """What all candidates that are left forecast from a departure; with variances the banded ones."""
        forecasts: dict[str, _Forecast] = {}
        if departure.foresight is not None and departure.now is not None:
            wanted = [self._wanted_of(name, banded) for name in departure.names]
            means, variances = departure.foresight.each(
                departure.now, wanted, *conditions
            )
            for k, name in enumerate(departure.names):
                if wanted[k] is not Wanted.NOTHING:
                    forecasts[name] = _Forecast(means[k], variances[k])
        for name in self._twins.external:
            if name in departure.outlooks:
                with self._removing_lost(name):
                    predicted = departure.outlooks[name].predicted(
                        *conditions, banded=name in banded
                    )
                    forecasts[name] = _Forecast(predicted.means, predicted.variances)
        return forecasts

    def _wanted_of(self, name: str, banded: Collection[str]) -> Wanted:
        if name not in self._twins:
            return Wanted.NOTHING
        return Wanted.BANDED if name in banded else Wanted.MEAN


def forecast_noise(plant: type[Plant], law: Law | None) -> FloatArray:
    """Noise of the forecast signals: of all outputs and, where the loop is known, of all inputs; shape
    (signals,)."""
    noise = [output.noise for output in plant.outputs.values()]
    if law is not None:
        noise += [drive.noise for drive in plant.drives.values()]
    return np.array(noise)


def _check_name(name: str | None, candidates: Mapping[str, object]) -> str:
    """Check that there is a candidate of this name, and return the name.

    Raises:
        ForecastError: there is no candidate yet, or none of that name.
    """
    if name is None or not candidates:
        msg = "forecast: there is no candidate yet; the first comes with the first match that is accepted"
        raise ForecastError(msg)
    if name not in candidates:
        names = ", ".join(candidates)
        raise ForecastError(
            f"forecast: no candidate {name!r}; at this sample there are: {names}"
        )
    return name
