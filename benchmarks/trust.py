"""How often a twin that beats nobody is trusted, and how often the level of an exact one changes.

    python -m benchmarks.trust 20

The number is that of exact motors; of guessing twins a hundred times as many are tried.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import pairwise

from tests.support.guessing import ever_trusted, levels

SAMPLES = 3600
"""Of each motor."""


def main(arguments: Sequence[str]) -> None:
    """Print a line for each motor, and the share of twins that were ever trusted."""
    motors = int(arguments[0]) if arguments else 20
    guesses = [said for seed in range(5 * motors) for said in ever_trusted(seed)]
    print(
        f"of {len(guesses)} twins that beat nobody, {sum(guesses)} were trusted at some verdict of an hour"
    )
    for seed in range(motors):
        told = levels(seed, SAMPLES)
        changes = sum(before != after for before, after in pairwise(told))
        said = f"{changes} changes of the level in {len(told)} verdicts, at last {told[-1]}"
        print(f"motor {seed}: {said}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
