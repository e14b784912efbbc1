"""CDR bytes of matches, verdicts and descriptions, from their definitions alone: without ROS."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final

from mcap_ros2._dynamic import serialize_dynamic

from twinmatch.description import Description
from twinmatch.record import Tree, tree_of
from twinmatch.sessions.messages import Qos, Topic, fields_of, topic_of
from twinmatch.signals import NANOSECONDS

_KINDS: Final = {
    "/twin/match": ("Match", Qos(depth=1000)),
    "/twin/model_score": ("ModelScore", Qos(depth=1000)),
    "/plant/description": ("PlantDescription", Qos(durability="transient_local", depth=1)),
}
_CONSTANT: Final = re.compile(r"uint8 ([A-Z_]+) ?= ?(\d+)")


@cache
def topic_named(name: str) -> Topic:
    """The topic of this name with its definition; one of `/twin/match`, `/twin/model_score` and
    `/plant/description`."""
    kind, qos = _KINDS[name]
    return topic_of(name, f"twinmatch_msgs/msg/{kind}", "", qos)


def encode(topic: Topic, tree: Tree, stamp: int | None = None) -> bytes:
    """Encode a record of `twinmatch.record`; `stamp` (ns) is that of the sample behind it, if it has one."""
    encoder, numbers = _encoder(topic)
    whole = dict(tree)
    for name in [name for name in tree if name.endswith("_name")]:  # a word, beside its number
        whole[name.removesuffix("_name")] = numbers[tree[name].upper()]
    if stamp is not None:
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        whole["header"] = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": ""}
    return encoder(whole)


def description_tree(description: Description, period: float) -> Tree:
    """A plant as in `PlantDescription`; `period` (s) is the sampling period it is run with."""
    return tree_of(description) | {"period": period}


@cache
def _encoder(topic: Topic) -> tuple[Callable[[Any], bytes], Mapping[str, int]]:
    """Encodes messages of a topic, and the numbers of its words."""
    matches = map(_CONSTANT.fullmatch, fields_of(topic.schema))
    numbers = {match[1]: int(match[2]) for match in matches if match}
    return serialize_dynamic(topic.type, topic.schema)[topic.type], numbers
