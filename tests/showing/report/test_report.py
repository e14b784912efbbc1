"""The report as a document: whole, self-contained, and with the figures of the verdict in it."""

from __future__ import annotations

import base64
import csv
import hashlib
import re
import xml.etree.ElementTree as ET
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest

from tests.support.places import SHIPPED
from tests.support.rig import rig, run
from twinmatch.comparing import ADMITTED
from twinmatch.errors import TwinmatchError
from twinmatch.importing import read_recording
from twinmatch.offline.backtest.scoring import LEADER, TWINS
from twinmatch.plants import Peltier
from twinmatch.sessions import SessionWriter, samples_of, write_session
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE
from twinmatch.showing.figures.drawing import svg
from twinmatch.showing.forecasts import backtest_words, card_columns
from twinmatch.showing.quantities import number
from twinmatch.showing.report.pictures import write_pictures
from twinmatch.showing.report.report import (
    SessionReport,
    judge_for_report,
    make_report,
    provenance,
    settings_of,
)
from twinmatch.showing.summary import sentence
from twinmatch.signals import Window
from twinmatch.twin import TwinSettings

from .conftest import Element, grid, parse, tables_of

LOADS = {
    "src",
    "href",
    "srcset",
    "data",
    "poster",
    "action",
    "background",
    "xlink:href",
}


@pytest.fixture(scope="session")
def page(shipped_page: str) -> Element:
    return parse(shipped_page)


def test_the_document_is_html_and_says_what_it_is(
    page: Element, shipped_page: str
) -> None:
    assert shipped_page.lstrip().startswith("<!DOCTYPE html>")
    assert next(page.all("html")).attributes["lang"] == "en"
    assert next(page.all("title")).text == "twinmatch report: four_setpoints"
    assert next(page.all("h1")).text.endswith("four_setpoints")
    ids = re.findall(r'\bid="([^"]+)"', shipped_page)
    assert len(ids) == len(set(ids))
    for link in page.all("a"):
        assert link.attributes["href"].removeprefix("#") in ids


def test_nothing_is_loaded_and_no_script_is_needed(
    page: Element, shipped_page: str
) -> None:
    assert not list(page.all("script"))
    assert not list(page.all("link"))
    assert not list(page.all("iframe"))
    elements = [
        page,
        *(
            e
            for tag in ("img", "a", "svg", "use", "style", "meta")
            for e in page.all(tag)
        ),
    ]
    for element in elements:
        for name, value in element.attributes.items():
            assert not name.startswith("on")
            if name in LOADS:
                assert value.startswith(("data:", "#")), (
                    f"<{element.tag} {name}={value[:60]}>"
                )
    style = next(page.all("style")).text
    assert "@import" not in style
    assert "url(" not in style
    assert "http" not in re.sub(r"data:[^\"]*", "", shipped_page)


def test_it_is_made_for_printing(page: Element) -> None:
    style = next(page.all("style")).text
    assert "@page" in style
    assert "@media print" in style


def test_every_picture_is_there_with_words_for_those_who_cannot_see_it(
    page: Element,
) -> None:
    images = list(page.all("img"))
    assert len(images) == 9
    for image in images:
        head, data = image.attributes["src"].split(",", 1)
        assert head == "data:image/svg+xml;base64"
        svg = base64.b64decode(data)
        assert ET.fromstring(svg).tag.endswith("svg")
        assert not re.search(rb"<script|(href|src)=\"http", svg)
        assert (b"<image" in svg) is image.attributes["alt"].startswith(
            "Shaded matrix"
        ), "the others are drawings"
        assert len(image.attributes["alt"]) > 60
    assert (
        "trusted"
        in next(
            i for i in images if "Trust over time" in i.attributes["alt"]
        ).attributes["alt"]
    )


def test_the_sentence_and_the_level_head_the_report(
    page: Element, shipped: SessionReport
) -> None:
    header = next(page.all("header")).text
    assert sentence(shipped.judged.judgement.summary) in header
    assert "trusted" in header


