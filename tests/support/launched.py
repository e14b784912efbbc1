"""Run a program that starts a graph, with a fork server that need not import again.

    launched.py -m MODULE [ARGUMENT ...]
    launched.py SCRIPT [ARGUMENT ...]

For tests, which fork the program itself: what a graph imports is in this process already, so its fork server
is forked from it. If that one is killed, the next imports, as in a program that was not forked;
tests/launching/test_forking.py tests those.
"""

from __future__ import annotations

import os
import socket
import sys

from twinmatch.launching import forking


def main() -> None:
    words = sys.argv[1:]
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    server = os.fork()
    if server == 0:
        ours.close()
        os.setsid()
        words = forking.serve(theirs)
    else:
        theirs.close()
        use_as_first_server(ours, server)
    if words:
        forking.run_program(words)


def use_as_first_server(connection: socket.socket, process: int) -> None:
    """Let this process's first fork server be the one at the other end of a connection."""
    importing_server = forking.begun_server

    def begun_server() -> tuple[socket.socket, forking.Forked]:
        forking.begun_server = importing_server
        return connection, forking.Forked(["fork server"], process)

    forking.begun_server = begun_server


if __name__ == "__main__":
    main()
