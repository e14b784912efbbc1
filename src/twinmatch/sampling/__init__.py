"""Samples of a loop from the values that somebody else's programs send: which field, which tick, how old.

`Sampler` is told values and their times and makes one `Sample` per tick of the foreign loop. `fields` finds
the number that is meant in a message of any type. Nothing here knows ROS or bags.
"""

from twinmatch.sampling.errors import SamplingError
from twinmatch.sampling.fields import Channel, Field, check_path, fields_below, follow, parse_channel
from twinmatch.sampling.grid import Grid
from twinmatch.sampling.rate import Rate
from twinmatch.sampling.sampler import Limits, Sampler

__all__ = [
    "Channel",
    "Field",
    "Grid",
    "Limits",
    "Rate",
    "Sampler",
    "SamplingError",
    "check_path",
    "fields_below",
    "follow",
    "parse_channel",
]
