"""Says in one line what this machine lacks for `make setup`; exits with 2 then."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import sysconfig
from pathlib import Path

OLDEST, NEWEST = (3, 10), (3, 13)


def missing() -> str | None:
    """The first thing that is missing, and what to do about it."""
    version = sys.version_info[:2]
    if not OLDEST <= version <= NEWEST:
        found = ".".join(map(str, version))
        return f"Python {found} at {sys.executable}; use 3.10 to 3.13: make setup PYTHON=/path/to/python3.12"
    if (sys.platform, platform.machine()) != ("linux", "x86_64"):
        return f"{sys.platform} on {platform.machine()}; the ROS 2 wheels are for Linux on x86_64"
    try:
        import ensurepip  # noqa: F401, PLC0415
        import venv  # noqa: F401, PLC0415
    except ImportError:
        return "the venv module is missing; install it: apt-get install python3-venv"
    compiler = os.environ.get("CXX", "g++").split()[0]
    if shutil.which(compiler) is None:
        return f"no C++ compiler ({compiler}) for the ROS messages; install it: apt-get install g++"
    header = Path(sysconfig.get_path("include")) / "Python.h"
    if not header.exists():
        return f"{header} is missing, the ROS messages need it; install it: apt-get install python3-dev"
    return None


if __name__ == "__main__":
    problem = missing()
    if problem is not None:
        print(f"setup: {problem}", file=sys.stderr)
        sys.exit(2)
