"""The state as metrics of Prometheus, read at each scrape."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from twinmatch.comparing import TrustLevel, Verdict
from twinmatch.showing.page.goal import GoalAnswer
from twinmatch.showing.page.outline import ahead, coverage
from twinmatch.showing.page.state import DashboardState

_Gauge = tuple[str, str, str, Iterable[tuple[float, tuple[str, ...]]]]
"""Name without its prefix, help, names of the labels; each number with the labels' values."""


class StateMetrics(Collector):
    """The metrics of a state at a moment; a metric that is not known has no number."""

    def __init__(self, state: DashboardState, now: float) -> None:
        """`now` (s) is of the clock that the state's times are taken from."""
        self._state = state
        self._now = now

    def collect(self) -> Iterator[Metric]:
        """All metrics."""
        state = self._state
        with state.lock:
            of_verdict = _of_verdict(state, state.verdict) if state.verdict else ()
            of_goal = _of_goal(state.goal) if state.goal else ()
            gauges = [*_of_state(state, self._now), *of_verdict, *of_goal]
        for name, text, labels, numbers in gauges:
            family = GaugeMetricFamily(f"twinmatch_{name}", text, labels=labels.split())
            for number, values in numbers:
                if math.isfinite(number):
                    family.add_metric(values, number)
            yield family


def exposition(state: DashboardState, now: float) -> bytes:
    """The metrics in the text format of Prometheus; `now` as for `StateMetrics`."""
    registry = CollectorRegistry()
    registry.register(StateMetrics(state, now))
    return generate_latest(registry)


def _of_state(state: DashboardState, now: float) -> Iterator[_Gauge]:
    """What is known without a verdict: samples, trust, faults and the newest forecast."""
    index = math.nan if state.sample is None else float(state.sample)
    age = math.nan if state.received_at is None else now - state.received_at
    statements = state.statements
    trust = statements.trust
    levels = [(float(level is trust.level), (level.value,)) for level in TrustLevel]
    faults_on = [(1.0, (fault.name, fault.signal)) for fault in statements.faults] or [
        (0.0, ("", ""))
    ]
    yield "sample_index", "Index of the newest sample.", "", [(index, ())]
    yield (
        "verdicts",
        "Verdicts of this session.",
        "",
        [(float(state.tally.verdicts), ())],
    )
    yield (
        "sample_age_seconds",
        "Time since the newest sample was received.",
        "",
        [(age, ())],
    )
    yield (
        "trust_level",
        "1 for the level of trust in the leader, 0 for the others.",
        "level",
        levels,
    )
    longest = [(trust.longest, ())]
    yield (
        "trusted_horizon_seconds",
        "How far ahead the leader is trusted; 0: not at all.",
        "",
        longest,
    )
    yield (
        "fault",
        "1 for each fault of plant or drive that is on; 0 without one.",
        "fault channel",
        faults_on,
    )
    points = [
        (point, (point.signal.name, point.signal.unit, f"{point.horizon:g}"))
        for point in ahead(state)
    ]
    for edge in ("mean", "low", "high"):
        text = f"The leader's forecast at a horizon in seconds, {edge} of its band."
        numbers = [(getattr(point, edge), values) for point, values in points]
        yield f"forecast_{edge}", text, "signal unit horizon", numbers


def _of_goal(answer: GoalAnswer) -> Iterator[_Gauge]:
    """When the level that is asked for is reached; what is not within the forecast has no number."""
    level = f"{answer.goal.level:g}"
    moments = (("held", answer.held), ("moved", answer.moved))
    text = "Time until the level is reached, with nothing changed (held) or the move made now (moved)."
    numbers = []
    for under, moment in moments:
        for edge in ("expected", "earliest", "latest"):
            time = getattr(moment, edge)
            if time is not None:
                numbers.append((time, (level, under, edge)))
    yield "reach_seconds", text, "level under edge", numbers
    text = "Time until the move has to be made so that the level is reached in time."
    yield "begin_seconds", text, "level by", [(answer.begin, (level, answer.goal.by))]


def _of_verdict(state: DashboardState, verdict: Verdict) -> Iterator[_Gauge]:
    """How the leader's forecasts came true."""
    shares = [(share, (f"{horizon:g}",)) for horizon, share in coverage(state).items()]
    signals = (*state.described.outputs, *state.described.inputs)
    misses = zip(signals, verdict.misses, strict=False)  # given inputs have none
    text = "Share of the readings that the leader's bands have held; 0.9 is expected."
    yield "forecast_coverage_ratio", text, "horizon", shares
    text = "RMS of reading minus the leader's forecast over the newest samples, in half widths of its band."
    yield (
        "forecast_error_rms",
        text,
        "signal",
        [(miss, (signal.name,)) for signal, miss in misses],
    )
    ratios = [
        (1.0 - skill, (baseline, f"{horizon:g}"))
        for baseline in ("persistence", "arx")
        for horizon, skill in zip(
            verdict.horizons,
            getattr(verdict.leading, f"{baseline}_skill", ()),
            strict=False,
        )
    ]
    text = "Mean |error| of the leader's forecasts, divided by that of a baseline."
    yield "forecast_error_ratio", text, "baseline horizon", ratios
