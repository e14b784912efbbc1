"""Sampling: a loop that foreign programs run as samples of a plant, live or from a bag.

A `SignalMap` says where each signal comes from, live, in a table or in a bag; `channels` finds numbers in the
messages of any topics; a `Sampler` takes values with their times, and gives one sample per tick.
"""

from twinmatch.sampling.sampler import Sampler
from twinmatch.sampling.sources import SignalMap, SignalSource

__all__ = ["Sampler", "SignalMap", "SignalSource"]
