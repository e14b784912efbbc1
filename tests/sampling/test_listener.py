"""A listener: what arrived while it was held up, what cannot be read, and what is sent several times."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from twinmatch.parameters.declared import check
from twinmatch.parameters.sampler import listener_of, understood
from twinmatch.sampling.channels import Channel
from twinmatch.sampling.listener import Receive
from twinmatch.signals import NANOSECONDS

PERIOD = 3 * NANOSECONDS
PLACES = {"reference": "/wanted:data", "output": "/plate:data", "input": "/pwm:data"}


class WaitingValues:
    """A source that hands on one set of values per poll, with their time."""

    lost = ""

    def __init__(self, channels: list[Channel], receive: Receive) -> None:
        self.kinds: Mapping[str, str] = dict.fromkeys((c.topic for c in channels), "")
        self.waiting: list[tuple[int, float]] = []
        self._receive = receive

    def search(self, waited: float) -> None:
        """All is there."""

    def path(self, channel: Channel) -> str:
        return channel.path

    def poll(self) -> None:
        if self.waiting:
            stamp, value = self.waiting.pop(0)
            for topic in self.kinds:
                self._receive(topic, lambda _: value, stamp)

    def trouble(self, topic: str) -> str:  # noqa: ARG002
        return ""

    def news(self) -> list[str]:
        return []

    def close(self) -> None:
        """Nothing to end."""


def test_a_tick_has_its_own_values_though_newer_ones_wait_when_it_is_read() -> None:
    parameters = {f"map.{name}": place for name, place in PLACES.items()} | {
        "period": PERIOD / NANOSECONDS
    }
    clock_time = 1_000 * NANOSECONDS
    listener = listener_of(
        "sampler",
        check("sampler", *understood("sampler", parameters)),
        lambda: clock_time,
    )
    opened: list[WaitingValues] = []

    def opens(channels: list[Channel], receive: Receive) -> WaitingValues:
        opened.append(WaitingValues(channels, receive))
        return opened[0]

    listener.open(opens)
    listener.search()
    samples = []
    for tick in range(6):
        opened[0].waiting.append((clock_time, 20.0 + tick))
        # once per period, while a tick is ready a tenth of a period later
        samples += listener.samples()
        clock_time += PERIOD
    samples += listener.samples()
    assert [(s.index, s.output, s.input) for s in samples] == [
        (k, 20.0 + k, 20.0 + k) for k in range(6)
    ]


class Spoken:
    """A listener whose source says what a test gives it, by a clock of its own."""

    def __init__(
        self, *, paced_by: str, max_age: float = 0.0, entry: str = "/state:data"
    ) -> None:
        parameters: dict[str, Any] = {
            "map.output": "/plate:data",
            "map.input": entry,
            "paced_by": paced_by,
        }
        parameters |= {"period": 3.0, "max_age.input": max_age}
        self.time = 1_000 * NANOSECONDS
        self.is_timed = paced_by == "timer"
        values = check("sampler", *understood("sampler", parameters))
        self.listener = listener_of("sampler", values, lambda: self.time)
        self.listener.open(WaitingValues)
        self.listener.search()

    def say(self, value: float | str) -> None:
        """The input's message; a reading comes with it."""
        self.listener.receive("/plate", lambda _: 20.0)
        self.listener.receive("/state", lambda _: value)

    def inputs(self, seconds: float) -> list[float]:
        """The inputs of the samples of so many seconds, with a tick of the timer in each period."""
        values = []
        for number in range(round(10 * seconds)):
            self.time += NANOSECONDS // 10
            if number % 30 == 0 and self.is_timed:
                self.listener.receive("/plate", lambda _: 20.0)
                self.listener.tick()
            values += [sample.input for sample in self.listener.samples()]
        return values


def test_a_value_ends_when_something_newer_cannot_be_read_and_its_text_is_reported() -> (
    None
):
    spoken = Spoken(paced_by="timer", entry="/state:data; scale=80")
    spoken.say("heat")
    assert spoken.inputs(12.0) == [80.0] * 3
    spoken.say("blah")
    spoken.say("blah")
    assert spoken.inputs(12.0) == []
    [line] = spoken.listener.news()
    assert "input: /state:data: 'blah' is not a number" in line
    assert "'blah'" in spoken.listener.trouble("input")
    assert spoken.listener.refusals["input"].count == 2
    assert spoken.listener.news() == []  # each reason comes one time
    spoken.say("idle")
    assert set(spoken.inputs(12.0)) == {0.0}
    assert not spoken.listener.trouble("input")


def test_nan_ends_what_would_hold_for_ever_and_leaves_ages_to_the_rest() -> None:
    for max_age, inputs in ((0.0, []), (9.0, [50.0])):
        spoken = Spoken(paced_by="timer", max_age=max_age)
        spoken.say(50.0)
        spoken.say(math.nan)
        assert spoken.inputs(6.0) == inputs


@pytest.mark.parametrize("times", [1, 2, 3])
def test_messages_that_are_sent_several_times_at_once_count_once(times: int) -> None:
    spoken = Spoken(paced_by="input", max_age=9.0)
    samples = []
    for number in range(20):
        for _ in range(times):
            spoken.say(float(number % 2))
            spoken.time += NANOSECONDS // 1000
        samples += spoken.inputs(3.0)
    assert samples == [float(number % 2) for number in range(20)]
    assert "pace" not in spoken.listener.sampler.troubles
    assert spoken.listener.sampler.repeated == 20 * (times - 1)


def test_a_pace_that_cannot_be_kept_is_a_trouble_after_a_few_messages() -> None:
    spoken = Spoken(paced_by="input", max_age=9.0)
    for number in range(8):
        spoken.say(float(number))
        spoken.inputs(1.0)
    assert "input arrives every 1" in spoken.listener.sampler.troubles["pace"]


def test_a_word_whose_number_the_drive_cannot_have_leads_to_the_map() -> None:
    spoken = Spoken(paced_by="timer", entry="/state:data; scale=80")
    spoken.say("cooling")
    assert spoken.inputs(9.0) == [-80.0] * 2  # the Peltier element cools, too
    spoken = Spoken(paced_by="timer", entry="/state:data; scale=800")
    spoken.say("cooling")
    assert spoken.inputs(9.0) == []
    assert "if 'cooling' means 1, append '; cooling=1'" in spoken.listener.trouble(
        "input"
    )


def test_a_word_beside_numbers_is_reported_since_it_may_be_a_setting() -> None:
    spoken = Spoken(paced_by="timer", entry="/state:data; per=2")
    spoken.say(20.0)
    spoken.say(20.0)
    [line] = spoken.listener.news()
    assert line.startswith("input comes as numbers, so that per of its map is not used")
