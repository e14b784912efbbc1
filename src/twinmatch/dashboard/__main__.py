"""`python -m twinmatch.dashboard`: what `twinmatch dashboard` is, for the launch scripts."""

from __future__ import annotations

import argparse
import sys

from twinmatch.dashboard.command import add_arguments, run
from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="dashboard", description="The live page.")
    add_arguments(parser)
    try:
        sys.exit(run(parser.parse_args()))
    except TwinmatchError as error:
        print(error, file=sys.stderr)
        sys.exit(EXIT_USER_ERROR)
