"""Commands in this process, for all that does not need one of its own."""

from __future__ import annotations

import io
import subprocess
from contextlib import redirect_stderr, redirect_stdout

from twinmatch.cli import main

__all__ = ["twinmatch"]


def twinmatch(*words: object) -> subprocess.CompletedProcess[str]:
    """Run `twinmatch` with these arguments, as a process would be run: its exit code and what it printed."""
    arguments = [str(word) for word in words]
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        try:
            code = main(arguments)
        except SystemExit as exit_:
            code = exit_.code if isinstance(exit_.code, int) else 2
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())
