"""The page in a real browser, beside real publishers, a real controller, PWM bridge and player."""

from __future__ import annotations

import itertools
import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here; make setup installs it")
pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)
pytest.importorskip(
    "bokeh", reason="bokeh is not installed; it is in the extra 'dashboard'"
)

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import Image, Temperature

from tests.support.processes import Process, Processes
from tests.support.ros import listening
from tests.support.waiting import wait_for
from twinmatch.comparing import ADMITTED
from twinmatch.dynamics import Plant
from twinmatch.nodes.entrance import LOOK
from twinmatch.nodes.messages import (
    description_message,
    message_of,
    sample_message,
    state_message,
)
from twinmatch.nodes.topics import LATCHED, RELIABLE
from twinmatch.offline.judging import Judgement
from twinmatch.plants import Peltier
from twinmatch.plants.records import description_of
from twinmatch.sessions import write_session
from twinmatch.signals import Sample
from twinmatch.twin import Mirror, TwinSettings
from twinmatch_msgs.msg import (
    EstimatedReading,
    LoopSample,
    ModelScore,
    PlantDescription,
    PwmApplied,
    TwinState,
)

pytestmark = pytest.mark.ros
of_the_page = pytest.mark.usefixtures("page")

FORECAST = 3
ANSWER = 6
"""Where the chart of the output draws what comes next, among its lines."""
MATCHED = 300
"""Sample of the quarter of an hour with its first match, and first verdict on a family."""
LEADS = 310
"""Samples of the quarter of an hour after which the first twin is matched, which leads then."""


FITS = (
    "const page = document.documentElement; return page.scrollWidth <= page.clientWidth"
)
ON_SCREEN = """
return deep(document).filter((e) => e.checkVisibility() && e.children.length == 0)
    .filter((e) => { const r = e.getBoundingClientRect(); return r.top >= 0 && r.bottom <= innerHeight })
    .map((e) => e.textContent).join(' ');
"""
CLICKABLE = """
return deep(document).filter((e) => ['BUTTON', 'SUMMARY'].includes(e.tagName) && e.checkVisibility())
    .filter((e) => !e.closest('.bk-toolbar')).map((e) => e.innerText.trim());
"""
FOCUSED = """
let e = document.activeElement;
while (e && e.shadowRoot && e.shadowRoot.activeElement) e = e.shadowRoot.activeElement;
return e ? (e.innerText || '').trim() : '';
"""
CHART = "const chart = Bokeh.documents[0].get_model_by_name(arguments[0]);"
PIXELS = (
    f"{CHART} return Bokeh.index.get_one(chart).canvas_view.primary.canvas.toDataURL()"
)
"""What is drawn of a chart, wherever the page is scrolled to."""
FAINT = """
const up = (e) => e.parentElement || (e.getRootNode().host ?? null);
const parts = (c) => (c.match(/[\\d.]+/g) || []).map(Number);
const light = (c) => { const [r, g, b] = c.slice(0, 3).map((v) => v / 255)
    .map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b };
const below = (e) => { for (; e; e = up(e)) { const c = parts(getComputedStyle(e).backgroundColor);
    if (c.length == 3 || c[3] > 0.9) return c } return [255, 255, 255] };
return deep(document).filter((e) => e.checkVisibility())
    .filter((e) => !['SCRIPT', 'STYLE'].includes(e.tagName))
    .filter((e) => [...e.childNodes].some((n) => n.nodeType == 3 && /[a-z0-9]/i.test(n.data)))
    .map((e) => { const [a, b] = [light(parts(getComputedStyle(e).color)), light(below(e))];
        return [(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), e.textContent.trim().slice(0, 40)] })
    .filter(([contrast]) => contrast < 4.5);
"""
"""Text with a contrast below 4.5 to what is behind it, as the WCAG reckon it."""


