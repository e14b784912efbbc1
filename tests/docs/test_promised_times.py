"""What pages say of how long something takes is so, with the pages' own files, in simulated time."""

from __future__ import annotations

import csv
import random
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import paho.mqtt.client
import pytest
import yaml

from tests.support.faulty_kit import Simulated, run
from tests.support.places import PROJECT
from tests.support.processes import no_plant_files
from tests.support.promises import files_of, page, said
from twinmatch.comparing import TrustLevel
from twinmatch.parameters.sampler import sampler_values, sources_of
from twinmatch.parameters.twin import read_settings
from twinmatch.plants.files import load_plant
from twinmatch.sampling import payloads
from twinmatch.sampling.sources import SignalMap
from twinmatch.signals import Sample
from twinmatch.twin import Twin, TwinSettings


class EndOfTimeError(Exception):
    """The run of a page's program is over."""


class Home:
    """Messages of the page's home, step by step, without waiting."""

    def __init__(
        self, program: str, steps: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        self.now: dict[str, bytes] = {}
        self.steps: list[dict[str, bytes]] = []
        monkeypatch.setattr(paho.mqtt.client, "Client", lambda _: self)
        monkeypatch.setattr(time, "sleep", lambda _: self._next(steps))
        random.seed(5)
        with pytest.raises(EndOfTimeError):
            exec(compile(program, "home.py", "exec"), {"__name__": "__main__"})

    def connect(self, *_: object) -> None:
        """There is no network here: what the program publishes is kept."""

    loop_start = connect

    def publish(self, topic: str, payload: str, *, retain: bool) -> None:
        assert retain
        self.now[topic] = payload.encode()

    def _next(self, steps: int) -> None:
        self.steps.append(dict(self.now))
        if len(self.steps) == steps:
            raise EndOfTimeError


class Outcomes:
    """When the first verdict, match, trusted verdict and leader came, and each fault, s, and what the newest
    match found."""

    def __init__(self, samples: Iterator[Sample], settings: TwinSettings) -> None:
        self.first: dict[str, float] = {}
        self.faults: dict[str, float] = {}
        self.trusted: dict[float, tuple[float, ...]] = {}
        """The trusted horizons after each verdict, s."""
        self.found: dict[str, float] = {}
        twin = Twin(settings)
        for sample in samples:
            now = sample.index * settings.period
            outcome = twin.push(sample)
            if outcome.match is not None and outcome.match.match.accepted:
                self.first.setdefault("match", now)
                matched = outcome.match.match.parameters
                names, _ = outcome.match.match.of_parameters()
                self.found = {name: matched[name] for name in names}
            for verdict in outcome.verdicts:
                self.first.setdefault("verdict", now)
                self.trusted[now] = verdict.trusted
                if verdict.fault:
                    self.faults.setdefault(verdict.fault, now)
                if verdict.leader:
                    self.first.setdefault("leader", now)
                if verdict.level is TrustLevel.TRUSTED:
                    self.first.setdefault("trust", now)


def samples_of(steps: list[dict[str, bytes]], folder: Path) -> Iterator[Sample]:
    """The samples that the page's map makes of what is published between two ticks."""
    values, _ = sampler_values(folder / "room.yaml", SignalMap())
    sources = sources_of("room", values)
    units = {"output": "°C", "input": "1", "outside": "°C"}
    for index, messages in enumerate(steps):
        numbers = {}
        for signal, source in sources.items():
            [channel] = source.channels(signal, payloads.parse_place)
            value = payloads.value_at(
                payloads.document_of(messages[channel.topic]), channel.path
            )
            assert value is not None
            number = source.number(value, units[signal])
            numbers[signal] = source.follow(
                signal, units[signal], [channel], [""]
            ).value([number], 0.0)
        reading = numbers["output"]
        yield Sample(
            index, index, reading, reading, numbers["input"], (numbers["outside"],)
        )


def judged_home(program: str, period: float, steps: int, folder: Path) -> Outcomes:
    """What comes of the page's home by the page's map and plant."""
    with pytest.MonkeyPatch.context() as patch:
        published = Home(program, steps, patch).steps
    for name, text in files_of(page("mqtt.md")).items():
        (folder / name).write_text(text, encoding="utf-8")
    config = yaml.safe_load((folder / "room.yaml").read_text())
    config["sampler"]["ros__parameters"]["plant"] = str(folder / "room.py")
    (folder / "room.yaml").write_text(yaml.safe_dump(config))
    with no_plant_files():
        plant = load_plant(str(folder / "room.py"))
        settings = TwinSettings.of(plant, period=period, law=None)
        return Outcomes(samples_of(published, folder), settings)


def test_the_home_on_the_page_of_mqtt_is_matched_and_trusted_when_the_page_says(
    tmp_path: Path,
) -> None:
    """Its capacity in the page's plant file is 150 times too large."""
    text = page("mqtt.md")
    period = said(text, r"With `home.py`, [^`]* add `--period ([\d.]+)`")
    outcomes = judged_home(
        files_of(text)["home.py"], period, round(240.0 / period), tmp_path
    )
    assert outcomes.first["verdict"] <= said(
        text, r"the first verdict comes\s+after (\d+) seconds"
    )
    assert outcomes.first["match"] <= 60.0 * said(
        text, r"the first match within (\w+) minutes"
    )
    assert outcomes.first["trust"] <= 60.0 * said(
        text, r"the twin is trusted within (\w+)\."
    )


def test_the_room_on_that_page_is_trusted_when_the_page_says(tmp_path: Path) -> None:
    text = page("mqtt.md")
    config = yaml.safe_load(files_of(text)["room.yaml"])["sampler"]["ros__parameters"]
    step = said(text, r"a thermometer that reads in steps of ([\d.]+) °C")
    assert step == 0.1
    program = files_of(text)["home.py"].replace("0.03):.2f}", "0.03):.1f}")
    assert program != files_of(text)["home.py"]
    trusted_after = 60.0 * said(
        text, r"the twin of this room is trusted after (\d+) minutes"
    )
    outcomes = judged_home(
        program,
        config["period"],
        round(1.2 * trusted_after / config["period"]),
        tmp_path,
    )
    assert outcomes.first["verdict"] <= 60.0 * said(
        text, r"The first verdict comes after (\w+) minutes"
    )
    assert outcomes.first["trust"] <= 1.05 * trusted_after
    share = said(text, r"finds its 1200 W\s+and 2·10⁵ J/K to (\d+) %") / 100.0
    assert outcomes.found["power"] == pytest.approx(1200.0, rel=share)
    assert outcomes.found["capacity"] == pytest.approx(2e5, rel=share)


class Oven:
    """What the page's rig publishes, sample by sample, without waiting and without ROS."""

    def __init__(
        self, program: str, steps: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        self.published: list[list[float]] = []
        self._now = 0.0
        self._steps = steps
        rclpy = ModuleType("rclpy")
        rclpy.init = rclpy.ok = lambda: True  # type: ignore[attr-defined]
        rclpy.create_node = lambda _: self  # type: ignore[attr-defined]
        executors = ModuleType("rclpy.executors")
        executors.ExternalShutdownException = EndOfTimeError  # type: ignore[attr-defined]
        messages = ModuleType("std_msgs.msg")
        messages.Float64 = self._take  # type: ignore[attr-defined]
        for module in (rclpy, executors, messages):
            monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr(time, "monotonic", lambda: self._now)
        monkeypatch.setattr(time, "sleep", self._sleep)
        random.seed(6)
        exec(compile(program, "oven_rig.py", "exec"), {"__name__": "__main__"})

    def create_publisher(self, *_: object) -> Oven:
        """One object stands for the node and for its three publishers."""
        return self

    def publish(self, _: object) -> None:
        """Taken when the message is made."""

    def _take(self, data: float) -> None:
        if not self.published or len(self.published[-1]) == 3:
            self.published.append([])
        self.published[-1].append(data)

    def _sleep(self, seconds: float) -> None:
        self._now += seconds
        if len(self.published) == self._steps:
            raise EndOfTimeError


def test_the_oven_on_the_page_of_attach_is_matched_after_two_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = page("attach.md")
    steps = said(text, r"After (\w+) steps there is a match")
    files = files_of(text)
    holds = said(files["oven_rig.py"], r"tick // (\d+) % 2")
    with monkeypatch.context() as patch:
        published = Oven(
            files["oven_rig.py"], round((steps + 1) * holds), patch
        ).published
    (tmp_path / "oven.py").write_text(files["oven.py"], encoding="utf-8")
    period = said(text, r"--plant oven.py --period ([\d.]+)")
    with no_plant_files():
        settings = TwinSettings.of(load_plant(str(tmp_path / "oven.py")), period=period)
        samples = (
            Sample(k, round(k * period * 1e9), wanted, reading, heater)
            for k, (wanted, reading, heater) in enumerate(published)
        )
        outcomes = Outcomes(samples, settings)
    assert outcomes.first["match"] <= (steps + 1) * holds * period
    assert outcomes.found["gain"] / outcomes.found["capacity"] == pytest.approx(
        0.5 / 4.0, rel=0.05
    )


def test_the_kit_is_matched_after_as_many_minutes_as_its_page_says() -> None:
    """The simulated kit of the package, under the loop and the set-points that are shipped."""
    pytest.importorskip(
        "tclab", reason="the simulated kit is not installed; it is in the extra 'tclab'"
    )
    minutes = said(
        page("tclab.md"),
        r"After the second level, some (\d+) minutes, there is a first match",
    )
    config = yaml.safe_load((PROJECT / "config" / "tclab.yaml").read_text())[
        "controller"
    ]["ros__parameters"]
    levels = np.repeat(
        config["profile.levels"], np.array(config["profile.holds"], dtype=int)
    )
    samples = run(Simulated(3), levels[: round(60.0 * (minutes + 1.0))])
    outcomes = Outcomes(
        iter(samples), read_settings(PROJECT / "config" / "tclab_twin.yaml")
    )
    assert outcomes.first["match"] <= 60.0 * (minutes + 1.0)
    assert outcomes.first["leader"] <= 60.0 * (minutes + 1.0)


class LoggedPage(NamedTuple):
    """What a page's program logged, as its map reads it, and the page's plant."""

    samples: list[Sample]
    settings: TwinSettings


@contextmanager
def logged(
    name: str, plant: str, columns: Sequence[str], period: float, folder: Path
) -> Iterator[LoggedPage]:
    """The log of a page, and its plant, which is known meanwhile; output, input and disturbance are named."""
    files = files_of(page(name))
    (folder / plant).write_text(files[plant], encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile(files["make_log.py"], "make_log.py", "exec"), {})
    with (folder / "log.csv").open(encoding="utf-8") as log:
        rows = list(csv.DictReader(log))
    samples = []
    for k, row in enumerate(rows):
        reading, command, disturbance = (float(row[column]) for column in columns)
        stamp = round(k * period * 1e9)
        samples.append(Sample(k, stamp, reading, reading, command, (disturbance,)))
    with no_plant_files():
        settings = TwinSettings.of(
            load_plant(str(folder / plant)), period=period, law=None
        )
        yield LoggedPage(samples, settings)


@pytest.mark.long("judges forty minutes, or days, of a page's plant")
def test_the_hot_end_on_its_page_is_matched_trusted_and_broken_when_the_page_says(
    tmp_path: Path,
) -> None:
    text = page("hot_end.md")
    columns = ("Nozzle (degC)", "Heater (%)", "Fan")
    with logged("hot_end.md", "hot_end.py", columns, 1.0, tmp_path) as (log, settings):
        outcomes = Outcomes(iter(log), settings)
    holds = 300.0
    assert outcomes.first["match"] <= holds
    assert "The first of them gives a match already" in text
    trusted_after = 60.0 * said(text, r"the twin is trusted after (\w+) minutes")
    assert outcomes.trusted[min(t for t in outcomes.trusted if t >= trusted_after)]
    for name, value in (("power", 0.4), ("losses", 0.07), ("blown", 0.04), ("lag", 4)):
        assert f"{value:g}" in text
        assert outcomes.found[name] == pytest.approx(value, rel=0.05)
    broken = 60.0 * said(text, r"after (\d+)\s+minutes the heater's lead breaks")
    late = 60.0 * said(text, r"(Half a) minute after the lead breaks the verdict")
    assert broken < outcomes.faults["drift"] <= broken + late
    assert "Seconds later it can tell them apart" in text
    assert outcomes.faults["drift"] < outcomes.faults["drive-lost"]
    assert outcomes.faults["drive-lost"] <= outcomes.faults["drift"] + late


def test_the_room_on_its_page_is_trusted_and_its_window_named_when_the_page_says(
    tmp_path: Path,
) -> None:
    text = page("room.md")
    columns = ("Room (degC)", "Radiator (W)", "Outdoor (degC)")
    with logged("room.md", "room.py", columns, 600.0, tmp_path) as (log, settings):
        outcomes = Outcomes(iter(log), settings)
    hour = 3600.0
    day = 24.0 * hour
    trusted_day = said(text, r"In the course of the (\w+) day the twin becomes trusted")
    ahead = {
        hour * said(text, r"becomes trusted (\w+) and"),
        hour * said(text, r"becomes trusted \w+ and (\w+) hours ahead"),
    }
    opened = 11.4 * day
    trusted = [
        horizons
        for now, horizons in outcomes.trusted.items()
        if trusted_day * day <= now < opened
    ]
    assert len(trusted) > 30
    assert all(ahead <= {*horizons} for horizons in trusted)
    late = hour * said(text, r"(\w+) hours later the verdict says `losses-changed`")
    assert opened < outcomes.faults["losses-changed"] <= opened + late
    assert {*outcomes.faults} == {"losses-changed"}
    typical = settings.plant.typical
    assert {*outcomes.found} == {*typical}
    for name, value in typical.items():
        assert outcomes.found[name] == pytest.approx(value, rel=0.06)
