"""Adding a plant: a first file of it, written from a table of its signals, and what is wrong with one.

`propose` reads spans, noise, sample time and a first gain and lag off a table; `files_of` writes the plant,
its test and its configuration; `check_plant` says in plain words what a plant file lacks.
"""

from twinmatch.adding.check import check_plant
from twinmatch.adding.errors import AddingError
from twinmatch.adding.findings import CheckedPlant, Finding
from twinmatch.adding.proposal import Proposal, Signal, example, propose
from twinmatch.adding.written_files import files_of

__all__ = [
    "AddingError",
    "CheckedPlant",
    "Finding",
    "Proposal",
    "Signal",
    "check_plant",
    "example",
    "files_of",
    "propose",
]
