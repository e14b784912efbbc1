"""The small parts that tables and figures are made of."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.colours import contrast, linear
from tests.support.plants import Motor
from tests.support.rig import rig, run
from twinmatch.comparing import Candidate, CandidateScore, OrderScore, Verdict, score
from twinmatch.comparing.criteria import Criteria
from twinmatch.dynamics import (
    Drive,
    Equations,
    Output,
    Parameter,
    Plant,
    State,
    Structure,
)
from twinmatch.forecasting import Band, Forecast
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.offline.summary import summarise
from twinmatch.plants import PLANTS, Peltier, TCLabBoth
from twinmatch.sessions import samples_of
from twinmatch.showing.family import Member, criterion_rows, family
from twinmatch.showing.figures.drawing import png
from twinmatch.showing.figures.family import (
    draw_criteria,
    draw_matrix,
    draw_responses,
    draw_uncertainty,
)
from twinmatch.showing.figures.forecasts import draw_forecasts
from twinmatch.showing.forecasts import (
    comparison_words,
    forecast_document,
    forecast_words,
)
from twinmatch.showing.quantities import in_order, number, parameter_format
from twinmatch.showing.report.pictures import hardest_forecasts
from twinmatch.showing.series import Fan, compare, fan, rolling_rms
from twinmatch.showing.style import (
    CLOSED,
    DRIVEN,
    LEVELS,
    ORDERS,
    PLANT,
    SET_POINT,
    TEXT,
)
from twinmatch.showing.summary import document, sentence
from twinmatch.signals import KELVIN, Sample, Window, stretches
from twinmatch.twin import MatchReport, TwinSettings, filled_stretches


@pytest.mark.parametrize("plant", PLANTS.values(), ids=str)
def test_every_parameter_has_a_symbol_a_unit_and_words(plant: type[Plant]) -> None:
    for name in plant.parameters:
        shown = parameter_format(plant, name)
        assert shown.name == name
        assert shown.symbol != name, f"{name} has no symbol"
        assert shown.unit
        assert shown.words


def test_parameters_are_shown_in_units_that_read_well() -> None:
    alpha, slope, room = (
        parameter_format(Peltier, name)
        for name in ("seebeck", "seebeck_slope", "ambient")
    )
    assert (alpha.text(0.06), alpha.label) == ("60.0", "α / (mV/K)")
    assert (slope.text(1.2e-4), slope.unit) == ("120", "µV/K²")
    assert (room.text(KELVIN + 22.5), room.unit, room.error_text(0.5)) == (
        "22.5",
        "°C",
        "0.50",
    )
    assert parameter_format(Peltier, "conductance").text(0.7) == "0.700"
    sink = parameter_format(Peltier, "sink")
    assert (sink.symbol, sink.text(KELVIN + 30.0)) == ("T_B(0)", "30.0")
    assert parameter_format(Peltier, "new_thing").text(1.0) == "1.0000"
    names = ("sink", "heat_capacity", "new_thing", "seebeck")
    assert in_order(Peltier, names) == ("seebeck", "heat_capacity", "sink", "new_thing")


class OnOff(Plant, name="shown_on_off"):
    """What a heater without a unit does to a temperature in °C is in kelvin, and may be less than nothing."""

    warm = Output(unit="°C", noise=0.1, span=(-20.0, 150.0))
    heater = Drive(unit="", limits=(0.0, 1.0), noise=0.01)
    inner = State(unit="°C", span=(-20.0, 150.0))
    gain = Parameter(unit="K", default=62.0, bounds=(-90.0, 90.0), relative=False)
    room = Parameter(unit="K", default=296.0, bounds=(263.0, 323.0), relative=False)
    structures = {"all": Structure(free=("gain", "room"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        steady = self.room - 273.15 + self.gain * self.heater
        return Equations(
            rates={self.inner: (steady - self.inner) / 60.0},
            output=self.inner,
            start={self.inner: self.warm},
        )


def test_a_rise_in_kelvin_is_not_shown_as_a_temperature() -> None:
    """62 K was shown as -211.1 °C."""
    gain = parameter_format(OnOff, "gain")
    assert (gain.unit, gain.text(62.0)) == ("K", "62.0")
    room = parameter_format(OnOff, "room")
    assert (room.unit, room.shown(296.0)) == ("°C", pytest.approx(22.85))


def test_another_plant_is_shown_as_it_declares_itself() -> None:
    inertia = parameter_format(Motor, "j")
    friction = parameter_format(Motor, "b")
    assert (inertia.text(4e-4), inertia.unit) == ("0.000400", "kg m²"), (
        "kilograms take no prefix"
    )
    assert (friction.symbol, friction.words) == ("b", "viscous friction")
    assert parameter_format(Motor, "omega").unit == "rad/s"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.005, "1.00"),
        (-2.5, "−2.50"),
        (-0.001, "0.00"),
        (math.nan, "–"),
        (None, "–"),
        (math.inf, "∞"),
    ],
)
def test_numbers_read_well(value: float | None, text: str) -> None:
    assert number(value) == text


def criteria(gain: int, loss: float) -> Criteria:
    return Criteria(
        1000, 1000 - gain, gain, gain / 1000, math.log(loss), 100 * math.log(loss), loss
    )


def test_the_best_is_the_largest_gain_and_the_smallest_of_the_others() -> None:
    scores = [("22221", 500, 1.0), ("33331", 600, 2.0), ("44441", 600, 0.5)]
    orders = tuple(
        OrderScore(
            name, criteria(gain, loss), criteria(gain, loss), criteria(gain, loss)
        )
        for name, gain, loss in scores
    )
    candidate = CandidateScore(
        "c", 50.0, rig(), 0, 99, orders, "33331", 0.0, None, None
    )
    rows = criterion_rows(candidate)
    assert [(r.output, r.order) for r in rows[:3]] == [
        ("y", "22221"),
        ("y", "33331"),
        ("y", "44441"),
    ]
    assert [r.chosen for r in rows[:3]] == [False, True, False]

    def is_best(column: int) -> list[bool]:
        return [row.cells[column].best for row in rows[:3]]

    assert is_best(0) == is_best(1) == [False] * 3
    assert is_best(2) == is_best(3) == [False, True, True]
    assert is_best(4) == is_best(5) == is_best(6) == [False, False, True]


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40), st.integers(1, 12))
def test_the_rolling_rms_is_that_of_the_newest_values(
    values: list[float], count: int
) -> None:
    table = np.array(values)
    expected = [
        math.sqrt(np.mean(table[max(0, k + 1 - count) : k + 1] ** 2))
        for k in range(table.size)
    ]
    np.testing.assert_allclose(
        rolling_rms(table, count), expected, rtol=1e-6, atol=1e-4
    )


def test_the_right_twin_leaves_nothing_and_gaps_are_stepped_over() -> None:
    plant = rig(seebeck=0.06, conductance=0.5, heat_capacity=27.0)
    reference = np.repeat([30.0, 60.0], 150)
    window = run(plant, reference)
    table = enumerate(zip(reference, window.output, window.input, strict=True))
    samples = [
        Sample(k, k * 10**9, float(r), float(y), float(u)) for k, (r, y, u) in table
    ]
    settings = TwinSettings()
    filled = filled_stretches(
        samples[:100] + samples[106:108] + samples[114:], settings
    )
    parts = compare(filled, plant, settings)
    assert [len(p.window) for p in parts] == [100, 186]
    for part in parts:
        np.testing.assert_allclose(part.closed_residual_y, 0, atol=1e-6)
        np.testing.assert_allclose(part.closed_residual_u, 0, atol=1e-3)
        np.testing.assert_allclose(part.driven_residual_y, 0, atol=1e-6)
    [part] = compare(
        filled_stretches(samples[:50] + samples[52:], settings), plant, settings
    )
    assert part.time.size == 298
    assert (
        part.received.size
        == part.closed_residual_y.size
        == part.driven_residual_y.size
        == 296
    )
    # Two inputs that were computed for interpolated readings are wrong by a part of their own change.
    np.testing.assert_allclose(part.driven_residual_y, 0, atol=0.02)


# Machado et al. (2009), severity 1: how linear RGB looks to somebody without one kind of cone
DEFICIENCIES = {
    "protan": "0.152286 1.052583 -0.204868 0.114503 0.786281 0.099216 -0.003882 -0.048116 1.051998",
    "deutan": "0.367322 0.860646 -0.227968 0.280085 0.672501 0.047413 -0.011820 0.042940 0.968881",
    "tritan": "1.255528 -0.076749 -0.178779 -0.078411 0.930809 0.147602 0.004733 0.691367 0.303900",
    "none": "1 0 0 0 1 0 0 0 1",
}


def lab(rgb: np.ndarray) -> np.ndarray:
    xyz = (
        np.array(
            [
                [0.4124, 0.3576, 0.1805],
                [0.2126, 0.7152, 0.0722],
                [0.0193, 0.1192, 0.9505],
            ]
        )
        @ rgb
    )
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(
        t > (6 / 29) ** 3, np.cbrt(np.maximum(t, 0)), t / (3 * (6 / 29) ** 2) + 4 / 29
    )
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
@pytest.mark.parametrize(
    "colours",
    [(PLANT, CLOSED, DRIVEN, SET_POINT), tuple(LEVELS.values()), ORDERS],
    ids=["signals", "levels", "orders"],
)
def test_colours_that_stand_side_by_side_are_distinguished(
    colours: tuple[str, ...], deficiency: str
) -> None:
    """A difference of 10 in CIELAB is plain to see; 2 is just noticeable."""
    change = np.array(DEFICIENCIES[deficiency].split(), dtype=float).reshape(3, 3)
    as_perceived = [lab(np.clip(change @ linear(c), 0, 1)) for c in colours]
    for k, colour in enumerate(as_perceived):
        for later_colour in as_perceived[k + 1 :]:
            assert np.linalg.norm(colour - later_colour) > 10


def test_text_is_dark_on_white() -> None:
    assert contrast(TEXT, "#FFFFFF") > 7


# The candidates with their windows and models.


GIVEN = Candidate(
    "from the paper",
    90.0,
    rig(seebeck=0.0295, conductance=0.38, heat_capacity=13.7),
    None,
)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    reference = np.repeat([30.0, 60.0], [60, 250])
    return samples_of(
        run(rig(seebeck=0.06, conductance=0.5, heat_capacity=27.0), reference, seed=11)
    )


Judged = tuple[list[MatchReport], list[Verdict]]


@pytest.fixture(scope="module")
def judgement(samples: list[Sample]) -> Judgement:
    return judge_samples("s", samples, TwinSettings(), initial_candidates=[GIVEN])


@pytest.fixture(scope="module")
def judged(judgement: Judgement) -> Judged:
    return list(judgement.matches), list(judgement.verdicts)


@pytest.fixture(scope="module")
def members(samples: list[Sample], judged: Judged) -> tuple[Member, ...]:
    matches, verdicts = judged
    return family(samples, matches, verdicts[-1], TwinSettings())


def test_matched_and_given_candidates_have_their_window_and_their_own_models(
    members: tuple[Member, ...], judged: Judged
) -> None:
    """The models that are found again explain the measured window exactly as the verdict says."""
    assert [m.score.name for m in members] == ["60 °C", "from the paper"]
    assert [m.match is not None for m in members] == [True, False]
    assert sum(m.nominal for m in members) == 1
    for member in members:
        assert (member.window.first, member.window.last) == judged[0][0].match.samples
        scores = [
            score(model, member.measured, 2, absolute=Peltier.output.absolute)
            for model in member.models
        ]
        assert [s.total.gain for s in scores] == [
            o.total.gain for o in member.score.orders
        ]
        assert [s.u.bic for s in scores] == [o.u.bic for o in member.score.orders]


def test_the_models_of_the_discriminator_are_those_that_are_found_again(
    members: tuple[Member, ...], judgement: Judgement, judged: Judged
) -> None:
    matches, verdicts = judged
    handed_over = family(
        judgement.samples, matches, verdicts[-1], TwinSettings(), judgement.models
    )
    for member, again in zip(handed_over, members, strict=True):
        assert member.known_models
        assert not again.known_models
        for model, model_again in zip(member.models, again.models, strict=True):
            assert model.order == model_again.order
            for name in "BCDF":
                for output in ("y", "u"):
                    coefficients = getattr(getattr(model, output), name)
                    expected = getattr(getattr(model_again, output), name)
                    assert coefficients.tobytes() == expected.tobytes()
        order = member.score.chosen_order
        simulated = member.simulated(order)
        assert simulated.outputs.tobytes() == again.simulated(order).outputs.tobytes()


def test_matches_go_into_the_json_with_what_is_known_of_them(
    judged: Judged, samples: list[Sample]
) -> None:
    matches, verdicts = judged
    summary = summarise(stretches(samples, 1.0), verdicts, TwinSettings().law)
    entry = json.loads(
        json.dumps(document("s", verdicts, summary, matches), allow_nan=False)
    )
    (match,) = entry["matches"]
    assert match["status"] == "accepted"
    assert match["free"] == ["seebeck", "conductance", "heat_capacity"]
    for name, (low, high) in zip(match["free"], match["intervals"], strict=True):
        value = match["parameters"][name]
        assert low is None or low <= value
        assert high is None or value <= high
    assert entry["summary"]["sentence"] == sentence(summary)


def test_the_simulated_model_is_the_one_of_the_gain(
    members: tuple[Member, ...],
) -> None:
    """Its first samples are the measured ones, which the gain's table copies."""
    member = members[0]
    answer = member.simulated("33331")
    assert answer.output.shape == answer.input.shape == (len(member.window) - 2,)
    np.testing.assert_allclose(answer.output[:4], member.measured.output[:4])
    assert np.sqrt(np.mean((answer.output - member.measured.output) ** 2)) < 1.0


