"""Samples of a loop from the values that foreign programs publish: which field, which tick, which age.

`Sampler` takes values with their times and makes one `Sample` per tick of the foreign loop. `channels` finds
a number in a message of any type by its path. Nothing here knows ROS or bags.
"""

from twinmatch.sessions.sampling.channels import (
    Channel,
    Field,
    SamplingError,
    SignalSource,
    check_path,
    fields_below,
    follow,
    parse_channel,
    usual_unit,
)
from twinmatch.sessions.sampling.sampler import (
    INPUT,
    OUTPUT,
    REFERENCE,
    TIMER,
    Grid,
    Limits,
    Rate,
    Sampler,
)

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
    "SignalSource",
    "check_path",
    "fields_below",
    "follow",
    "parse_channel",
    "usual_unit",
]
