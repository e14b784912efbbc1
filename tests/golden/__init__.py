"""Golden results: digests of what stands, so that rebuilding inside moves no bit unnoticed.

`python -m tests.golden` computes every source again and compares; `--make` writes the files beside this one.
A file has a digest of all values, one for each group of them (so that a difference says where it is), a few
readable figures, and a fingerprint of processor and libraries: on another machine the last bits may differ,
and only the figures are compared.
"""

from __future__ import annotations

import hashlib
import json
import math
import platform
import re
import shutil
import subprocess
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

from llvmlite.binding import get_host_cpu_name
from threadpoolctl import threadpool_info, threadpool_limits

from tests.golden.sources import SOURCES, MissingSourceError, documents_of
from twinmatch.defects import DefectWarning

__all__ = ["SOURCES", "MissingSourceError"]

FOLDER = Path(__file__).parent
PROSE: Final = frozenset({
    *("reason", "level_reason", "certainty", "suggestion", "determined", "sentence", "notes", "absent"),
})  # fmt: skip
"""Texts that may be reworded; what they say is in other fields too."""
GROUPS: Final = (
    ("matches", re.compile(r"^matches$")),
    ("summary", re.compile(r"^summary$")),
    (
        "forecasts",
        re.compile(
            r"^(forecasts|horizons|leader.*|held_(low|high)|miss_.*|inside_.*)$"
        ),
    ),
    ("health", re.compile(r"^fault.*$")),
    ("structure", re.compile(r"^structure_parameters$|^structures?$")),
    ("nu_gap", re.compile(r"gap|^margin$|^nominal_probability$")),
    ("criteria", re.compile(r"^(orders|chosen_order|order)$")),
    ("verdicts", re.compile(r"^verdicts$")),
)
"""Groups of the fields of a judged session, by the outermost name but `verdicts`, which is for the rest."""
MARK: Final = re.compile(r" \(FMU [0-9a-f]{8}\)")
"""The hash of an FMU in the name of its structure: of a file that is built again."""
ROUGHLY: Final = 1e-3
"""How far figures may be apart on another machine, relatively."""
UNSTEADY: Final = ("replay: order", "report: numbers")
"""Figures that another machine may change: of Box–Jenkins searches, which rounding leads to other minima, and
the rows of tables that follow from the order."""

Entry = dict[str, Any]


def entry_of(name: str, folder: Path) -> Entry:
    """Run a source in an empty folder and return its digests and figures.

    Raises:
        MissingSourceError: the recording is not on this machine.
    """
    with threadpool_limits(1, user_api="blas"):
        return digest(documents_of(name, folder))


def digest(documents: dict[str, Any]) -> Entry:
    """Digests and figures of what commands wrote, by their names."""
    whole = hashlib.sha256()
    parts = {}
    for path, value in _leaves(documents):
        line = f"{'.'.join(path)} {value}\n".encode()
        whole.update(line)
        parts.setdefault(_group(path), hashlib.sha256()).update(line)
    return {
        "fingerprint": fingerprint(),
        "bits": whole.hexdigest(),
        "parts": {group: parts[group].hexdigest() for group in sorted(parts)},
        "figures": {key: _rounded(value) for key, value in _figures(documents).items()},
    }


def compare(name: str, entry: Entry) -> tuple[list[str], str]:
    """What differs from the file, and what was compared, in words."""
    stored: Entry = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    figures = [
        f"{key} is {entry['figures'].get(key)!r} and was {stored['figures'].get(key)!r}"
        for key in stored["figures"] | entry["figures"]
        if not _alike(stored["figures"].get(key), entry["figures"].get(key))
    ]
    differing = [
        key
        for key, value in stored["fingerprint"].items()
        if entry["fingerprint"].get(key) != value
    ]
    if differing:
        figures = [line for line in figures if not line.startswith(UNSTEADY)]
        return figures, f"figures only, as {', '.join(differing)} differ"
    if stored["bits"] == entry["bits"]:
        return [], "every bit"
    groups = stored["parts"] | entry["parts"]
    moved = [
        group
        for group in groups
        if stored["parts"].get(group) != entry["parts"].get(group)
    ]
    return [f"bits differ in {', '.join(moved)}", *figures], "every bit"