def test_a_candidate_from_before_the_recording_is_left_out(
    samples: list[Sample], judged: Judged
) -> None:
    matches, verdicts = judged
    assert family(samples[100:], matches, verdicts[-1], TwinSettings()) == ()
    assert family(samples, matches, None, TwinSettings()) == ()


def test_the_family_is_drawn(members: tuple[Member, ...], judged: Judged) -> None:
    verdict = judged[1][-1]
    drawn = (
        draw_responses(members),
        draw_uncertainty(members),
        draw_criteria(verdict),
        draw_matrix(verdict),
    )
    for figure in drawn:
        assert png(figure, 50).startswith(b"\x89PNG")


# A forecast among the samples, and what is said of it.


def forecast(
    output: Sequence[float],
    reference: Sequence[float],
    *,
    sample: int = 10,
    half: float = 0.5,
) -> Forecast:
    mean = np.array(output, dtype=np.float64)
    size = len(output)
    entry = np.linspace(-200.0, 100.0, size)
    return Forecast(
        sample=sample,
        candidate="70 °C",
        structure="no sink",
        confidence=0.9,
        time=np.arange(1.0, size + 1),
        references=np.array(reference, dtype=np.float64),
        outputs=(Band(mean, mean - half, mean + half),),
        inputs=(
            Band(entry, np.maximum(entry - 10, -255), np.minimum(entry + 10, 255)),
        ),
    )


