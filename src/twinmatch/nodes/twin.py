"""The twin simulator and the matcher; the discriminator has a file of its own."""

from __future__ import annotations

import threading

from twinmatch import comparing, twin
from twinmatch.nodes.messages import description_message, message_of, state_message
from twinmatch.nodes.samples import SampleNode, TwinNode
from twinmatch.nodes.topics import EVERYTHING, LATCHED, RELIABLE
from twinmatch.parameters.candidates import candidates_in
from twinmatch.plants.records import description_of
from twinmatch.signals import Sample
from twinmatch.twin import Door, Mirror, carry_out
from twinmatch_msgs.msg import (
    ForecastScore,
    Match,
    MatchRequest,
    PlantDescription,
    TwinState,
)
from twinmatch_msgs.srv import Past


class TwinSimulatorNode(SampleNode):
    """Runs the leading twin beside the plant: samples and `twin/leader` in, `twin/state` out.

    Before there is a leader, the twins use the start values. The description of the plant is published once,
    latched: `plant/description`.
    """

    NAME = "twin_simulator"

    def open(self) -> None:
        """Start to mirror the samples."""
        self._mirror = Mirror(
            self.settings.start,
            self.settings.law,
            self.values["recent"],
            self.settings.period,
            scale=self.settings.forecasts.scale,
        )
        self._door = Door(self.settings)
        self._leader = ""
        self._states_made = 0
        self._published_before = 0  # states published before this node started
        self._publisher = self.create_publisher(TwinState, "twin/state", RELIABLE)
        self._describer = self.create_publisher(
            PlantDescription, "plant/description", LATCHED
        )
        self._describer.publish(
            description_message(
                description_of(self.settings.plant), self.settings.period
            )
        )
        super().open()
        self.create_subscription(ForecastScore, "twin/leader", self.put, LATCHED)

    def learn(self, answer: Past.Response) -> None:
        """Take the number of states that a simulator before this one published."""
        if not self._stream.begun:
            self._published_before = answer.states_heard

    def work(self, received: Sample | comparing.ForecastScore) -> None:
        """Mirror one sample, or take over the parameters of a new leader."""
        if isinstance(received, Sample):
            self._mirror_sample(received)
            return
        self._mirror.parameters = received.parameters
        self._door.know(received.parameters)
        self._leader = received.name
        self.health.set("leader", received.name)

    def _mirror_sample(self, sample: Sample) -> None:
        """Publish the state of the twins at a sample; those lost before it have stand-ins."""
        self._door.push(sample)
        *stand_ins, settled = self._door.settled()
        for stand_in in stand_ins:
            self._mirror.push(stand_in)
        state = self._mirror.push(settled)
        self._states_made += 1
        if self._states_made > self._published_before:
            message = state_message(state, self._leader, self.settings.plant.states)
            self.publish(self._publisher, message)


MAX_WAITING = 20
"""Most requests that wait; a discriminator has one, and repeats it."""


class MatcherNode(TwinNode):
    """Fits the plant's parameters to requested windows: `twin/match_request` in, `twin/match` out.

    Every request is answered; one that is repeated while in progress is answered once.
    """

    NAME = "matcher"

    def open(self) -> None:
        """Wait for requests."""
        self._informed = self.settings.informed_by(candidates_in(self.values))
        self._publisher = self.create_publisher(Match, "twin/match", RELIABLE)
        self._in_progress: set[tuple[int, int]] = set()
        self._lock = threading.Lock()
        self.health.say("waiting for requests")
        super().open()
        self.create_subscription(
            MatchRequest, "twin/match_request", self._on_request, EVERYTHING
        )

    def work(self, received: tuple[twin.MatchRequest, int]) -> None:
        """Compute the match and publish it, with the stamp (ns) of its request."""
        request, stamp = received
        try:
            report = carry_out(request, self._informed)
        finally:
            with self._lock:
                self._in_progress.discard((request.sample, request.window.first))
        self.health.count("matches")
        self.health.set(
            "last match", f"{report.match.status.value} at sample {report.sample}"
        )
        self.publish(self._publisher, message_of(report, stamp))

    def _on_request(self, received: tuple[twin.MatchRequest, int]) -> None:
        self.health.say("working")
        request, _ = received
        name = (request.sample, request.window.first)
        with self._lock:
            if name in self._in_progress:
                return
            if len(self._in_progress) >= MAX_WAITING:
                self.health.count("left to be repeated")
                return
            self._in_progress.add(name)
        self.put(received)
