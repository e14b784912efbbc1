"""Play a recorded session through the ROS graph and show the verdicts as they come.

    python launch_scripts/replay.py SESSION [--rate 50] [--candidates FILE] [--config FILE] [--plant FILE.py]

Ctrl-C ends it; with --dashboard the live page stays open until then. Exit code: 0 all verdicts received,
2 an option or a file cannot be used, 130 interrupted.
"""

from __future__ import annotations

import sys

from twinmatch.cli import main

if __name__ == "__main__":
    sys.argv[1:1] = ["play"]
    sys.exit(main())
