"""The processor that code is compiled for: where possible a kind of which there are many.

Code for such a kind runs on another machine, too, so a wheel can bring it along. It takes as long as code for
the one processor at hand, and gives the same bits.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Final, NamedTuple

from llvmlite import binding

COMMON: Final = "x86-64-v3"
"""LLVM's name of the third level of x86-64, which servers and desktops have had since 2013 to 2015."""
_NEEDED: Final = (
    "avx",
    "avx2",
    "bmi",
    "bmi2",
    "f16c",
    "fma",
    "lzcnt",
    "movbe",
    "popcnt",
    "sse4.2",
    "xsave",
)
"""What distinguishes that level from those below, by LLVM's names (x86-64 psABI, table 3.1)."""


class Processor(NamedTuple):
    """A processor as LLVM describes it."""

    name: str
    features: str
    """Those beyond what the name says, as LLVM writes them: `+avx2,-sse4a`."""


@functools.cache
def processor() -> Processor:
    """The kind of processor that code is compiled for, or the processor at hand if it is of no such kind."""
    features = binding.get_host_cpu_features()
    if is_common(features):
        return Processor(COMMON, "")
    return Processor(binding.get_host_cpu_name(), features.flatten())


def is_common(features: Mapping[str, bool]) -> bool:
    """Whether a processor with these features runs code for `COMMON`."""
    return all(features.get(name, False) for name in _NEEDED)
