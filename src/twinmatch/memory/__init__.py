"""What earlier sessions have taught: parameters with covariances, kept in a file, and what has changed since.

`Lesson` is what one session taught about one structure; `Memory` is the file of them. `start_from` gives the
candidates that a session starts with.
"""

from twinmatch.memory.lesson import Lesson, MemoryFaultError, in_order
from twinmatch.memory.start import start_from
from twinmatch.memory.store import Memory, RememberedSession, default_file

__all__ = [
    "Lesson",
    "Memory",
    "MemoryFaultError",
    "RememberedSession",
    "default_file",
    "in_order",
    "start_from",
]
