"""The versions that the machine code in a wheel was made with: with others it is not used.

numba, Python and the plants' files leave it then without a word, and all is compiled again.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Final

MADE_WITH: Final = Path(__file__).parent / "machine_code" / "made_with.json"
"""The file in a wheel of `make dist`; a checkout has none."""
_PACKAGES: Final = ("numba", "llvmlite", "sympy")
_PYTHON: Final = "Python"


def versions() -> dict[str, str]:
    """Versions of all that machine code depends on, as they are installed, by name."""
    from importlib import metadata  # noqa: PLC0415

    of_python = f"{sys.version_info.major}.{sys.version_info.minor}"
    return {_PYTHON: of_python} | {name: metadata.version(name) for name in _PACKAGES}


def why_not_used(made_with: Path = MADE_WITH) -> str:
    """Why the machine code of a wheel is not used, and what to do; empty if it is used, or if there is none."""
    if not made_with.exists():
        return ""
    shipped = json.loads(made_with.read_text("utf-8"))
    installed = versions()
    differing = [name for name in shipped if shipped[name] != installed[name]]
    if not differing:
        return ""
    wanted = ", ".join(f"{name} {shipped[name]}" for name in differing)
    present = ", ".join(f"{name} {installed[name]}" for name in differing)
    sentence = (
        f"the machine code in this installation is for {wanted}, not for {present}"
    )
    if _PYTHON in differing:
        return f"{sentence}; it is compiled once for this one"
    pins = " ".join(f"{name}=={shipped[name]}" for name in differing)
    return f"{sentence}; compiling takes a minute, once; `pip install {pins}` saves it"
