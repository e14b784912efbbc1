"""`twinmatch prepare`: compile beforehand what a first run would wait for."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from twinmatch.cli.shared import Progress
from twinmatch.compiled import before_kernels, told
from twinmatch.dynamics import Plant
from twinmatch.dynamics.prepare import derived_models, prepare
from twinmatch.errors import TwinmatchError
from twinmatch.kept import cache_folder
from twinmatch.offline.processes import can_be_copied, cores, end_with_parent
from twinmatch.plants import PLANTS, find_plant
from twinmatch.signals import FloatArray

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

_PROGRAMS: Final = ("twinmatch", "__main__.py")
"""Names of programs that do nothing when a new process imports them: the command, and `python -m`."""


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

    A compiler uses one core, so two processes compile. Each begins with what shares few parts with the other's, and
    the channels come last in both: the process that is ready compiles the next kernel, and the other one waits for it.
    """
    others = compile_beside(compare_models, derive_equations, judge_channels)
    judge_a_loop()
    search_once()
    judge_channels()
    others.join()
    derive_plants(PLANTS.values())
    return others.exitcode or 0


@contextlib.contextmanager
def second_compiler(*uses: Callable[[], object]) -> Iterator[None]:
    """Within the block, a second process compiles the kernels that these functions use.

    It begins when this process compiles a first kernel, and is ended with the block. On a single core there is
    none, nor in a script that calls a command: a new process would run the script again.
    """
    processes: list[BaseProcess] = []

    def begin() -> None:
        if not processes:
            processes.append(compile_beside(*uses))

    is_command = Path(sys.argv[0]).name in _PROGRAMS
    if is_command and cores() > 1:
        before_kernels.append(begin)
    try:
        yield
    finally:
        if begin in before_kernels:
            before_kernels.remove(begin)
        for process in processes:
            process.terminate()
            process.join()


def compile_beside(*uses: Callable[[], object]) -> BaseProcess:
    """A process of its own for the kernels that these functions use, in turn.

    It ends with this one, also if this one is killed; Ctrl-C is handled by this one only. It is a copy of this one,
    which has imported what both need, unless another thread may hold a lock that the copy would wait for.
    """
    import multiprocessing  # noqa: PLC0415
    from multiprocessing import resource_tracker  # noqa: PLC0415

    context: Any = multiprocessing.get_context("fork" if can_be_copied() else "spawn")
    process: BaseProcess = context.Process(target=_use, args=(uses,), daemon=True)
    # Python starts it with the first process, and unblocks the signal then
    resource_tracker.ensure_running()
    # inherited by the new process
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return process


def _use(uses: Iterable[Callable[[], object]]) -> None:
    end_with_parent()
    # only the process that was copied tells what is compiled, and has a second one
    told.clear()
    before_kernels.clear()
    # what cannot be compiled is an error of the process that needs it
    with contextlib.suppress(TwinmatchError):
        for use in uses:
            use()


def derive_plants(plants: Iterable[type[Plant]]) -> None:
    """Derive and compile the equations of these plants, and say how many structures each has."""
    for plant in plants:
        count = sum(1 for _ in prepare(plant))
        print(f"{plant.title}: {count} structures are ready in {cache_folder()}")


def derive_equations() -> None:
    """Derive and compile the equations of all plants."""
    for plant in PLANTS.values():
        for _ in derived_models(plant):
            pass


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