class Graph:
    """What the nodes of a rig publish, from this process."""

    def __init__(self, node: Node) -> None:
        self.node = node
        kinds = {
            "plant/sample": LoopSample,
            "twin/state": TwinState,
            "twin/model_score": ModelScore,
            "plant/pwm_applied": PwmApplied,
            "plant/estimate": EstimatedReading,
        }
        self._publishers = {
            name: self.node.create_publisher(kind, name, RELIABLE)
            for name, kind in kinds.items()
        }
        self._publishers["plant/description"] = self.node.create_publisher(
            PlantDescription, "plant/description", LATCHED
        )
        for name, kind in (
            ("thermal/image", Image),
            ("plant/temperature", Temperature),
        ):
            self._publishers[name] = self.node.create_publisher(
                kind, name, qos_profile_sensor_data
            )
        self._last = -1

    def publish(self, name: str, message: Any) -> None:
        self._publishers[name].publish(message)

    def heard(self, name: str) -> int:
        return int(self._publishers[name].get_subscription_count())

    def session(
        self,
        samples: list[Sample],
        judged: Judgement | None = None,
        rate: float = 400.0,
    ) -> None:
        """Samples with the twins' state at each, and what a judgement has to say at some.

        They are those of a graph that was started again, unless they follow the ones before. Whether it was is
        looked at so rarely that all of them could be over before a busy machine shows it: the first two wait.
        """
        is_another = samples[0].index <= self._last
        if is_another:
            self._replace("plant/sample", LoopSample)
        self._last = samples[-1].index
        settings = judged.settings if judged else TwinSettings()
        mirror = Mirror(settings.start, settings.law)
        for place, sample in enumerate(samples):
            self.publish("plant/sample", sample_message(sample))
            self.publish(
                "twin/state",
                state_message(mirror.push(sample), "", settings.plant.states),
            )
            for verdict in judged.verdicts if judged else ():
                if verdict.sample == sample.index:
                    self.publish("twin/model_score", message_of(verdict, sample.stamp))
            time.sleep(1.2 * LOOK if is_another and place < 2 else 1 / rate)

    def _replace(self, name: str, kind: Any) -> None:
        readers = self.heard(name)
        self.node.destroy_publisher(self._publishers[name])
        self._publishers[name] = self.node.create_publisher(kind, name, RELIABLE)
        wait_for(lambda: self.heard(name) == readers, f"the readers of {name}")

    def describe(self, plant: type[Plant]) -> None:
        self.publish(
            "plant/description", description_message(description_of(plant), 1.0)
        )

    def fault(self, text: str, stamp: int) -> None:
        applied = PwmApplied(pwm=0.0, current=0.1, fault=text)
        applied.header.stamp = Time(nanoseconds=stamp).to_msg()
        self.publish("plant/pwm_applied", applied)

    def image(self, pixels: Any) -> None:
        rows, columns = pixels.shape
        message = Image(height=rows, width=columns, encoding="32FC1", step=4 * columns)
        message.data = pixels.astype("<f4").tobytes()
        self.publish("thermal/image", message)


@pytest.fixture(scope="module")
def graph(ros: None) -> Iterator[Graph]:  # noqa: ARG001
    with listening() as listener:
        yield Graph(listener.node)


@pytest.fixture(scope="module")
def rig_page(commanding: Process, graph: Graph, browser: Any) -> Process:
    """The page that may command the rig, in the browser's tab."""
    browser.open(commanding.url)
    for name in ("plant/sample", "twin/state", "twin/model_score", "plant/pwm_applied"):
        browser.wait_for(lambda name=name: graph.heard(name), f"a reader of {name}")
    assert "°C" not in browser.text  # nobody has said what plant this is
    graph.describe(Peltier)
    browser.wait_for(
        lambda: browser.driver.title == "twinmatch: Peltier rig",
        "the page loaded again",
    )
    browser.wait_for(lambda: "set-point / °C" in browser.text, "the plant's own words")
    return commanding


@pytest.fixture(scope="module")
def page(
    rig_page: Process, page_process: Callable[..., Process], browser: Any
) -> Process:
    """A page that may command nothing, at the address of the one that could: its tab comes back."""
    address = rig_page.url
    assert rig_page.end() == 0
    browser.wait_for(lambda: "connection was lost" in browser.text, "a word of it")
    restarted = page_process("--port", address.rsplit(":", 1)[1].strip("/"))
    assert restarted.url == address
    browser.wait_for(lambda: "connection was lost" not in browser.text, "the page")
    browser.warnings()  # those of the lost connection
    return restarted


