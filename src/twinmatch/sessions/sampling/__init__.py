"""Samples of a loop from the values that foreign programs publish: which field, which tick, which age.

`Sampler` takes values with their times and makes one `Sample` per tick of the foreign loop. `fields` finds
a number in a message of any type by its path. Nothing here knows ROS or bags.
"""

from twinmatch.sessions.sampling.errors import SamplingError
from twinmatch.sessions.sampling.fields import Channel, Field, check_path, fields_below, follow, parse_channel
from twinmatch.sessions.sampling.grid import Grid
from twinmatch.sessions.sampling.rate import Rate
from twinmatch.sessions.sampling.sampler import INPUT, OUTPUT, REFERENCE, TIMER, Limits, Sampler
from twinmatch.sessions.sampling.wires import Wire

__all__ = [
    "INPUT",
    "OUTPUT",
    "REFERENCE",
    "TIMER",
    "Channel",
    "Field",
    "Grid",
    "Limits",
    "Rate",
    "Sampler",
    "SamplingError",
    "Wire",
    "check_path",
    "fields_below",
    "follow",
    "parse_channel",
]
