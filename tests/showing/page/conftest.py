"""A session with its verdicts, a page in a process of its own, and a browser to look at it."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.places import CHROMIUM
from tests.support.processes import Process, Processes
from tests.support.steps import quarter_of_an_hour
from tests.support.waiting import PATIENCE, wait_for
from twinmatch.offline.judging import Judgement, judge_samples
from twinmatch.signals import Sample
from twinmatch.twin import TwinSettings

DEEP = """
const deep = (root) => [...root.querySelectorAll('*')].flatMap(
    (e) => e.shadowRoot ? [e, ...deep(e.shadowRoot)] : [e]);
"""
"""Bokeh's widgets live in shadow trees, which selectors do not look into."""
FOREIGN = "evil.example"
"""A name of somebody else that resolves to this machine, as after DNS rebinding."""


@pytest.fixture(scope="session")
def steps() -> list[Sample]:
    return quarter_of_an_hour()


@pytest.fixture(scope="session")
def judged(steps: list[Sample]) -> Judgement:
    """Matches and verdicts of those samples."""
    return judge_samples("steps", steps, TwinSettings())


@pytest.fixture(scope="module")
def page_process(
    ros: None,  # noqa: ARG001
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[..., Process]]:
    """Start a page: `page_process("--control")`; it ends with the module."""
    processes = Processes(tmp_path_factory.mktemp("pages"))
    yield lambda *options: processes.python(
        "-m", "twinmatch.cli", "dashboard", "--port", "0", *options
    )
    ended = processes.end()
    assert all(
        Process.well(code) and "Traceback" not in text for code, text in ended
    ), ended


@pytest.fixture(scope="session")
def commanding(
    ros: None,  # noqa: ARG001
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Process]:
    """A page that may command the rig, for the tests that open it, one module after the other; the last of
    them ends it."""
    processes = Processes(tmp_path_factory.mktemp("commanding"))
    yield processes.python(
        "-m", "twinmatch.cli", "dashboard", "--port", "0", "--control"
    )
    ended = processes.end()
    assert all(
        Process.well(code) and "Traceback" not in text for code, text in ended
    ), ended


class Browser:
    """Headless Chromium that reaches nothing but this machine, which has a foreign name, too."""

    def __init__(self, profile: Path) -> None:
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = str(shutil.which("chromium"))
        flags = (
            "--window-size=1440,1000 --js-flags=--expose-gc --disable-quic --headless"
        )
        names = f"MAP {FOREIGN} 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost"
        alone = f"--host-resolver-rules={names}"
        for flag in (*flags.split(), *CHROMIUM, alone, f"--user-data-dir={profile}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(
            options=options, service=Service(str(shutil.which("chromedriver")))
        )
        self.driver.set_script_timeout(PATIENCE)
        self.driver.command_executor.client_config.timeout = PATIENCE

    def wait_for(self, condition: Callable[[], Any], what: str) -> Any:
        """Look less often than elsewhere: a look at a page keeps its browser busy."""
        return wait_for(condition, what, meanwhile=lambda: time.sleep(0.2))

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(DEEP + script, *arguments)

    def open(self, url: str) -> None:
        self.driver.get(url)
        self.wait_for(
            lambda: self.run("return window.Bokeh && Bokeh.documents.length == 1"),
            "the document",
        )
        self.wait_for(lambda: "what to do" in self.text, "the first text")

    @property
    def text(self) -> str:
        """Everything that can be read, shadow trees included; hidden parts are left out."""
        return str(
            self.run(
                "return deep(document).filter((e) => e.checkVisibility())"
                ".filter((e) => !['SCRIPT', 'STYLE'].includes(e.tagName))"
                ".flatMap((e) => [...e.childNodes].filter((n) => n.nodeType == 3 && n.data.trim())"
                ".map((n) => n.data.trim())).join(' ')"
            )
        )

    def sized(self, *sizes: tuple[int, int]) -> Iterator[tuple[int, int]]:
        """The page in windows of these widths and heights, and at last in its own.

        A narrow window is a telephone's, which loads the page again: some things fit its width from then on.
        """
        for width, height in sizes:
            is_telephone = width < 600
            window = {
                "width": width,
                "height": height,
                "deviceScaleFactor": 1,
                "mobile": is_telephone,
            }
            self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", window)
            if is_telephone:
                self.open(self.driver.current_url)
            self.run("scrollTo(0, 0)")
            yield width, height
        self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        yield 1440, 1000

    def keys(self, *keys: str) -> None:
        """Press keys, wherever the focus is."""
        from selenium.webdriver.common.action_chains import ActionChains

        ActionChains(self.driver).send_keys(*keys).perform()

    def button(self, label: str) -> Any:
        """A button that can be seen, by its label; None if there is none."""
        return self.run(
            "return deep(document).find((e) => e.tagName == 'BUTTON' && e.innerText.trim() == arguments[0]"
            " && e.checkVisibility()) || null",
            label,
        )

    def click(self, label: str) -> None:
        """Click a button as soon as it can be: the page may just be drawing it again."""
        from selenium.common.exceptions import (
            ElementClickInterceptedException as Covered,
        )
        from selenium.common.exceptions import ElementNotInteractableException as Hidden
        from selenium.common.exceptions import StaleElementReferenceException as Gone

        def clicked() -> bool:
            try:
                button = self.button(label)
                return button is not None and button.click() is None
            except (Covered, Hidden, Gone):
                return False

        self.wait_for(clicked, f"the button {label}")

    def column(self, chart: str, renderer: int, name: str) -> list[float]:
        """What a chart draws; empty while the page is being built again, which takes its charts away."""
        return list(
            self.run(
                "return Array.from(Bokeh.documents[0].get_model_by_name(arguments[0])"
                "?.renderers[arguments[1]].data_source.data[arguments[2]] ?? [])",
                chart,
                renderer,
                name,
            )
        )

    def picture(self, chart: str) -> bytes:
        """What of a chart is on the screen."""
        element = self.run(
            "return Bokeh.index.get_one(Bokeh.documents[0].get_model_by_name(arguments[0])).el",
            chart,
        )
        return bytes(element.screenshot_as_png)

    def warnings(self) -> list[str]:
        """Errors in the console since the last look."""
        return [
            entry["message"]
            for entry in self.driver.get_log("browser")
            if entry["level"] == "SEVERE"
        ]

    def elsewhere(self, url: str) -> list[str]:
        """What the page loaded from somewhere else."""
        names = self.run(
            "return performance.getEntriesByType('resource').map((e) => e.name)"
        )
        own_beginnings = (url, url.replace("http", "ws"), "data:", "blob:")
        return [name for name in names if not name.startswith(own_beginnings)]


@pytest.fixture(scope="session")
def opened_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One for all pages: to start it takes longer than to load a page."""
    pytest.importorskip(
        "selenium", reason="selenium is not installed; it is in the extra 'test'"
    )
    for program in ("chromium", "chromedriver"):
        if shutil.which(program) is None:
            pytest.skip(
                f"{program} is not installed: apt-get install chromium chromium-driver"
            )
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.driver.quit()


@pytest.fixture(scope="module")
def browser(opened_browser: Browser) -> Iterator[Browser]:
    """The browser for the pages of one module, which it leaves before their servers end."""
    yield opened_browser
    opened_browser.driver.get("about:blank")
    opened_browser.warnings()  # not the next module's
