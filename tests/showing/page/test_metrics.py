"""The page's metrics, as Prometheus reads them."""

from __future__ import annotations

import math
import sys
import urllib.request
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)
pytest.importorskip(
    "prometheus_client",
    reason="prometheus_client is not installed; it is in the extra 'outlets'",
)

from prometheus_client.parser import text_string_to_metric_families

from tests.showing.page.test_server import fill
from tests.support.sockets import ask
from tests.support.verdicts import LED
from twinmatch.comparing import TrustLevel
from twinmatch.forecasting import Band, Forecast
from twinmatch.offline.judging import Judgement
from twinmatch.plants import Peltier
from twinmatch.plants.records import description_of
from twinmatch.plants.tclab import TCLabBoth
from twinmatch.showing.page.metrics import exposition
from twinmatch.showing.page.server import PageServer
from twinmatch.showing.page.shown import metrics_text, outlet_to
from twinmatch.showing.page.state import DashboardState, DriveReport
from twinmatch.showing.serving import ServingError

Numbers = dict[tuple[str, frozenset[str]], float]
"""By the name, without its prefix, and the values of the labels that are not empty."""


def read(text: bytes) -> Numbers:
    samples = {}
    for family in text_string_to_metric_families(text.decode()):
        assert family.type == "gauge"
        assert family.documentation.endswith(".")
        for name, labels, value, *_ in family.samples:
            samples[
                number_key(
                    name.removeprefix("twinmatch_"), *filter(None, labels.values())
                )
            ] = value
    return samples


def number_key(name: str, *values: str) -> tuple[str, frozenset[str]]:
    return name, frozenset(values)


def numbers(state: DashboardState, now: float = 0.0) -> Numbers:
    return read(exposition(state, now))


def course(sample: int, *signals: float, outputs: int = 1) -> Forecast:
    """A forecast of 300 s: each signal rises by 0.01 a second from its number, give or take 1."""
    time = np.arange(1.0, 301.0)
    bands = [
        Band(k + 0.01 * time, k + 0.01 * time - 1.0, k + 0.01 * time + 1.0)
        for k in signals
    ]
    return Forecast(
        sample,
        "twin",
        "",
        0.9,
        time,
        np.full(300, 50.0),
        tuple(bands[:outputs]),
        tuple(bands[outputs:]),
    )


@pytest.fixture
def state(judged: Judgement) -> DashboardState:
    """After the whole session, with a forecast."""
    state = DashboardState(described=description_of(Peltier))
    for sample in judged.samples:
        state.push_sample(sample, 100.0)
    for verdict in judged.verdicts:
        state.push_verdict(verdict)
    state.push_forecast(course(judged.samples[-1].index, 45.0, 20.0))
    return state


@pytest.fixture
def server(state: DashboardState) -> Iterator[PageServer]:
    opened = PageServer("127.0.0.1", 0, fill, metrics=lambda: exposition(state, 102.5))
    yield opened
    assert opened.close()


def test_prometheus_reads_what_the_page_knows(
    server: PageServer, state: DashboardState
) -> None:
    with urllib.request.urlopen(f"{server.url}metrics") as answer:
        assert (
            answer.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
        )
        exported = read(answer.read())
    verdict = state.verdict
    assert verdict is not None
    assert exported[number_key("sample_index")] == state.sample
    assert exported[number_key("sample_age_seconds")] == 2.5
    assert exported[number_key("verdicts")] == state.tally.verdicts > 1
    levels = {
        level: exported[number_key("trust_level", level.value)] for level in TrustLevel
    }
    assert levels == {level: float(level is verdict.level) for level in TrustLevel}
    assert exported[number_key("fault")] == 0.0
    for horizon, rise in (("10", 0.1), ("60", 0.6), ("300", 3.0)):
        for edge, offset in (("mean", 0.0), ("low", -1.0), ("high", 1.0)):
            assert exported[
                number_key(f"forecast_{edge}", "temperature", "°C", horizon)
            ] == pytest.approx(45.0 + rise + offset)
            assert exported[
                number_key(f"forecast_{edge}", "pwm", "PWM", horizon)
            ] == pytest.approx(20.0 + rise + offset)


