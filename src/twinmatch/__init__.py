"""Which digital twin to trust, and how far, while the plant runs."""

from __future__ import annotations

__all__ = ["__version__"]

__version__ = "0.1.0"