@pytest.fixture
def node(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """Start one of the project's nodes in its own process."""
    processes = Processes(tmp_path / "nodes")

    def start(name: str, *parameters: str) -> Process:
        words = [word for parameter in parameters for word in ("-p", parameter)]
        return processes.python("-m", "twinmatch.nodes", name, "--ros-args", *words)

    yield start
    processes.end()


def counted(number: int, period: float = 1.0, first: int = 0) -> list[Sample]:
    return [
        Sample(k, 10**18 + round(k * period * 1e9), 50.0, 40.0 + np.sin(k / 9), 20.0)
        for k in range(first, first + number)
    ]


@pytest.mark.usefixtures("rig_page")
def test_control_asks_the_controller_and_the_bridge(
    graph: Graph, browser: Any, node: Callable[..., Process]
) -> None:
    """A set-point entered on the page is the reference of the next sample of a real controller."""
    ending = threading.Event()

    def measure() -> None:
        while not ending.wait(0.1):
            message = Temperature(temperature=30.0)
            message.header.stamp = graph.node.get_clock().now().to_msg()
            graph.publish("plant/temperature", message)

    measuring = threading.Thread(target=measure)
    measuring.start()
    try:
        node("controller", "reference_source:=topic", "period:=0.2")
        node("pwm_bridge", "port:=/dev/no-such-board")
        browser.wait_for(lambda: browser.button("Output off"), "the buttons")

        def ask(value: str) -> None:
            entry = browser.run(
                "return deep(document).find((e) => e.tagName == 'INPUT' && e.checkVisibility())"
            )
            entry.clear()
            entry.send_keys(value, "\n")
            browser.click("Set")

        def asked(value: str, answer: str) -> bool:
            if answer in browser.text:
                return True
            ask(value)
            time.sleep(1.0)
            return False

        browser.wait_for(lambda: asked("42.5", "requested 42.5 °C"), "the answer")
        browser.wait_for(
            lambda: browser.column("output", 2, "reference")[-1:] == [42.5],
            "the set-point",
        )
        browser.wait_for(
            lambda: asked("180", "180 °C not set: the controller allows 0 to 100 °C"),
            "the refusal",
        )
        assert browser.column("output", 2, "reference")[-1] == 42.5

        def stopped() -> bool:
            if "stopped on request; call clear_fault to continue" in browser.text:
                return True
            # until the bridge has started, the page says that it is not there
            browser.click("Output off")
            time.sleep(1.0)
            return False

        browser.wait_for(stopped, "the fault")
        browser.click("Clear fault")
        browser.wait_for(
            lambda: "the PWM board is not connected" in browser.text, "the answer"
        )
        assert browser.warnings() == []
    finally:
        ending.set()
        measuring.join()


def test_an_open_tab_comes_back_with_the_server_and_waits(
    page: Any, graph: Graph, browser: Any
) -> None:
    """The server has started again, so it has nothing to show; all that it loads is of this machine."""
    browser.wait_for(
        lambda: "waiting for the first sample" in browser.text, "that it waits"
    )
    assert "unknown" in browser.text
    assert page.url.startswith("http://127.0.0.1:")
    assert "PAGE OPEN" not in page.text
    assert browser.elsewhere(page.url) == []
    assert browser.driver.title == "twinmatch: Peltier rig"

    coming = iter(counted(100_000))
    # Those before the server reads the topic again are lost.
    wait_for(
        lambda: re.search(r"sample \d+, \d+ s", browser.text),
        "samples",
        meanwhile=lambda: graph.session([next(coming)], rate=20.0),
    )
    assert browser.warnings() == []


@of_the_page
def test_data_move_as_they_come(graph: Graph, browser: Any) -> None:
    coming = iter(counted(100_000))
    sent: list[int] = []

    def publish() -> None:
        """Between two looks only: a browser that waits for the processor is not left ever further behind."""
        for sample in itertools.islice(coming, 10):
            graph.session([sample], rate=50.0)
            sent.append(sample.index)

    def shown() -> list[float]:
        return list(browser.column("output", 0, "t"))

    wait_for(lambda: len(shown()) > 20, "the first samples", meanwhile=publish)
    picture = browser.picture("output")
    before = shown()[-1]
    wait_for(lambda: shown()[-1] >= before + 50, "more samples", meanwhile=publish)
    assert browser.picture("output") != picture
    browser.wait_for(
        lambda: f"sample {sent[-1]}, {sent[-1]} s" in browser.text, "the last sample"
    )
    browser.wait_for(lambda: shown()[-1] == sent[-1], "the last point")
    last = sent[-1200:]  # twenty minutes
    assert shown() == last
    assert browser.column("output", 0, "output") == [40.0 + np.sin(k / 9) for k in last]
    browser.wait_for(
        lambda: browser.column("output", 1, "t")[-1] == sent[-1], "the twin's last"
    )
    assert browser.warnings() == []


@of_the_page
def test_a_chart_is_drawn_only_while_somebody_can_see_it(
    graph: Graph, browser: Any
) -> None:
    browser.run("scrollTo(0, 0)")
    browser.wait_for(
        lambda: browser.run(f"{CHART} return chart.hold_render", "control_residual"),
        "that it waits",
    )
    unseen = browser.run(PIXELS, "control_residual")
    graph.session(counted(30))
    browser.wait_for(
        lambda: browser.column("control_residual", 1, "t")[-1:] == [29.0], "the samples"
    )
    # the time of all follows this one
    assert not browser.run(f"{CHART} return chart.hold_render", "output")
    assert browser.run(PIXELS, "control_residual") == unseen
    browser.run(
        f"{CHART} Bokeh.index.get_one(chart).el.scrollIntoView()", "control_residual"
    )
    browser.wait_for(
        lambda: browser.run(PIXELS, "control_residual") != unseen, "the drawing"
    )
    browser.run("scrollTo(0, 0)")
    assert browser.warnings() == []


@of_the_page
def test_verdicts_family_and_events_are_shown(
    graph: Graph, browser: Any, judged: Judgement
) -> None:
    graph.session(list(judged.samples[MATCHED - 20 :]), judged)
    last = judged.verdicts[-1]
    assert last.nominal is not None
    browser.wait_for(
        lambda: f"sample {judged.samples[-1].index}" in browser.text, "the last sample"
    )
    browser.wait_for(
        lambda: last.level.value in browser.text and "nominal" in browser.text,
        "the verdict",
    )
    for candidate in last.candidates:
        assert f"{candidate.name}" in browser.text
    gaps = browser.column("matrix", 0, "gap")
    assert gaps == [gap for row in last.nu_gap for gap in row]
    assert browser.column("matrix", 2, "gap") == [c.nu_gap_sum for c in last.candidates]
    browser.run("document.querySelector('details.reasons').open = true")
    browser.wait_for(lambda: last.reason in browser.text, "why")
    accepted = sum(v.match == ADMITTED for v in judged.verdicts)
    assert browser.text.count("match admitted") >= accepted
    count = "return deep(document).filter((e) => e.tagName == 'TR').length"
    rows = browser.run(count)
    browser.click("all orders")
    rows_of_other_orders = sum(
        len(c.orders) - 1 for c in last.candidates if c.orders
    )  # structures are not identified
    browser.wait_for(
        lambda: browser.run(count) == rows + rows_of_other_orders,
        "a row for every order",
    )
    browser.click("all orders")
    assert browser.warnings() == []


@of_the_page
def test_every_width_shows_the_first_answers_and_needs_no_scrolling_sideways(
    browser: Any,
) -> None:
    """After the test above: there is a verdict, a family, and everything that belongs to it."""
    for size in browser.sized((1024, 900), (390, 844)):
        browser.wait_for(lambda: browser.run(FITS), "a page that fits")
        on_screen = browser.run(ON_SCREEN)
        for answer in (
            "leader, the twin",
            "plant health",
            "what to do",
            "closed-loop twin / °C",
        ):
            assert answer in on_screen, (answer, size)
        assert browser.run(FAINT) == [], size
        assert browser.warnings() == [], size


@of_the_page
def test_the_keys_reach_everything_that_can_be_clicked_and_help_is_one_of_it(
    browser: Any,
) -> None:
    from selenium.webdriver.common.keys import Keys

    browser.run("document.body.tabIndex = -1; document.body.focus()")
    wanted = set(browser.run(CLICKABLE))
    assert {"Help", "Ask", "all orders", "5 min"} <= wanted
    reached: set[str] = set()
    for _ in range(2 * len(wanted) + 30):
        browser.keys(Keys.TAB)
        focused = browser.run(FOCUSED)
        reached.add(focused)
        if focused == "Help" and "what it means, what to do" not in browser.text:
            browser.keys(Keys.ENTER)
    assert wanted <= reached, wanted - reached
    assert "No twin explains the plant's behaviour." in browser.text
    assert browser.run(FAINT) == []
    browser.run("document.getElementById('help').open = false")


@of_the_page
def test_what_comes_is_drawn_ahead_and_can_be_asked_for(
    graph: Graph, browser: Any, judged: Judgement, node: Callable[..., Process]
) -> None:
    """A real discriminator: its forecast ahead of the newest sample, its answer beside the question."""
    discriminator = node("discriminator")
    _ = node("matcher")
    browser.wait_for(lambda: graph.heard("plant/sample") == 2, "the discriminator")
    browser.wait_for(lambda: graph.node.count_publishers("twin/match"), "the matcher")
    coming = iter(judged.samples)
    sent = list(itertools.islice(coming, LEADS))
    graph.session(sent)

    def publish() -> None:
        """Until there is a leader: the matcher takes its time, on a busy machine more of it."""
        further_samples = list(itertools.islice(coming, 10))
        graph.session(further_samples, rate=50.0)
        sent.extend(further_samples)

    wait_for(
        lambda: browser.column("output", FORECAST, "t"), "a forecast", meanwhile=publish
    )
    last = float(sent[-1].index)
    browser.wait_for(
        lambda: browser.column("output", FORECAST, "t")[:1] == [last + 1.0],
        "the forecast",
    )
    assert browser.column("output", FORECAST, "t")[-1] == last + 300.0
    low, mean, high = (
        browser.column("control", 2, f"input{edge}") for edge in ("_low", "", "_high")
    )
    assert all(a <= b <= c for a, b, c in zip(low, mean, high, strict=True))
    assert "leader, the twin to ask what comes next" in browser.text
    ends = browser.run(
        "return Bokeh.documents[0].get_model_by_name('output').x_range.end"
    )
    assert ends == last + 300.0
    _ask(browser, "55.5", "120")
    browser.wait_for(
        lambda: "set-point 55.5 °C for 120 s" in browser.text, "the question"
    )
    browser.wait_for(lambda: "temperature after 300 s" in browser.text, "the answer")
    asked = browser.column("output", ANSWER, "reference")
    assert (asked[0], asked[118], asked[119]) == (55.5, 55.5, sent[-1].reference)
    _ask(browser, "400", "")
    browser.wait_for(
        lambda: "the set-point is 400 °C; give one from" in browser.text, "the refusal"
    )
    assert browser.column("output", ANSWER, "t") == []
    browser.click("5 min")
    browser.wait_for(
        lambda: browser.column("output", FORECAST, "t")[-1] <= last + 75.0, "less of it"
    )
    browser.click("20 min")
    assert discriminator.end() == 0

    def missed() -> bool:
        _ask(browser, "50", "")
        time.sleep(0.5)
        browser.wait_for(
            lambda: "waiting for the forecast" not in browser.text, "an answer"
        )
        return "the discriminator is not running" in browser.text

    browser.wait_for(missed, "a word of it")
    assert browser.warnings() == []


def _ask(browser: Any, level: str, hold: str) -> None:
    fields = browser.run(
        "return deep(document).filter((e) => e.tagName == 'INPUT' && e.checkVisibility())"
    )
    for field, value in zip(fields, (level, hold), strict=True):
        field.clear()
        field.send_keys(value, "\n")
    browser.click("Ask")


@of_the_page
def test_a_fault_is_shown_and_goes(graph: Graph, browser: Any) -> None:
    samples = counted(5)
    graph.session(samples)
    # A fault that is received before the session's first sample would be one of the session before.
    browser.wait_for(
        lambda: browser.column("output", 0, "t") == [0.0, 1.0, 2.0, 3.0, 4.0],
        "the samples",
    )
    # It is received last: its stamp alone says when it was.
    graph.fault(
        "over_temperature: 111.0 °C is above 110.0 °C <b>",
        samples[2].stamp + 500_000_000,
    )
    browser.wait_for(
        lambda: "Output held at zero: over temperature" in browser.text, "the alarm"
    )
    # as text, whatever it looks like
    assert "111.0 °C is above 110.0 °C <b>" in browser.text
    browser.wait_for(
        lambda: browser.column("happened", 1, "t") == [2.5], "its mark in the figure"
    )
    graph.fault("", samples[4].stamp)
    browser.wait_for(
        lambda: "Output held at zero: over temperature" not in browser.text,
        "the end of it",
    )
    browser.wait_for(lambda: "fault cleared" in browser.text, "a word of it")
    assert browser.warnings() == []


@of_the_page
def test_the_thermal_image_is_shown(graph: Graph, browser: Any) -> None:
    assert "Thermal image" not in browser.text  # most plants have none
    pixels = np.full((60, 80), 25.0)
    pixels[10:20, 30:50] = 71.25
    browser.wait_for(lambda: graph.heard("thermal/image"), "a reader")

    def shown() -> bool:
        graph.image(pixels)
        return "Thermal image / °C" in browser.text

    browser.wait_for(shown, "the image")
    # at once: the card is not shown before its image is there
    largest = browser.run(
        "return Bokeh.documents[0].get_model_by_name('thermal').renderers[0].data_source.data.image[0]"
        ".reduce((a, b) => Math.max(a, b))"
    )
    assert largest == 71.25
    assert browser.warnings() == []


@of_the_page
def test_it_survives_that_the_graph_is_started_again(
    graph: Graph, browser: Any
) -> None:
    graph.session(counted(50))
    browser.wait_for(
        lambda: "sample 49, 49 s" in browser.text, "the first session's last sample"
    )
    graph.session(counted(29, period=0.1))
    browser.wait_for(
        lambda: "sample 28, 2.8 s" in browser.text, "the second session's last sample"
    )
    # Twenty minutes at 10 Hz: ten samples are drawn as two points, their least and greatest.
    browser.wait_for(
        lambda: len(browser.column("output", 0, "t")) == 4, "its samples alone"
    )
    # Up to two samples are not believed, if the page learns of the new publisher before the old one's end.
    drawn = browser.column("output", 0, "t")
    assert drawn[0] <= 0.21
    assert [t - drawn[0] for t in drawn] == pytest.approx([0.0, 0.9, 1.0, 1.9])
    browser.wait_for(lambda: "a new session began" in browser.text, "a word of it")
    assert browser.warnings() == []


@of_the_page
def test_without_control_nothing_can_be_asked_of_the_rig(
    graph: Graph, browser: Any
) -> None:
    for label in ("Set", "Clear fault", "Output off"):
        assert browser.button(label) is None
    assert graph.node.count_publishers("plant/reference") == 0

    def services() -> set[str]:
        clients = graph.node.get_client_names_and_types_by_node("dashboard", "/")
        return {name for name, _ in clients}

    harmless = {"/player/pause", "/player/set_parameters", "/twin/what_if"}
    browser.wait_for(lambda: services() >= harmless, "all that it may ask")
    assert services() == harmless


@of_the_page
def test_a_replay_is_paused_and_hurried(
    browser: Any, node: Callable[..., Process], tmp_path: Path
) -> None:
    session = write_session(tmp_path / "half", counted(1800))
    assert browser.button("Pause") is None
    player = node("player", f"session:={session}", "rate:=10.0")
    browser.wait_for(lambda: "playing: " in browser.text, "the player")
    browser.click("Pause")
    browser.wait_for(lambda: "paused: " in browser.text, "the pause")
    stands = browser.column("output", 0, "t")[-1]
    time.sleep(1.0)
    assert browser.column("output", 0, "t")[-1] - stands <= 1.0
    # at 200 × a busy browser would not find the button "max" before the end
    browser.click("50 ×")
    browser.wait_for(lambda: "50 × recorded speed" in browser.text, "the speed")
    browser.click("Continue")
    browser.wait_for(
        lambda: browser.column("output", 0, "t")[-1] > stands + 100, "much more"
    )
    browser.click("max")
    assert player.wait() == 0
    browser.wait_for(lambda: "sample 1799, 1799 s" in browser.text, "the last sample")
    browser.wait_for(
        lambda: browser.button("Pause") is None, "that the player has gone"
    )
    browser.wait_for(
        lambda: "the replay has ended" in browser.text, "that this was the end"
    )
    assert browser.warnings() == []
