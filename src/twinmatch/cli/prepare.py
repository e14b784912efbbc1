"""`twinmatch prepare`: compile beforehand what a first run would wait for."""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable, Iterable
from multiprocessing.process import BaseProcess

from twinmatch.cli.shared import Progress
from twinmatch.dynamics import Plant
from twinmatch.dynamics.prepare import prepare
from twinmatch.kept import cache_folder
from twinmatch.offline.processes import end_with_parent
from twinmatch.plants import PLANTS, find_plant
from twinmatch.signals import FloatArray


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plant",
        metavar="NAME|FILE.py",
        help="only this plant (default: all that come with twinmatch)",
    )


def run(options: argparse.Namespace) -> int:
    """Compile; returns the exit code.

    Raises:
        TwinmatchError: there is no such plant, or its equations cannot be used.
    """
    with Progress("preparing"):
        if options.plant:
            derive_plants([find_plant(options.plant)])
            return 0
        return _compile_all()


def _compile_all() -> int:
    """Compile all that comes with twinmatch; returns the exit code.

    A compiler uses one core, so two processes compile. The engine uses what the others compile.
    """
    models = compile_beside(compare_models)
    derive_plants(PLANTS.values())
    models.join()
    channels = compile_beside(judge_channels)
    judge_a_loop()
    search_once()
    channels.join()
    return models.exitcode or channels.exitcode or 0


def compile_beside(use: Callable[[], object]) -> BaseProcess:
    """A process of its own for some kernels; it ends with this one, also if this one is killed."""
    process = multiprocessing.get_context("spawn").Process(
        target=_use, args=(use,), daemon=True
    )
    process.start()
    return process


def _use(use: Callable[[], object]) -> None:
    end_with_parent()
    use()


def derive_plants(plants: Iterable[type[Plant]]) -> None:
    """Derive and compile the equations of these plants, and say how many structures each has."""
    for plant in plants:
        count = sum(1 for _ in prepare(plant))
        print(f"{plant.title}: {count} structures are ready in {cache_folder()}")


def compare_models() -> None:
    """Use the kernels that identify and compare models once, which compiles them."""
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


def judge_a_loop() -> None:
    """Have the engine judge a simulated quarter of an hour: matches, trust, health and confidence."""
    import numpy as np  # noqa: PLC0415

    from twinmatch.dynamics import Sensor, begin, simulate_closed_loop  # noqa: PLC0415
    from twinmatch.offline.judging import judge_samples  # noqa: PLC0415
    from twinmatch.sessions import samples_of  # noqa: PLC0415
    from twinmatch.signals import Window  # noqa: PLC0415
    from twinmatch.twin import TwinSettings  # noqa: PLC0415

    settings = TwinSettings()
    reference = np.repeat([25.0, 40.0, 60.0, 45.0], [60, 300, 300, 260])
    # Parameters in the middle of their ranges, which are not those that the twin begins with.
    plant = settings.plant.model().typical()
    camera = Sensor(noise=0.1).realise(reference.size, 1.0, seed=1)
    loop = simulate_closed_loop(
        plant, reference, states=begin(plant, reference[0]), sensor=camera
    )
    judge_samples(
        "simulated", samples_of(Window(reference, loop.output, loop.input)), settings
    )


def search_once() -> None:
    """Search for the least of a square, with the kernel of all fits to several windows."""
    import numpy as np  # noqa: PLC0415

    from twinmatch.dynamics import descend  # noqa: PLC0415

    def square(point: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        return float(point @ point), point, np.eye(1)

    bound = np.ones(1)
    descend(square, np.full(1, 0.5), -bound, bound, bound, 5)


def judge_channels() -> None:
    """Watch a simulated plant with two inputs and outputs, for a minute."""
    import numpy as np  # noqa: PLC0415

    from twinmatch.dynamics import begin, simulate_driven  # noqa: PLC0415
    from twinmatch.health.channels import ChannelMonitor  # noqa: PLC0415
    from twinmatch.plants import TCLabBoth  # noqa: PLC0415
    from twinmatch.signals import Sample  # noqa: PLC0415

    kit = TCLabBoth.model(TCLabBoth.followed).typical()
    inputs = np.repeat([[30.0, 20.0], [50.0, 40.0]], 30, axis=0)
    outputs = simulate_driven(kit, inputs, states=begin(kit, [30.0, 28.0])).outputs
    outputs += 0.05 * np.random.default_rng(1).standard_normal(outputs.shape)
    monitor = ChannelMonitor(kit, period=1.0)
    for k in range(len(inputs)):
        monitor.push(Sample(k, k, (0.0, 0.0), tuple(outputs[k]), tuple(inputs[k])))
