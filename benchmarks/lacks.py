"""In how many simulated rooms of one, two and three stores a plant file of one store lacks "a second store".

    python -m benchmarks.lacks 20

The number is that of rooms of each kind. Each is recorded for twelve days, every half hour.
"""

from __future__ import annotations

import sys

from tests.support.rooms import judged_room


def main(rooms: int) -> None:
    """Print a line for each kind of room, and what was said in the others."""
    for stores in (1, 2, 3):
        said = [judged_room(seed, stores).split("; ")[-1] for seed in range(rooms)]
        others = {text for text in said if not text.startswith("a second store")}
        print(
            f"{stores} stores: named in {sum(text not in others for text in said)} of {rooms}"
        )
        print(*(f"    {text}" for text in others if stores > 1), sep="\n", end="")


if __name__ == "__main__":
    main(int(sys.argv[1]))