def recorded(reference: Sequence[float], *, missing: int | None = None) -> list[Sample]:
    """Samples 0 and on; the output is 50 °C and a tenth of the index."""
    without_gap = [
        Sample(k, k * 10**9, r, 50 + 0.1 * k, 5.0 * k) for k, r in enumerate(reference)
    ]
    return [s for s in without_gap if s.index != missing]


def around(*, reference: Sequence[float], missing: int | None = None) -> Fan:
    """A forecast of ten samples made at sample 10, a session of which has these set-points."""
    made_forecast = forecast((50 + 0.1 * np.arange(11, 21)).tolist(), [60.0] * 10)
    return fan(made_forecast, stretches(recorded(reference, missing=missing), 1.0))


def test_it_is_compared_with_the_measurements() -> None:
    compared = around(reference=[60.0] * 40)
    assert (compared.past.last, compared.measured.first, compared.measured.last) == (
        10,
        11,
        20,
    )  # type: ignore[union-attr]
    np.testing.assert_allclose(compared.error, 0, atol=1e-12)
    y, u = compared.in_band
    assert y.tolist() == [1.0] * 10
    assert u.tolist() == [
        float(abs(5 * k - (-200 + 300 * (k - 11) / 9)) <= 10) for k in range(11, 21)
    ]


