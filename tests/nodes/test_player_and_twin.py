"""What the player leaves to the twin that listens to it."""

from __future__ import annotations

import pytest

from tests.support.ros import Inside, Listener
from twinmatch.nodes.player import FROM_TWIN

pytestmark = pytest.mark.ros


def test_what_a_twin_publishes_of_the_plant_is_not_played_beside_it(
    listener: Listener,
) -> None:
    """Otherwise readers would get everything twice: as it was recorded, and as it is now."""
    published: set[str] = set()
    for name in ("discriminator", "twin_simulator"):
        twin = Inside(name)
        try:
            listener.spin_until(
                lambda node_name=name: node_name in listener.node.get_node_names(),
                "the node",
            )
            topics = listener.spin_until(
                lambda node_name=name: (
                    listener.node.get_publisher_names_and_types_by_node(node_name, "/")
                ),
                "its topics",
            )
            published |= {topic.removeprefix("/") for topic, _ in topics}
        finally:
            twin.end()
    assert {topic for topic in published if topic.startswith("plant/")} == {*FROM_TWIN}
