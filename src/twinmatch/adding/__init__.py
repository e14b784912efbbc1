"""Adding a plant: writing a first plant file from a table of its signals, and checking plant files.

`propose` estimates spans, noise, sampling period, gain and lag from a table; `files_of` writes the plant, its
test and its configuration; `check_plant` reports what is wrong with a plant file and what to do.
"""

from twinmatch.adding.check import check_plant
from twinmatch.adding.proposal import Proposal, example, propose
from twinmatch.adding.trial import CheckedPlant
from twinmatch.adding.written_files import files_of

__all__ = [
    "CheckedPlant",
    "Proposal",
    "check_plant",
    "example",
    "files_of",
    "propose",
]