@given(st.integers(11, 25), st.integers(11, 25), st.integers(11, 30))
def test_it_is_so_up_to_another_set_point_a_missing_sample_or_the_end(
    step: int, gone: int, end: int
) -> None:
    reference = [60.0 if k < step else 70.0 for k in range(end)]
    compared = around(reference=reference, missing=gone)
    assert compared.judged == max(0, min(step, gone, end, 21) - 11)
    assert (
        compared.error.size
        == compared.in_band[0].size
        == compared.in_band[1].size
        == compared.judged
    )


def test_of_several_inputs_any_that_moves_makes_a_forecast_hard() -> None:
    """Of ten forecasts of the first output, whose own input rests but for one small step, six are shown."""
    inputs = np.full((200, 2), 30.0)
    inputs[30, 0] = 32.0
    for k in (4, 5, 6, 8, 9):
        inputs[20 * k + 10, 1] = 60.0
    window = Window(np.zeros((200, 2)), np.full((200, 2), 40.0), inputs)
    forecasts = [
        forecast([40.0] * 10, [math.nan] * 10, sample=20 * k + 5) for k in range(10)
    ]
    assert not any(made.closed for made in forecasts)
    hardest = hardest_forecasts(forecasts, [window], TCLabBoth)
    assert [made.sample for made in hardest] == [25, 85, 105, 125, 165, 185]


