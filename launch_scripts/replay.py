"""Play a recorded session through the ROS graph and show the verdicts as they come.

    python launch_scripts/replay.py SESSION [--rate 50] [--candidates FILE] [--config FILE] [--plant FILE.py]

Ctrl-C ends it; with --dashboard the live page stays open until then. Exit code: 0 all verdicts came,
2 something given cannot be used, 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.launching.page import add_page_options, page_of


def main() -> int:
    """Parse the command line and play."""
    parser = argparse.ArgumentParser(description="Play a recorded session through the ROS graph.")
    parser.add_argument("session", type=Path, help="session folder, .mcap file or recording (.mat, .csv)")
    parser.add_argument(
        "--rate", type=float, default=50.0, help="times recorded speed; 0: as fast as it goes"
    )
    parser.add_argument("--candidates", type=Path, metavar="FILE", help="family to begin with (.yaml)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="parameter file of the twin's nodes")
    parser.add_argument("--plant", metavar="NAME|FILE.py", help="the plant, if the session does not say it")
    add_page_options(parser)
    options = parser.parse_args()
    if not 0.0 <= options.rate <= 1000.0:
        parser.error(f"--rate is {options.rate:g}; it must be within 0 and 1000")
    try:
        from twinmatch.launching.replay import Replay, play  # noqa: PLC0415 — needs ROS

        with page_of(options, parser, options.config) as page:
            code = play(
                Replay(options.session, options.rate, options.candidates, options.config, options.plant)
            )
            if code == 0:
                page.stay()
            return code
    except TwinmatchError as error:
        print(f"replay: {error}", file=sys.stderr)
        return EXIT_USER_ERROR


if __name__ == "__main__":
    sys.exit(main())
