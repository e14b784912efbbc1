"""The records of a run: verdicts, matches, requests, forecasts and their parts, described in one place.

The dataclasses themselves are the description. Names and types of their fields give the fields of a message
(`tree_of`, `fill`), the object again (`tree_of_message`, `object_of`), JSON (`documents_of`) and the bit for
bit comparison (`differences`). A new field is added to the dataclass and to the message; a test compares the
two. Nothing here knows ROS: any object with the fields is a message.

An absent value (`None`) is NaN, −1 or an empty text in a message and null in JSON. A level or status is a
word, with a number beside it in a message.
"""

from twinmatch.record.fields import SAMPLED
from twinmatch.record.trees import (
    Tree,
    comparable,
    description_tree,
    differences,
    documents_of,
    fill,
    finite,
    object_of,
    parameters_of,
    parameters_tree,
    tree_of,
    tree_of_message,
)

__all__ = [
    "SAMPLED",
    "Tree",
    "comparable",
    "description_tree",
    "differences",
    "documents_of",
    "fill",
    "finite",
    "object_of",
    "parameters_of",
    "parameters_tree",
    "tree_of",
    "tree_of_message",
]
