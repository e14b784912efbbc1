"""A session with its verdicts, a page in a process of its own, and a browser to look at it."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twinmatch.plant import Camera, RigParameters, simulate_closed_loop
from twinmatch.replay import Judgement, judge_samples
from twinmatch.sessions import samples_of
from twinmatch.signals import Sample, Window
from twinmatch.twin import TwinSettings

PATIENCE = 40.0
"""Seconds after which a test gives up on something that should come within one."""

DEEP = """
const deep = (root) => [...root.querySelectorAll('*')].flatMap(
    (e) => e.shadowRoot ? [e, ...deep(e.shadowRoot)] : [e]);
"""
"""Bokeh's widgets live in shadow trees, which selectors do not look into."""


@pytest.fixture(scope="session")
def steps() -> list[Sample]:
    """A quarter of an hour of a simulated rig: three set-point steps, the last of which loses the drive."""
    reference = np.repeat([25.0, 40.0, 60.0, 45.0], [60, 300, 300, 260])
    parameters = RigParameters(seebeck=0.08, conductance=0.4, heat_capacity=30.0)
    camera = Camera().realise(reference.size, 1.0, 7)
    response = simulate_closed_loop(parameters, reference, plate=296.0, camera=camera)
    return samples_of(Window(reference=reference, output=response.output, input=response.input))


@pytest.fixture(scope="session")
def judged(steps: list[Sample]) -> Judgement:
    """Matches and verdicts of those samples."""
    return judge_samples("steps", steps, TwinSettings())


def until(condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Wait until something holds; the test fails if it does not come to."""
    deadline = time.monotonic() + patience
    while not (found := condition()):
        assert time.monotonic() < deadline, f"{what} did not come within {patience} s"
        time.sleep(0.05)
    return found


class PageProcess:
    """`twinmatch dashboard` in a process of its own."""

    def __init__(self, output: Path, *options: str) -> None:
        self.output = output
        command = [sys.executable, "-m", "twinmatch.cli", "dashboard", "--port", "0", *options]
        with output.open("w") as stream:
            self.process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)

    @property
    def text(self) -> str:
        return self.output.read_text()

    @property
    def url(self) -> str:
        def address() -> str | None:
            assert self.process.poll() is None, self.text
            found = re.search(r"^page: (\S+)$", self.text, re.MULTILINE)
            return found[1] if found else None

        return str(until(address, "the page's address"))

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(20)


@pytest.fixture(scope="module")
def page_process(ros: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., PageProcess]]:  # noqa: ARG001
    """Start a page: `page_process("--control")`; it ends with the module."""
    started: list[PageProcess] = []
    folder = tmp_path_factory.mktemp("pages")

    def start(*options: str) -> PageProcess:
        started.append(PageProcess(folder / f"{len(started)}.txt", *options))
        return started[-1]

    yield start
    codes = [(page.end(), page.text) for page in started]
    assert all(code == 0 and "Traceback" not in text for code, text in codes), codes


class Browser:
    """Headless Chromium that reaches nothing but this machine."""

    def __init__(self, profile: Path) -> None:
        from selenium import webdriver
        from selenium.webdriver.chrome.service import Service

        options = webdriver.ChromeOptions()
        options.binary_location = str(shutil.which("chromium"))
        for flag in (
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--disable-dev-shm-usage",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--window-size=1440,1000",
            "--js-flags=--expose-gc",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
            f"--user-data-dir={profile}",
        ):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(str(shutil.which("chromedriver"))))

    def wait_for(self, condition: Callable[[], Any], what: str) -> Any:
        return until(condition, what)

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(DEEP + script, *arguments)

    def open(self, url: str) -> None:
        self.driver.get(url)
        until(lambda: self.run("return window.Bokeh && Bokeh.documents.length == 1"), "the document")
        until(lambda: "verdict" in self.text, "the first text")

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

    def button(self, label: str) -> Any:
        """A button that can be seen, by its label; None if there is none."""
        return self.run(
            "return deep(document).find((e) => e.tagName == 'BUTTON' && e.innerText.trim() == arguments[0]"
            " && e.checkVisibility()) || null",
            label,
        )

    def click(self, label: str) -> None:
        until(lambda: self.button(label), f"the button {label}").click()

    def column(self, chart: str, renderer: int, name: str) -> list[float]:
        """What a chart draws."""
        return list(
            self.run(
                "return Array.from(Bokeh.documents[0].get_model_by_name(arguments[0])"
                ".renderers[arguments[1]].data_source.data[arguments[2]])",
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

    def complaints(self) -> list[str]:
        """Errors in the console since the last look."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def elsewhere(self, url: str) -> list[str]:
        """What the page loaded from somewhere else."""
        names = self.run("return performance.getEntriesByType('resource').map((e) => e.name)")
        own = (url, url.replace("http", "ws"), "data:", "blob:")
        return [name for name in names if not name.startswith(own)]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    pytest.importorskip("selenium", reason="selenium is not installed; it is in the extra 'test'")
    for program in ("chromium", "chromedriver"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed: apt-get install chromium chromium-driver")
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.driver.quit()
