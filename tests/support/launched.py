"""Run a program that starts a graph, with a fork server that need not import again.

    launched.py -m MODULE [ARGUMENT ...]
    launched.py SCRIPT [ARGUMENT ...]

For tests, which fork the program itself: what a graph imports is in this process already, so its fork server
is forked from it. If that one is killed, the next imports, as in a program that was not forked;
tests/launching/test_forking.py tests those.
"""

from __future__ import annotations

import sys

from twinmatch.launching import forking, launcher


def main() -> None:
    words = sys.argv[1:]
    launcher.fork_server_from_here()
    forking.run_program(words)


if __name__ == "__main__":
    main()