def test_criterion_tables_hold_the_verdict_and_the_best_is_bold(
    page: Element, shipped: SessionReport
) -> None:
    verdict = shipped.judged.judgement.verdicts[-1]
    tables = tables_of(page)
    decimals = {"gain": 0, "explanation": 3, "naic": 3, "bic": 1, "mdl": 4}
    for candidate in verdict.modelled:
        mark = ", nominal" if candidate.name == verdict.nominal else ""
        table = tables[
            f"Candidate {candidate.name}{mark}: order {candidate.chosen_order} chosen"
        ]
        names = [h.text.split(" / ")[0] for h in next(table.all("thead")).all("th")]
        rows = grid(table)
        assert len(rows) == 12
        for block, output in enumerate(("y", "u", "total")):
            part = rows[4 * block : 4 * block + 4]
            assert [r[1].text for r in part] == [o.order for o in candidate.orders]
            for row, order in zip(part, candidate.orders, strict=True):
                criteria = getattr(order, output)
                assert row[names.index("l(t)")].text == str(criteria.trivial_length)
                assert row[names.index("l(p)")].text == str(criteria.model_length)
            for attribute, places in decimals.items():
                name = {"gain": "gain", "explanation": "explained", "naic": "nAIC"}.get(
                    attribute, attribute.upper()
                )
                values = [
                    float(getattr(getattr(o, output), attribute))
                    for o in candidate.orders
                ]
                best = (
                    max(values) if attribute in {"gain", "explanation"} else min(values)
                )
                for row, value in zip(part, values, strict=True):
                    cell = row[names.index(name)]
                    assert cell.text == number(value, places)
                    assert ("best" in cell.classes) is (value == best)


def texts_of(row: list[Element]) -> list[str]:
    return [cell.text for cell in row]


def test_forecasts_stand_beside_the_measurements_and_the_peers(
    page: Element, shipped: SessionReport
) -> None:
    tested = shipped.judged.tested
    tables = tables_of(page)
    for horizon in tested.horizons:
        cards = [card for card in tested.cards if card.horizon == horizon]
        rows = grid(tables[f"{horizon:g} s ahead, {cards[0].count} forecasts"])
        for row, card in zip(rows, cards, strict=True):
            assert texts_of(row) == [text(card) for _, text in card_columns(Peltier)]
        best = [row[0].text for row in rows if "best" in row[1].classes]
        asked = [c for c in cards if c.who == LEADER or c.who not in TWINS]
        least = min(card.median for card in asked)
        assert best == [card.who for card in asked if card.median == least]
    for line in backtest_words(tested):
        assert line in page.text


def test_its_forecasts_stand_beside_the_measurements(
    page: Element, shipped: SessionReport
) -> None:
    samples = {s.index: s for s in shipped.judged.judgement.samples}
    shown = {f.sample: f for f in shipped.judged.tested.shown}
    rows = grid(tables_of(page)["Forecasts of the leader, and the measurements"])
    assert len(rows) == min(6, len(shown))
    for row in rows:
        forecast = shown[int(row[0].text)]  # one sample a second
        last = samples[forecast.sample + forecast.time.size]
        levels = [float(level) for level in row[2].text.split(" → ")]
        assert row[1].text == forecast.candidate
        assert (levels[0], levels[-1]) == (
            samples[forecast.sample + 1].reference,
            last.reference,
        )
        assert row[4].text == f"{last.output:.1f}"
        came = np.array(
            [samples[forecast.sample + 1 + k].output for k in range(forecast.time.size)]
        )
        assert float(row[5].text) == pytest.approx(
            np.sqrt(np.mean((came - forecast.output.mean) ** 2)), abs=5.1e-3
        )
        is_in_band = (forecast.output.low <= came) & (came <= forecast.output.high)
        assert row[6].text == f"{100 * is_in_band.mean():.0f} %"
    assert "leader_forecasts" in shipped.pictures


def test_gaps_of_plants_and_of_identified_models_have_a_table_each(
    page: Element, shipped: SessionReport
) -> None:
    verdict = shipped.judged.judgement.verdicts[-1]
    sums = [c.nu_gap_sum for c in verdict.candidates]
    identified = [
        c.identified_gap_sum
        for c in verdict.candidates
        if np.isfinite(c.identified_gap_sum)
    ]
    for between, gaps, expected_sums in (
        ("plants", verdict.nu_gap, sums),
        (f"models of order {verdict.order}", verdict.identified_gap, identified),
    ):
        rows = grid(tables_of(page)[f"ν-gap between the {between}"])
        count = len(gaps)
        shown = np.array([texts_of(row[1 : count + 2]) for row in rows], dtype=float)
        np.testing.assert_allclose(
            shown, np.column_stack([gaps, expected_sums]), atol=5.1e-4
        )
        bold = [k for k, row in enumerate(rows) if "best" in row[count + 1].classes]
        assert bold == [int(np.argmin(expected_sums))]


