"""`python -m twinmatch.cli`."""

from __future__ import annotations

import sys

from twinmatch.cli import main

if __name__ == "__main__":
    sys.exit(main())
