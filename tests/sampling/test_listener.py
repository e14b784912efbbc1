"""A listener that was held up: what arrived meanwhile is told apart."""

from __future__ import annotations

from collections.abc import Mapping

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

    def close(self) -> None:
        """Nothing to end."""


def test_a_tick_has_its_own_values_though_newer_ones_wait_when_it_is_read() -> None:
    parameters = {f"map.{name}": place for name, place in PLACES.items()} | {"period": PERIOD / NANOSECONDS}
    clock_time = 1_000 * NANOSECONDS
    listener = listener_of(
        "sampler", check("sampler", *understood("sampler", parameters)), lambda: clock_time
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
        samples += listener.samples()  # once per period, while a tick is ready a tenth of a period later
        clock_time += PERIOD
    samples += listener.samples()
    assert [(s.index, s.output, s.input) for s in samples] == [(k, 20.0 + k, 20.0 + k) for k in range(6)]
