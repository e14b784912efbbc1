"""A forecast among the samples, and what is said of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twinmatch.forecasting import Band, Forecast
from twinmatch.plants import Peltier
from twinmatch.showing.figures.forecasts import draw_forecasts
from twinmatch.showing.forecasts import comparison_words, forecast_words
from twinmatch.showing.series import Fan, fan
from twinmatch.signals import Sample


def forecast(
    output: Sequence[float], reference: Sequence[float], *, sample: int = 10, half: float = 0.5
) -> Forecast:
    mean, size = np.array(output, dtype=np.float64), len(output)
    entry = np.linspace(-200.0, 100.0, size)
    return Forecast(
        sample=sample,
        candidate="70 °C",
        structure="no sink",
        confidence=0.9,
        time=np.arange(1.0, size + 1),
        reference=np.array(reference, dtype=np.float64),
        output=Band(mean, mean - half, mean + half),
        input=Band(entry, np.maximum(entry - 10, -255), np.minimum(entry + 10, 255)),
    )


def recorded(reference: Sequence[float], *, missing: int | None = None) -> list[Sample]:
    """Samples 0 and on; the output is 50 °C and a tenth of the index."""
    found = [Sample(k, k * 10**9, r, 50 + 0.1 * k, 5.0 * k) for k, r in enumerate(reference)]
    return [s for s in found if s.index != missing]


def around(*, reference: Sequence[float], missing: int | None = None) -> Fan:
    """A forecast of ten samples made at sample 10, a session of which has these set-points."""
    told = forecast((50 + 0.1 * np.arange(11, 21)).tolist(), [60.0] * 10)
    return fan(told, recorded(reference, missing=missing), 1.0)


def test_it_is_compared_with_the_measurements() -> None:
    found = around(reference=[60.0] * 40)
    assert (found.past.last, found.measured.first, found.measured.last) == (10, 11, 20)  # type: ignore[union-attr]
    np.testing.assert_allclose(found.error, 0, atol=1e-12)
    y, u = found.in_band
    assert y.tolist() == [1.0] * 10
    assert u.tolist() == [float(abs(5 * k - (-200 + 300 * (k - 11) / 9)) <= 10) for k in range(11, 21)]


@given(st.integers(11, 25), st.integers(11, 25), st.integers(11, 30))
def test_it_is_so_up_to_another_set_point_a_missing_sample_or_the_end(step: int, gone: int, end: int) -> None:
    reference = [60.0 if k < step else 70.0 for k in range(end)]
    found = around(reference=reference, missing=gone)
    assert found.judged == max(0, min(step, gone, end, 21) - 11)
    assert found.error.size == found.in_band[0].size == found.in_band[1].size == found.judged


def test_nothing_recorded_behind_it_is_nothing_to_say() -> None:
    found = around(reference=[60.0] * 11)
    assert found.measured is None
    assert comparison_words(found, Peltier) == []
    assert draw_forecasts([found], Peltier).axes


def test_what_was_known_ends_where_a_sample_is_missing() -> None:
    assert around(reference=[60.0] * 30, missing=8).past.first == 9


def words(output: Sequence[float], reference: Sequence[float]) -> str:
    return "\n".join(forecast_words(forecast(output, reference), Peltier))


def test_each_set_point_ahead_has_its_answer() -> None:
    rise = [51.0 + k for k in range(20)]
    told = words(rise, [60.0] * 15 + [90.0] * 5)
    # Within 1 °C by the mean at 59 °C, by the band's edges 0.5 °C before and after.
    arrival = "first after 9 s (9 to 10), but it does not stay there"
    assert f"within 1 °C of 60 °C (set-point from 1 to 15 s): {arrival}" in told
    assert "within 1 °C of 90 °C (set-point from 16 to 20 s): not in that time" in told
    assert "temperature after 20 s: 70.0 °C, within 69.5 to 70.5 °C in 90 % of such cases" in told
    assert "width of the band: 1.0 °C and 20 PWM at 10 s" in told
    assert "largest control: 200 PWM after 1 s (190 to 210)" in told


def test_what_is_there_already_is_not_reached() -> None:
    assert "within 1 °C of 60 °C: all the time" in words([60.0] * 12, [60.0] * 12)


def test_of_a_ramp_only_the_end_is_reported() -> None:
    told = words(np.linspace(50, 70, 20).tolist(), np.linspace(50, 70, 20).tolist())
    assert told.count("within 1 °C of") == 1
    assert "within 1 °C of 70 °C" in told


def test_the_picture_has_three_panels_for_each_and_explains_every_line_once() -> None:
    figure = draw_forecasts([around(reference=[60.0] * 40)] * 4, Peltier)
    assert len(figure.axes) == 12
    said = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sorted(said) == sorted(
        ["set-point", "90 % band", "measured before", "measured afterwards", "forecast"]
    )
    assert draw_forecasts([], Peltier).axes[0].texts[0].get_text() == "no forecast was made"
