"""Runs the leading twin beside the plant: samples and `twin/leader` in, `twin/state` out.

It also publishes the description of the plant once, latched: `plant/description`.
"""

from __future__ import annotations

from twinmatch import comparing
from twinmatch.nodes.messages import description_message, state_message
from twinmatch.nodes.runner import program
from twinmatch.nodes.samples import SampleNode
from twinmatch.nodes.topics import LATCHED, RELIABLE
from twinmatch.plants.records import description_of
from twinmatch.signals import Sample
from twinmatch.twin import Mirror
from twinmatch_msgs.msg import ForecastScore, PlantDescription, TwinState
from twinmatch_msgs.srv import Past


class TwinSimulatorNode(SampleNode):
    """Publishes the twins' states at every sample; before there is a leader, they use the start values."""

    NAME = "twin_simulator"

    def open(self) -> None:
        """Start to mirror the samples."""
        self._mirror = Mirror(
            self.settings.start,
            self.settings.gains,
            self.values["recent"],
            self.settings.period,
            self.settings.schedule.gap,
        )
        self._leader = ""
        self._made = 0  # states
        self._published_before = 0  # states published before this node started
        self._publisher = self.create_publisher(TwinState, "twin/state", RELIABLE)
        self._describer = self.create_publisher(PlantDescription, "plant/description", LATCHED)
        self._describer.publish(
            description_message(description_of(self.settings.plant), self.settings.period)
        )
        super().open()
        self.create_subscription(ForecastScore, "twin/leader", self.put, LATCHED)

    def learn(self, said: Past.Response) -> None:
        """Take the number of states that a simulator before this one published."""
        self._published_before = said.states_heard

    def work(self, item: Sample | comparing.ForecastScore) -> None:
        """Mirror one sample, or take over the parameters of a new leader."""
        if isinstance(item, Sample):
            state = self._mirror.push(item)
            self._made += 1
            if self._made > self._published_before:
                message = state_message(state, self._leader, self.settings.plant.states)
                self.publish(self._publisher, message)
            return
        self._mirror.parameters = item.parameters
        self._leader = item.name
        self.health.set("leader", item.name)


main = program(TwinSimulatorNode)


if __name__ == "__main__":
    main()
