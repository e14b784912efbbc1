"""Records encoded from their definitions alone, compared with what ROS makes of the same records."""

from __future__ import annotations

import pytest

pytest.importorskip(
    "twinmatch_msgs.msg", reason="twinmatch_msgs is not built; run make setup"
)

from rclpy.serialization import deserialize_message

from tests.support.places import PROJECT
from twinmatch.nodes.messages import description_message, message_of
from twinmatch.offline.judging import judge_samples, terms_from_files
from twinmatch.plants import PLANTS
from twinmatch.plants.records import description_of
from twinmatch.record import description_tree, tree_of
from twinmatch.sessions import read_session
from twinmatch.sessions.cdr import encode
from twinmatch.sessions.messages import schema_of, topic_named
from twinmatch_msgs.msg import Match, ModelScore, PlantDescription

pytestmark = pytest.mark.ros


def test_matches_and_verdicts_are_the_messages_of_the_graph() -> None:
    """Not compared as bytes: between fields, the middleware leaves whatever was in memory."""
    session = read_session(PROJECT / "bags" / "four_setpoints")
    samples = session.samples[:610]  # two matches
    judged = judge_samples("beginning", samples, terms_from_files(session).settings)
    assert len(judged.matches) == 2
    assert judged.verdicts
    for name, kind, records in (
        ("match", Match, judged.matches),
        ("model_score", ModelScore, judged.verdicts),
    ):
        for record in records:
            stamp = judged.stamps[record.sample]
            data = encode(topic_named(f"/twin/{name}"), tree_of(record), stamp)
            assert repr(deserialize_message(data, kind)) == repr(
                message_of(record, stamp)
            )


@pytest.mark.parametrize("plant", PLANTS)
def test_descriptions_are_the_messages_of_the_graph(plant: str) -> None:
    described = description_of(PLANTS[plant])
    data = encode(topic_named("/plant/description"), description_tree(described, 0.5))
    sent = description_message(described, 0.5)
    assert repr(deserialize_message(data, PlantDescription)) == repr(sent)


@pytest.mark.parametrize(
    "name", ["/twin/match", "/twin/model_score", "/plant/description"]
)
def test_definitions_are_the_installed_ones(name: str) -> None:
    """But for the comments of the types that every release of ROS has."""

    def fields(schema: str) -> list[str]:
        lines = (
            " ".join(line.split("#", 1)[0].split()) for line in schema.splitlines()
        )
        return [line for line in lines if line]

    topic = topic_named(name)
    assert fields(topic.schema) == fields(schema_of(topic.type))
