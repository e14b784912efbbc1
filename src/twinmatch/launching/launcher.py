"""A command that starts a graph shares its memory with the nodes: their fork server is forked from it.

Nodes and launcher import much of the same: ROS, numpy, numba and the twin. In two processes that import it
separately it takes twice the memory and twice the processor time.
"""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path
from typing import Final

from twinmatch.errors import EXIT_INTERRUPTED
from twinmatch.launching.forking import (
    ENVIRONMENT,
    Forked,
    ForkServer,
    has_fork_server,
    import_for_programs,
    name_process,
    run_program,
    serve_and_run,
    use_fork_server,
)
from twinmatch.launching.succession import continue_in_child

_COMMAND: Final = "twinmatch.cli"
"""The module that runs a command."""


def continue_as_launcher() -> None:
    """Begin this process again, as one that forks its fork server; nothing if it has a fork server.

    The process keeps its number, its terminal and its files, and waits for a child that runs the command. It must
    do nothing but run the command of its arguments, since that begins again.
    """
    if has_fork_server():
        return
    sys.stdout.flush()
    sys.stderr.flush()
    words = [sys.executable, "-m", __name__, *sys.argv[1:]]
    os.execve(sys.executable, words, {**os.environ, **ENVIRONMENT})  # noqa: S606


def main() -> None:
    """Import, fork the server, and run the command in a child of this process."""
    continue_in_child(_import)
    fork_server_from_here()
    name_process("twinmatch")
    run_program(["-m", _COMMAND, *sys.argv[1:]])


def _import() -> None:
    try:
        import_for_programs()
    except KeyboardInterrupt:
        print("twinmatch: interrupted", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)


def fork_server_from_here() -> None:
    """Fork the fork server of this process, which has one thread. In the server and in the programs that it
    forks, this ends the process.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    process = os.fork()
    if process:
        theirs.close()
        use_fork_server(ForkServer((ours, Forked(["fork server"], process))))
        return
    ours.close()
    os.setsid()
    with Path(os.devnull).open() as nothing:
        os.dup2(nothing.fileno(), 0)
    name_process("fork_server")
    serve_and_run(theirs)
    sys.exit()


if __name__ == "__main__":
    main()