def test_nominal_parameters_have_units_errors_and_intervals(
    page: Element, shipped: SessionReport
) -> None:
    nominal = shipped.nominal
    assert nominal is not None
    assert nominal.match is not None
    table = tables_of(page)[f"Parameters of the nominal twin, {nominal.score.name}"]
    rows = {row[0].text: texts_of(row) for row in grid(table)}
    p = nominal.score.parameters
    assert rows["α"][2:4] == [f"{1000 * p['seebeck']:.1f}", "mV/K"]
    assert rows["R"][2:4] == ["3.30", "Ω"]
    assert rows["K"][2:4] == [f"{p['conductance']:.3f}", "W/K"]
    assert rows["C"][2:4] == [f"{p['heat_capacity']:.1f}", "J/K"]
    error = nominal.match.standard_errors[nominal.match.free.index("heat_capacity")]
    assert float(rows["C"][4]) == pytest.approx(error, abs=0.006)
    low, high = (float(v) for v in rows["C"][5].split(" to "))
    assert low < p["heat_capacity"] < high
    assert rows["R"][4:6] == ["–", "–"]


def test_coefficients_are_those_of_the_models_that_were_scored(
    page: Element, shipped: SessionReport
) -> None:
    """What the table prints, run as a difference equation, explains the data as the verdict says."""
    from twinmatch.comparing import score

    nominal = shipped.nominal
    assert nominal is not None
    scored = tuple(
        score(m, nominal.measured, 2, absolute=Peltier.output.absolute)
        for m in nominal.models
    )
    assert [s.total.gain for s in scored] == [
        o.total.gain for o in nominal.score.orders
    ]
    rows = grid(
        tables_of(page)[
            f"Box–Jenkins models of candidate {nominal.score.name}, nominal"
        ]
    )
    assert [(r[0].text, r[1].text) for r in rows] == [
        (output, polynomial)
        for output in ("output y/r", "control u/r")
        for polynomial in "BCDF"
    ]
    for k, model in enumerate(nominal.models):
        for j, row in enumerate(rows):
            printed = [float(v.replace("−", "-")) for v in row[2 + k].text.split()]
            values = getattr((model.y, model.u)[j // 4], "BCDF"[j % 4])
            np.testing.assert_allclose(printed, values, rtol=1e-5, atol=1e-12)


def test_the_files_of_the_session_are_named_with_their_hashes(page: Element) -> None:
    rows = {r[0].text: r for r in grid(tables_of(page)["Files of the session"])}
    assert set(rows) == {f.name for f in SHIPPED.iterdir()}
    for name, row in rows.items():
        data = (SHIPPED / name).read_bytes()
        assert row[1].text == str(len(data))
        assert row[2].text == hashlib.sha256(data).hexdigest()


def test_the_report_says_how_it_was_made(page: Element) -> None:
    rows = {
        r[0].text: r[1].text for r in grid(tables_of(page)["How the report was made"])
    }
    assert rows["command"] == "twinmatch report bags/four_setpoints"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d[+-]\d\d:\d\d", rows["made"])
    assert rows["numpy"] == np.__version__
    assert {"twinmatch", "Python", "scipy", "numba"} <= set(rows)
    parameters = next(
        t for c, t in tables_of(page).items() if c.startswith("All parameters")
    )
    shown = {r[0].text: r[1].text for r in grid(parameters)}
    assert shown["schedule.stride"] == "60"
    assert shown["pid.proportional"] == "38.57"
    assert shown["limits.doubtful"] == "2"


def test_a_parameter_that_is_not_the_default_is_marked() -> None:
    changed = [s.name for s in settings_of(TwinSettings(decimals=3)) if s.changed]
    assert changed == ["decimals"]


def test_a_library_without_metadata_has_no_known_version(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It may be used from a folder; the report is made all the same."""
    monkeypatch.setattr(
        "twinmatch.showing.report.report._LIBRARIES", ("numpy", "no-such-library")
    )
    versions = dict(
        provenance(SHIPPED, TwinSettings(), "", datetime.now(timezone.utc)).versions
    )
    assert (versions["numpy"], versions["no-such-library"]) == (
        np.__version__,
        "version unknown",
    )


def test_figures_are_written_as_pictures_too(
    shipped: SessionReport, tmp_path: Path
) -> None:
    [path] = write_pictures(
        {"nu_gap": shipped.pictures["nu_gap"]}, tmp_path / "figures", "png"
    )
    assert path.name == "nu_gap.png"
    assert path.read_bytes().startswith(b"\x89PNG")


# Sessions out of the ordinary


def simulated(reference: np.ndarray, **changes: float) -> Window:
    return run(
        rig(seebeck=0.06, conductance=0.5, heat_capacity=27.0).replace(**changes),
        reference,
        seed=5,
    )


@pytest.mark.parametrize(
    "reference",
    [np.full(200, 40.0), np.repeat([30.0, 50.0], 45)],
    ids=["no step", "too short"],
)
def test_a_session_without_a_verdict_says_so(
    reference: np.ndarray, tmp_path: Path
) -> None:
    session = write_session(tmp_path / "short", samples_of(simulated(reference)))
    report = make_report(session)
    document = parse(report.html())
    assert "There was no set-point step" in next(document.all("main")).text
    assert "No twin to trust yet" in next(document.all("header")).text
    assert "unknown" in next(document.all("header")).text
    assert set(report.pictures) == {"session", "health"}


def test_names_from_files_are_shown_and_not_run(tmp_path: Path) -> None:
    """A session of three samples, without a verdict, may be called anything; none of it becomes markup."""
    name = "a<script>alert(1)<"
    session = write_session(tmp_path / name, samples_of(simulated(np.full(3, 30.0))))
    text = make_report(session, command="x & y").html()
    document = parse(text)
    assert not list(document.all("script"))
    assert next(document.all("h1")).text.endswith(name)
    assert "x &amp; y" in text
    assert "There was no set-point step" in next(document.all("main")).text
    assert "No twin to trust yet" in next(document.all("header")).text


def test_a_session_with_gaps_and_matches_that_were_refused(tmp_path: Path) -> None:
    """Somebody warms and cools the plate by 2 °C: no parameters explain that, and no fault shows."""
    reference = np.repeat([30.0, 60.0], [60, 260])
    window = simulated(reference)
    temperature = window.output + 2.0 * np.sin(np.arange(reference.size) / 15.0)
    samples = samples_of(Window(reference, temperature, window.input))
    samples = samples[:20] + samples[30:]
    with SessionWriter(tmp_path / "odd") as writer:
        writer.add_topic(SAMPLE)
        for sample in samples:
            writer.write(SAMPLE.name, encode_sample(sample), sample.stamp)
    report = make_report(tmp_path / "odd")
    document = parse(report.html())
    matched_verdicts = [v for v in report.judged.judgement.verdicts if v.match]
    assert matched_verdicts
    assert not any(v.match == ADMITTED for v in matched_verdicts)
    assert "match refused" in tables_of(document)["What happened"].text
    assert f"of {len(matched_verdicts)} match" in next(document.all("main")).text
    assert "indices step from" in next(document.all("main")).text


def test_a_recording_as_csv_is_reported_like_a_session(tmp_path: Path) -> None:
    window = simulated(np.repeat([30.0, 50.0], [60, 250]))
    path = tmp_path / "bench.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "reference", "temperature", "pwm"])
        writer.writerows(
            zip(window.time, window.reference, window.output, window.input, strict=True)
        )
    judged = judge_for_report(path)
    assert judged.judgement.summary.nominal is not None
    assert "has no recorded verdicts" in judged.recorded
    origin = provenance(path, judged.judgement.settings, "", datetime.now(timezone.utc))
    assert [f.name for f in origin.files] == ["bench.csv"]


def test_a_faulty_plant_is_reported_as_one(
    recordings: dict[int, Path], tmp_path: Path
) -> None:
    """The rig lost its drive at sample 2239 of this hour: twins before it, refusals after it."""
    if 27 not in recordings:
        pytest.skip("recording 27 is not there")
    part = read_recording(recordings[27]).part(1750, 2500)
    report = make_report(write_session(tmp_path / "lost", samples_of(part)))
    document = parse(report.html())
    assert "fault" in next(document.all("header")).text
    words = next(document.all("ul")).text
    assert "Look at the plant" in words
    assert "refused" in tables_of(document)["What happened"].text


def test_the_same_session_gives_the_same_document(
    shipped: SessionReport, shipped_page: str
) -> None:
    assert shipped.html() == shipped_page
    for name in ("health", "parameters", "nu_gap"):
        assert svg(shipped.pictures[name].draw()) == shipped.pictures[name].svg


def test_what_cannot_be_written_is_one_message(
    shipped: SessionReport, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(TwinmatchError, match="cannot be written"):
        shipped.write(tmp_path / "no" / "report.html")
    with pytest.raises(TwinmatchError, match="cannot be created"):
        write_pictures(shipped.pictures, tmp_path / "file" / "figures", "png")