def work(name: str, *, making: bool) -> tuple[bool, str]:
    """Compare or make one source: whether it is as it should be, and a line about it."""
    warnings.simplefilter("error", DefectWarning)
    begun = time.process_time()
    with tempfile.TemporaryDirectory(prefix="twinmatch-golden-") as folder:
        try:
            entry = entry_of(name, Path(folder))
        except MissingSourceError as error:
            return True, f"skipped: {error}"
    took = f"{time.process_time() - begun:.1f} s of CPU"
    if making:
        text = json.dumps(entry, indent=1, ensure_ascii=False)
        (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")
        return True, f"written to {FOLDER.name}/{name}.json ({took})"
    different, compared = compare(name, entry)
    return not different, f"{'; '.join(different) or 'the same'} [{compared}] ({took})"


@cache
def fingerprint() -> dict[str, str]:
    """What the last bits may depend on besides the code."""
    libraries = ("numpy", "scipy", "numba", "llvmlite", "statsmodels")
    blas = sorted(
        f"{pool['internal_api']} {pool['version']} {pool.get('architecture')}"
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    )
    return {
        "processor": f"{_processor()} ({get_host_cpu_name()})",
        "system": f"{platform.machine()} {' '.join(platform.libc_ver())}",
        "python": platform.python_version(),
        **{library: _version(library) for library in libraries},
        "blas": ", ".join(blas),
        "gcc": _gcc(),
    }


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text(encoding="utf-8") if cpuinfo.exists() else ""
    model_name = re.search(r"^model name\s*:\s*(.*)$", text, re.MULTILINE)
    return model_name.group(1) if model_name else platform.processor()


def _version(library: str) -> str:
    with suppress(PackageNotFoundError):
        return version(library)
    return "absent"


def _gcc() -> str:
    asked = ["gcc", "-dumpfullversion"]
    has_gcc = shutil.which("gcc") is not None
    return (
        subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        if has_gcc
        else "absent"
    )


def _leaves(
    value: Any, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], str]]:
    """All values but prose, each as text that determines its bits."""
    if isinstance(value, dict):
        for key, inside in value.items():
            if key not in PROSE:
                yield from _leaves(inside, (*path, MARK.sub("", key)))
    elif isinstance(value, list):
        yield (*path, "count"), str(len(value))
        for number, inside in enumerate(value):
            yield from _leaves(inside, (*path, str(number)))
    elif isinstance(value, float):
        yield path, value.hex()
    else:
        yield path, MARK.sub("", value) if isinstance(value, str) else repr(value)


def _group(path: tuple[str, ...]) -> str:
    if path[0] != "replay":
        return ".".join(path[:2])
    return _named(tuple(key for key in path if not key.isdigit()))


@cache
def _named(keys: tuple[str, ...]) -> str:
    for group, names in GROUPS:
        if any(names.search(key) for key in keys):
            return group
    return "session"


def _figures(documents: dict[str, Any]) -> dict[str, Any]:
    return {
        f"{command}: {key}": value
        for command, document in documents.items()
        for key, value in FIGURES.get(command, _forecast_figures)(document).items()
    }


def _replay_figures(document: dict[str, Any]) -> dict[str, Any]:
    summary = document["summary"]
    verdicts = document["verdicts"]
    matches = document["matches"]
    return {
        "verdicts": len(verdicts),
        "matches": len(matches),
        "accepted": sum(match["status"] == "accepted" for match in matches),
        "candidates": len(verdicts[-1]["candidates"]) if verdicts else 0,
        "levels": dict(Counter(verdict["level"] for verdict in verdicts)),
        "faults": sorted({verdict["fault"] for verdict in verdicts} - {"", None}),
        "leader": summary["leader"],
        "leader_confidence": summary["leader_confidence"],
        "nominal": summary["nominal"],
        "order": summary["order"],
        "fit_y": summary["fit"]["y"],
        "fit_u": summary["fit"]["u"],
    }


def _backtest_figures(document: dict[str, Any]) -> dict[str, Any]:
    cards = document["total"]["cards"]
    medians = {
        f"{card['who']}, {card['horizon']:g} s": card["median"] for card in cards
    }
    return {"origins": document["total"]["origins"], **medians}


def _report_figures(document: dict[str, Any]) -> dict[str, Any]:
    return {
        "tables": len(document),
        "numbers": sum(len(row) for rows in document.values() for row in rows),
    }


def _forecast_figures(document: list[dict[str, Any]]) -> dict[str, Any]:
    figures = {}
    for forecast in document:
        at_end = [forecast["y"][edge][-1] for edge in ("low", "mean", "high")]
        figures[f"at {forecast['sample']}"] = [forecast["candidate"], *at_end]
    return figures


FIGURES: Final[dict[str, Callable[[Any], dict[str, Any]]]] = {
    "replay": _replay_figures,
    "backtest": _backtest_figures,
    "report": _report_figures,
}


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, str):
        return MARK.sub("", value)
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _alike(value: Any, expected: Any) -> bool:
    if (
        isinstance(value, list)
        and isinstance(expected, list)
        and len(value) == len(expected)
    ):
        return all(map(_alike, value, expected))
    if isinstance(value, float) and isinstance(expected, float):
        return math.isclose(value, expected, rel_tol=ROUGHLY)
    return bool(value == expected)
