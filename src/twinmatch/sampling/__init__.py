"""Sampling: a loop that foreign programs run as samples of a plant, live or from a bag.

`channels` finds numbers in the messages of any topics and makes signals of them; a `Sampler` takes their
values with their times, and gives one sample per tick. Nothing here knows ROS or files.
"""

from twinmatch.sampling.channels import Channel, SamplingError, SignalSource
from twinmatch.sampling.sampler import Sampler

__all__ = ["Channel", "Sampler", "SamplingError", "SignalSource"]