def test_errors_and_coverage_are_those_of_the_leader(state: DashboardState) -> None:
    verdict = state.verdict
    exported = numbers(state)
    assert verdict is not None
    leading = verdict.leading
    assert leading is not None
    errors = {"temperature": verdict.miss_y, "pwm": verdict.miss_u}
    assert {
        name: exported[number_key("forecast_error_rms", name)] for name in errors
    } == errors
    known_horizons = [
        k for k, share in enumerate(leading.coverage) if not math.isnan(share)
    ]
    assert known_horizons
    for k in known_horizons:
        horizon = f"{verdict.horizons[k]:g}"
        assert (
            exported[number_key("forecast_coverage_ratio", horizon)]
            == leading.coverage[k]
        )
        assert (
            exported[number_key("forecast_error_ratio", "persistence", horizon)]
            == 1.0 - leading.persistence_skill[k]
        )
        assert (
            exported[number_key("forecast_error_ratio", "arx", horizon)]
            == 1.0 - leading.arx_skill[k]
        )


def test_it_is_trusted_as_far_as_the_verdict_says_and_only_at_its_level(
    state: DashboardState,
) -> None:
    for level, ahead in (
        (TrustLevel.TRUSTED, 60.0),
        (TrustLevel.DOUBTFUL, 0.0),
        (TrustLevel.FAULT, 0.0),
    ):
        state.push_verdict(
            replace(
                LED, level=level, horizons=(10.0, 60.0, 300.0), trusted=(10.0, 60.0)
            )
        )
        assert numbers(state)[number_key("trusted_horizon_seconds")] == ahead


def test_a_fault_has_its_kind_and_its_channel_and_ends() -> None:
    state = DashboardState()
    state.push_verdict(
        replace(LED, level=TrustLevel.FAULT, fault="drive-lost", fault_signal="power")
    )
    state.push_drive(DriveReport(0.0, math.nan, "too_hot: 121 °C"))
    exported = numbers(state)
    faults = {
        labels: value for (name, labels), value in exported.items() if name == "fault"
    }
    assert faults == {
        frozenset({"drive-lost", "power"}): 1.0,
        frozenset({"output held at zero: too hot"}): 1.0,
    }
    assert exported[number_key("trust_level", "fault")] == 1.0
    state.push_verdict(replace(LED, sample=301))
    state.push_drive(DriveReport(0.0, math.nan, ""))
    assert numbers(state)[number_key("fault")] == 0.0


def test_each_signal_of_several_has_its_own_numbers() -> None:
    state = DashboardState(described=description_of(TCLabBoth))
    state.plant.push(7, [0.0] * 6)
    state.push_forecast(course(7, 40.0, 50.0, 10.0, 20.0, outputs=2))
    exported = numbers(state)
    for signal, unit, expected in (
        ("temperature", "°C", 43.0),
        ("second_temperature", "°C", 53.0),
        ("second", "%", 23.0),
    ):
        assert exported[
            number_key("forecast_mean", signal, unit, "300")
        ] == pytest.approx(expected)


def test_what_is_not_known_has_no_number() -> None:
    exported = numbers(DashboardState())
    assert exported == {
        **{
            number_key(name): 0.0
            for name in ("verdicts", "fault", "trusted_horizon_seconds")
        },
        **{
            number_key("trust_level", level.value): float(level is TrustLevel.UNKNOWN)
            for level in TrustLevel
        },
    }


@pytest.mark.parametrize(
    ("header", "host", "status"),
    [
        ("Accept: text/plain", None, 200),
        ("Origin: http://evil.example", None, 403),
        ("Sec-Fetch-Site: cross-site", None, 403),
        ("Accept: text/plain", "evil.example", 403),
    ],
)
def test_a_page_of_another_origin_may_not_read_them(
    server: PageServer, header: str, host: str | None, status: int
) -> None:
    got, text = ask(server.url, "/metrics", header, host=host)
    assert got == status
    assert ("twinmatch_" in text) == (status == 200)


def test_without_its_library_it_says_what_to_install(
    state: DashboardState, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("prometheus_client", "paho"):
        monkeypatch.setitem(sys.modules, package, None)
    opened = PageServer("127.0.0.1", 0, fill, metrics=lambda: metrics_text(state))
    try:
        status, text = ask(opened.url, "/metrics")
    finally:
        assert opened.close()
    assert status == 404
    assert text == (
        "/metrics needs prometheus_client, which is not installed; pip install 'twinmatch[outlets]'\n"
    )
    with pytest.raises(ServingError, match="--tell needs paho, which is not installed"):
        outlet_to("mqtt://127.0.0.1")
