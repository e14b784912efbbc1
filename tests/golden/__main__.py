"""`python -m tests.golden`: compare golden results, or make them."""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed

from tests.golden import SOURCES, work

WORKERS = 2


def main() -> int:
    """Compare or make; returns 1 if something differs."""
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument(
        "sources", nargs="*", metavar="SOURCE", help="only these (default: all)"
    )
    parser.add_argument(
        "--make", action="store_true", help="write the files instead of comparing"
    )
    parser.add_argument(
        "--list", action="store_true", help="print the names of the sources"
    )
    options = parser.parse_args()
    unknown = [name for name in options.sources if name not in SOURCES]
    if unknown:
        parser.error(f"no source {unknown[0]!r}; there are: {', '.join(SOURCES)}")
    names = options.sources or list(SOURCES)
    if options.list:
        print("\n".join(names))
        return 0
    context = multiprocessing.get_context("spawn")
    begun = time.monotonic()
    failed: list[str] = []
    with ProcessPoolExecutor(min(WORKERS, len(names)), mp_context=context) as pool:
        futures = {pool.submit(work, name, making=options.make): name for name in names}
        for count, future in enumerate(as_completed(futures), 1):
            right, sentence = future.result()
            failed += [] if right else [futures[future]]
            print(f"[{count}/{len(names)}] {futures[future]}: {sentence}", flush=True)
    print(f"{len(names)} sources in {time.monotonic() - begun:.0f} s", end="")
    if failed:
        print(f"; DIFFERENT: {', '.join(failed)}")
    elif options.make:
        print()
    else:
        print("; nothing differs")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
