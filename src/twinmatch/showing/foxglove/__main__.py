"""`python -m twinmatch.showing.foxglove`: the same as `twinmatch foxglove`."""

from __future__ import annotations

import argparse
import sys

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.showing.foxglove.command import add_arguments, run

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="foxglove", description="The graph in Foxglove and Lichtblick.")
    add_arguments(parser)
    try:
        sys.exit(run(parser.parse_args()))
    except TwinmatchError as error:
        print(error, file=sys.stderr)
        sys.exit(EXIT_USER_ERROR)
