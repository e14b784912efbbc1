"""The page of a plant with two loops in a real browser, beside real publishers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)
pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from tests.showing.page.test_page_in_browser import FITS, Graph
from tests.support.ros import listening
from twinmatch.health import EstimatedReading
from twinmatch.nodes.messages import message_of
from twinmatch.offline.judging import Judgement
from twinmatch.plants.tclab import TCLabBoth

pytestmark = pytest.mark.ros
PLACES = """
return ['output', 'output_2', 'control_2'].map((name) => {
    const view = Bokeh.index.get_one(Bokeh.documents[0].get_model_by_name(name));
    const r = view.el.getBoundingClientRect(); return [r.left, r.top + scrollY, r.width]; });
"""
LEGENDS = """
return ['output', 'output_2', 'control_2', 'residual', 'control_residual_2'].flatMap((name) => {
    const chart = Bokeh.documents[0].get_model_by_name(name);
    const legend = chart.above.find((part) => part.type == 'Legend');
    const box = Bokeh.index.find_one(legend).bbox;
    return box.left >= 0 && box.width <= chart.inner_width && box.height > 0 ? [] : [name] });
"""
"""The charts whose legend is cut, or reaches over the charts beside them."""


@pytest.mark.long("a page of two loops in a browser, at three widths")
def test_two_signals_are_side_by_side_and_what_one_should_read_is_said(
    page_process: Callable[..., Any], browser: Any, two: Judgement
) -> None:
    with listening() as listener:
        graph = Graph(listener.node)
        graph.describe(TCLabBoth)
        started = page_process("--control")
        for name in (
            "plant/description",
            "plant/sample",
            "twin/state",
            "twin/model_score",
            "plant/estimate",
        ):
            browser.wait_for(lambda name=name: graph.heard(name), f"a reader of {name}")
        browser.open(started.url)
        browser.wait_for(
            lambda: "temperature T2 / °C" in browser.text, "the plant's own words"
        )
        graph.session(two.samples[-200:], two)
        (course,) = two.estimates
        last = two.samples[-1]
        course_fields = {
            "since": course.first,
            "wide": course.wide,
            "good": course.good,
        }
        estimate = EstimatedReading(
            last.index, course.signal, 31.8, 0.4, 36.8, **course_fields
        )
        graph.publish("plant/estimate", message_of(estimate, last.stamp))
        sentence = "the twin reads through temperature T2: 31.8 ± 0.4 °C instead of 36.8, to ± 1.2 good for"
        browser.wait_for(lambda: sentence in browser.text, "what it should read")
        browser.wait_for(
            lambda: "sensor drift of temperature T2" in browser.text, "the fault"
        )
        browser.wait_for(
            lambda: browser.column("output_2", 0, "t")[-1:] == [last.index],
            "the last point",
        )
        assert browser.column("output_2", 0, "output_2")[-1] == last.outputs[1]
        first, second, below = browser.run(PLACES)
        assert first[1] == second[1]
        assert first[0] + first[2] <= second[0]
        assert second[0] == below[0]
        assert second[1] < below[1]
        browser.run("document.querySelector('details.reasons').open = true")
        browser.wait_for(
            lambda: "newest within band / %" in browser.text, "trust of each signal"
        )
        assert browser.run(FITS)
        # Set-points of two loops travel in one message of another type; two types would be one too many.
        assert graph.node.count_publishers("plant/reference") == 0
        for width, _ in browser.sized((390, 844), (1024, 768), (1280, 900)):
            browser.wait_for(lambda: browser.run(FITS), "a page that fits")
            browser.wait_for(lambda: browser.run(LEGENDS) == [], "legends that fit")
            if width < 1000:  # where there is no room, they are below one another
                first, second, _ = browser.run(PLACES)
                assert first[0] == second[0]
                assert first[1] < second[1]
        assert browser.warnings() == []
