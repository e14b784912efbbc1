"""What earlier sessions have taught: parameters with covariances, kept in a file, and what has changed since.

`Lesson` is what one session taught about one structure; `Memory` is the file of them.
"""

from twinmatch.memory.lesson import Lesson, MemoryFaultError, in_order
from twinmatch.memory.store import Memory, RememberedSession, default_file

__all__ = ["Lesson", "Memory", "MemoryFaultError", "RememberedSession", "default_file", "in_order"]
