"""`twinmatch prepare`: compile beforehand what a first run would wait for."""

from __future__ import annotations

import argparse
import multiprocessing

from twinmatch.dynamics.prepare import prepare
from twinmatch.dynamics.store import cache_folder
from twinmatch.plants import PLANTS, find_plant


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plant", metavar="NAME|FILE.py", help="only this plant (default: all that come with twinmatch)"
    )


def run(options: argparse.Namespace) -> int:
    """Compile; returns the exit code.

    Raises:
        TwinmatchError: there is no such plant, or its equations cannot be used.
    """

    # Beside the plants: a compiler uses one core.
    identifying = multiprocessing.get_context("spawn").Process(target=_identify_and_compare, daemon=True)
    if not options.plant:
        identifying.start()
    for plant in [find_plant(options.plant)] if options.plant else PLANTS.values():
        count = sum(1 for _ in prepare(plant))
        print(f"{plant.title}: {count} structures are ready in {cache_folder()}")
    if not options.plant:
        identifying.join()
    return 0


def _identify_and_compare() -> None:
    """Use the kernels that compare models once, which compiles them."""
    import numpy as np  # noqa: PLC0415

    from twinmatch.comparing import identify, nu_gap_matrix  # noqa: PLC0415
    from twinmatch.signals import Window  # noqa: PLC0415

    reference = np.repeat([0.0, 1.0, 0.0], 100)
    output = np.zeros(reference.size)
    noise = np.random.default_rng(1).normal(0.0, 0.01, reference.size)
    for k in range(1, output.size):
        output[k] = 0.9 * output[k - 1] + 0.1 * reference[k - 1]
    models = identify(Window(reference, output + noise, reference - output - noise))
    nu_gap_matrix([model.symbol for model in models])
