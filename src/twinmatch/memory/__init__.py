"""What earlier sessions have taught: parameters with covariances, kept in a file, and what has changed since.

`Lesson` is what one session taught about one structure of its plant; `lessons_of` makes those of a judged
session. `Memory` is the file of them. `start_from` gives the candidates that a session starts with.
`report_on` compares the sessions and names steps and trends. All but `Memory` is pure.
"""

from twinmatch.memory.changes import (
    MemoryReport,
    ParameterChange,
    report_on,
    shared_structure,
)
from twinmatch.memory.learning import SessionEvidence, digest_of, lessons_of
from twinmatch.memory.lesson import Lesson, MemoryFaultError, current_lessons, in_order
from twinmatch.memory.start import start_from
from twinmatch.memory.store import Memory, default_file, default_files

__all__ = [
    "Lesson",
    "Memory",
    "MemoryFaultError",
    "MemoryReport",
    "ParameterChange",
    "SessionEvidence",
    "current_lessons",
    "default_file",
    "default_files",
    "digest_of",
    "in_order",
    "lessons_of",
    "report_on",
    "shared_structure",
    "start_from",
]
