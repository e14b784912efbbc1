"""FMUs as structures of a plant, each run in its own process.

An FMU (FMI 2 or 3, model exchange or co-simulation) is another author's program. A map, written by the user,
assigns it to a plant as a structure, and its variables to the plant's quantities. `adopt_fmus` adds the FMUs
of a map file to their plant; they are then matched, used for forecasts and scored like the plant's own
structures. `described_by` reads an FMU's description without executing its code.
"""

from twinmatch.fmu.structure import adopt_fmus, unmarked
from twinmatch.plants.records import is_marked as is_fmu

__all__ = ["adopt_fmus", "is_fmu", "unmarked"]
