"""All benchmarks, or the named ones, in sequence: `python -m benchmarks [--quick] [NAMES]`."""

from __future__ import annotations

import argparse
import importlib
import json
import pkgutil
import sys
import traceback
from pathlib import Path
from types import ModuleType

import benchmarks
from benchmarks.common import Row, document, environment, print_rows


def main() -> int:
    """0: all ran; 1: at least one failed; 2: an unknown name. A missed target is not a failure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="benchmarks to run (default: all)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="small cases and few rounds: does it run?"
    )
    parser.add_argument(
        "--json",
        type=Path,
        metavar="OUT",
        help="write environment and rows to this file",
    )
    parser.add_argument(
        "--list", action="store_true", help="name the benchmarks and stop"
    )
    options = parser.parse_args()
    names = available()
    unknown = sorted(set(options.names) - set(names))
    if unknown:
        print(
            f"benchmarks: there is no {', '.join(unknown)}; choose from: {', '.join(names)}",
            file=sys.stderr,
        )
        return 2
    if options.list:
        print("\n".join(names))
        return 0
    for key, value in environment().items():
        print(f"{key:20} {value}")
    rows: list[Row] = []
    broken = []
    for name in options.names or names:
        print(flush=True)
        try:
            module = _load(name)
            found = module.run(options.quick)
        except SystemExit as refused:  # a peer that it is about is not installed
            print(f"benchmarks: {refused}", file=sys.stderr)
            broken.append(name)
            continue
        except Exception:
            traceback.print_exc()
            broken.append(name)
            continue
        print_rows(f"{name}: {(module.__doc__ or '').strip().splitlines()[0]}", found)
        rows += found
    if options.json is not None:
        options.json.write_text(
            json.dumps(document(rows), indent=1, allow_nan=False, ensure_ascii=False)
            + "\n"
        )
    if broken:
        print(f"benchmarks: failed: {', '.join(broken)}", file=sys.stderr)
    return 1 if broken else 0


def available() -> list[str]:
    """Modules here whose source defines `run`."""
    here = Path(benchmarks.__file__).parent
    names = [
        module.name for module in pkgutil.iter_modules([str(here)]) if not module.ispkg
    ]
    return [
        name
        for name in sorted(names)
        if "\ndef run(" in (here / f"{name}.py").read_text()
    ]


def _load(name: str) -> ModuleType:
    return importlib.import_module(f"benchmarks.{name}")


if __name__ == "__main__":
    sys.exit(main())
