"""Models of others as structures of a plant: FMUs, each run in a process of its own.

An FMU (FMI 2 or 3, model exchange or co-simulation) is a program that somebody else wrote. A map, which the
user writes, says which structure of which plant it is, and what its variables are in the plant's words.
`adopt_fmus` takes the FMUs of a file of maps in; from then on the plant has more structures, which are
matched, foretold and scored as its own. `described_by` says what an FMU says of itself, without running it.
"""

from twinmatch.fmu.errors import FmuError
from twinmatch.fmu.mapping import FmuMap, read_maps
from twinmatch.fmu.structure import adopt_fmus, is_fmu, unmarked

__all__ = ["FmuError", "FmuMap", "adopt_fmus", "is_fmu", "read_maps", "unmarked"]
