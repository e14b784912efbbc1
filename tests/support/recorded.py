"""Sessions with verdicts, as the recorder makes them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message

from tests.support.waiting import wait_for
from twinmatch.nodes.messages import message_of
from twinmatch.sessions import (
    Qos,
    Session,
    SessionError,
    SessionWriter,
    Topic,
    read_session,
)
from twinmatch.sessions.cdr import encode_sample
from twinmatch.sessions.messages import SAMPLE, schema_of
from twinmatch.sessions.metadata import CANDIDATES, parameters_of, parameters_record
from twinmatch.signals import Sample
from twinmatch.twin import Outcome

Change = Callable[[list[Any], list[Any]], None]
"""May spoil messages of matches and of scores before they are written."""


def _topic(name: str, kind: str) -> Topic:
    return Topic(name, kind, schema_of(kind), "", Qos("reliable", "volatile", 100))


SCORE = _topic("/twin/model_score", "twinmatch_msgs/msg/ModelScore")
MATCH = _topic("/twin/match", "twinmatch_msgs/msg/Match")


def write_judged(
    folder: Path,
    samples: Sequence[Sample],
    outcomes: Iterable[Outcome],
    values: Mapping[str, Any],
    *,
    nodes: Sequence[str] = ("/matcher", "/discriminator"),
    family: str | None = None,
    change: Change = lambda _matches, _scores: None,
    stamps: Mapping[int, int] | None = None,
) -> Path:
    """Samples with what a twin said of them, the parameters of these nodes and the initial candidates.

    Stamps of lost samples have to be given if verdicts were due there.
    """
    outcomes = list(outcomes)
    stamps = stamps or {sample.index: sample.stamp for sample in samples}
    matches = [
        message_of(o.match, stamps[o.match.sample])
        for o in outcomes
        if o.match is not None
    ]
    scores = [message_of(v, stamps[v.sample]) for o in outcomes for v in o.verdicts]
    change(matches, scores)
    entries = {name: json.dumps(value) for name, value in values.items()}
    with SessionWriter(folder) as writer:
        for node in nodes:
            writer.add_record(
                parameters_record(node), {**entries, "use_sim_time": "false"}
            )
        if family is not None:
            writer.add_record(CANDIDATES, {"text": family})
        for topic in (SAMPLE, SCORE, MATCH):
            writer.add_topic(topic)
        for sample in samples:
            writer.write(SAMPLE.name, encode_sample(sample), sample.stamp)
        for topic, messages in ((MATCH, matches), (SCORE, scores)):
            for message in messages:
                writer.write(topic.name, serialize_message(message), samples[-1].stamp)
    return folder


def written(folder: Path) -> Session | None:
    """What is in the file of a recorder that runs; None before the first sample."""
    try:
        return read_session(folder)
    except SessionError:
        return None


def wait_for_recorded(folder: Path, **counts: int) -> None:
    """Until so many messages of some topics are in the file; the recorder writes it out every half second."""

    def enough() -> bool:
        session = written(folder)
        return session is not None and all(
            session.counts.get(f"/{name.replace('__', '/')}", 0) >= count
            for name, count in counts.items()
        )

    wait_for(enough, lambda: str(written(folder)))


def wait_for_settings(folder: Path, *nodes: str) -> None:
    """Until the parameters of these nodes (full names) are in the file."""

    def are_there() -> bool:
        session = written(folder)
        return session is not None and all(
            parameters_of(session.records, node) is not None for node in nodes
        )

    wait_for(are_there, lambda: str(written(folder)))