def test_nothing_recorded_behind_it_is_nothing_to_say_and_what_was_known_ends_at_a_gap() -> (
    None
):
    unmeasured = around(reference=[60.0] * 11)
    assert unmeasured.measured is None
    assert comparison_words(unmeasured, Peltier) == []
    assert draw_forecasts([unmeasured], Peltier).axes
    assert around(reference=[60.0] * 30, missing=8).past.first == 9


def test_of_several_outputs_each_is_compared_while_all_inputs_are_as_assumed() -> None:
    """The second heater moves at sample 15: what both temperatures do from then on was not forecast."""
    ten = np.arange(1.0, 11.0)

    def flat(level: float) -> Band:
        return Band(
            np.full(10, level), np.full(10, level - 1.0), np.full(10, level + 1.0)
        )

    made_forecast = Forecast(
        sample=10,
        candidate="both",
        structure="lumped",
        confidence=0.9,
        time=ten,
        references=np.full((10, 2), np.nan),
        outputs=(flat(50.0), flat(40.0)),
        inputs=(flat(30.0), flat(20.0)),
    )
    samples = [
        Sample(k, k * 10**9, (0.0, 0.0), (50.5, 43.0), (30.0, 20.0 if k < 15 else 60.0))
        for k in range(30)
    ]
    compared = fan(made_forecast, stretches(samples, 1.0))
    assert compared.judged == compared.alone(0).judged == 4
    assert compared.alone(0).error.tolist() == [0.5] * 4
    assert compared.alone(1).in_band[0].tolist() == [0.0] * 4
    settings = TwinSettings.of(TCLabBoth, law=None)
    ends = [
        line for line in forecast_words(made_forecast, settings) if "after 10 s" in line
    ]
    assert [line.split(" after")[0] for line in ends] == [
        "temperature T1",
        "temperature T2",
    ]
    first, second = comparison_words(compared, TCLabBoth)
    assert "100 % of the temperature T1" in first
    assert "0 % of the temperature T2" in second
    document_of_both = forecast_document(made_forecast, TCLabBoth)
    assert [band["mean"][0] for band in document_of_both["y"]] == [50.0, 40.0]
    assert [band["mean"][0] for band in document_of_both["u"]] == [30.0, 20.0]
    assert document_of_both["reference"] is None


def words(output: Sequence[float], reference: Sequence[float]) -> str:
    return "\n".join(forecast_words(forecast(output, reference), TwinSettings()))


def test_each_set_point_ahead_has_its_answer() -> None:
    rise = [51.0 + k for k in range(20)]
    answer = words(rise, [60.0] * 15 + [90.0] * 5)
    # Within 1 °C by the mean at 59 °C, by the band's edges 0.5 °C before and after.
    arrival = "first after 9 s (9 to 10), but it does not stay there"
    assert f"within 1 °C of 60 °C (set-point from 1 to 15 s): {arrival}" in answer
    assert (
        "within 1 °C of 90 °C (set-point from 16 to 20 s): not in that time" in answer
    )
    assert (
        "temperature after 20 s: 70.0 °C, within 69.5 to 70.5 °C in 90 % of such cases"
        in answer
    )
    assert "width of the band: 1.0 °C and 20 PWM at 10 s" in answer
    assert "largest control: 200 PWM after 1 s (190 to 210)" in answer


def test_what_is_there_already_is_not_reached_and_of_a_ramp_only_the_end_is_reported() -> (
    None
):
    assert "within 1 °C of 60 °C: all the time" in words([60.0] * 12, [60.0] * 12)
    answer = words(np.linspace(50, 70, 20).tolist(), np.linspace(50, 70, 20).tolist())
    assert answer.count("within 1 °C of") == 1
    assert "within 1 °C of 70 °C" in answer


def test_the_picture_has_three_panels_for_each_and_explains_every_line_once() -> None:
    figure = draw_forecasts([around(reference=[60.0] * 40)] * 4, Peltier)
    assert len(figure.axes) == 12
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    lines = (
        "set-point",
        "90 % band",
        "measured before",
        "measured afterwards",
        "forecast",
    )
    assert sorted(legend) == sorted(lines)
    assert (
        draw_forecasts([], Peltier).axes[0].texts[0].get_text()
        == "no forecast was made"
    )
