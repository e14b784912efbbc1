"""The process in which an FMU runs: reads requests from standard input, answers on its standard output.

An FMU is a program. Here it has its own folder, none of its parent's sockets, limits on memory and file size,
and exits with its parent. The parent enforces time limits.
"""

from __future__ import annotations

import math
import os
import resource
import select
import shutil
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from twinmatch.dynamics.loop import Gains, pid_step, reading
from twinmatch.fmu.archive import (
    MOST_BYTES,
    FmuArchiveError,
    described_from,
    digest_of,
    read_description,
    unpack,
)
from twinmatch.fmu.exchange import ModelExchange, machine_of
from twinmatch.fmu.machine import (
    DONE,
    EVENT,
    CoSimulation,
    FmuRunError,
    References,
    compile_runs,
    compiled_run,
)
from twinmatch.fmu.process import MARK, ProcessMessage, end_marked, packed, unpacked
from twinmatch.signals import FloatArray

MEMORY: Final = 2 << 30
"""Memory that the FMU may use in addition to that of this process before loading, bytes."""
_GRACE: Final = 10
"""Seconds after the time limit at which the process ends itself."""
_LONGEST: Final = 1e8
DESCRIPTION: Final = "modelDescription.xml"

Arrays = dict[str, FloatArray]


class FmuWorker:
    """One FMU, and the requests it answers."""

    def __init__(self) -> None:
        self._machine: CoSimulation | None = None
        self._asks: dict[str, Callable[[ProcessMessage], tuple[dict[str, Any], Arrays]]] = {
            "describe": self._describe,
            "load": self._load,
            "outputs": self._outputs,
            "ticks": self._ticks,
            "rates": self._rates,
            "runs": self._runs,
        }

    def answer(self, message: ProcessMessage) -> bytes:
        """Answer a request; errors of the FMU are an answer too."""
        try:
            header, arrays = self._asks[message.header["ask"]](message)
        except Exception as error:  # FMPy raises many kinds for faults of the FMU
            if self._machine is not None:
                self._machine.forget()
            words = " ".join(str(error).split()) or type(error).__name__
            return packed({"error": words[:600], "refused": isinstance(error, FmuArchiveError)}, {})
        return packed(header, arrays)

    def _describe(self, message: ProcessMessage) -> tuple[dict[str, Any], Arrays]:
        file, folder = Path(message.header["file"]), Path(message.header["folder"])
        names = unpack(file, folder, DESCRIPTION)
        return {"described": read_description(folder, names).tree}, {}

    def _load(self, message: ProcessMessage) -> tuple[dict[str, Any], Arrays]:
        header = message.header
        file, folder = Path(header["file"]), Path(header["folder"])
        if digest_of(file) != header["digest"]:
            raise FmuRunError("the file has changed since it was added to the plant; start again")
        unpack(file, folder)
        compile_runs()
        described = described_from(header["described"])
        references = References(**header["references"])
        self._machine = machine_of(folder, described, header["kind"], references, header["places"])
        return {}, {}

    @property
    def _loaded(self) -> CoSimulation:
        if self._machine is None:
            raise FmuRunError("no FMU is loaded")
        return self._machine

    def _outputs(self, message: ProcessMessage) -> tuple[dict[str, Any], Arrays]:
        machine, arrays = self._loaded, message.arrays
        found = []
        for fixed, inputs in zip(arrays["fixed"].tolist(), arrays["inputs"].tolist(), strict=True):
            machine.put(fixed, inputs)
            found.append(machine.output())
        return {}, {"output": np.array(found)}

    def _ticks(self, message: ProcessMessage) -> tuple[dict[str, Any], Arrays]:
        """Advance from each of several points by one period: the output before, and the states after."""
        machine, arrays, header = self._loaded, message.arrays, message.header
        outputs, after = [], []
        for fixed, inputs in zip(arrays["fixed"].tolist(), arrays["inputs"].tolist(), strict=True):
            machine.put(fixed, inputs)
            outputs.append(machine.output())
            machine.move(header["period"], header["steps"])
            after.append(machine.states())
        shape = (len(outputs), len(machine.references.states))
        return {}, {"output": np.array(outputs), "after": np.array(after).reshape(shape)}

    def _rates(self, message: ProcessMessage) -> tuple[dict[str, Any], Arrays]:
        """Rates and outputs at each of several points."""
        machine, arrays = self._loaded, message.arrays
        if not isinstance(machine, ModelExchange):
            raise FmuRunError("a co-simulation FMU provides no derivatives")
        outputs, rates = [], []
        for fixed, inputs in zip(arrays["fixed"].tolist(), arrays["inputs"].tolist(), strict=True):
            machine.put(fixed, inputs)
            outputs.append(machine.output())
            rates.append(machine.rates())
        shape = (len(outputs), len(machine.references.states))
        return {}, {"output": np.array(outputs), "rates": np.array(rates).reshape(shape)}

    def _runs(self, message: ProcessMessage) -> tuple[dict[str, Any], Arrays]:
        """Whole runs from several points with the same signals, in closed loop or driven.

        The controller works in the plant's units: output and drive are converted with scale and offset.
        """
        header, arrays = message.header, message.arrays
        runs = [self._run(fixed, header, arrays) for fixed in arrays["fixed"].tolist()]
        names = ("output", "input", "states")
        return {}, {name: np.stack([run[k] for run in runs]) for k, name in enumerate(names)}

    def _run(self, fixed: list[float], header: Any, arrays: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        machine, gains = self._loaded, _gains(header["gains"])
        found = _compiled_run(machine, gains, fixed, header, arrays)
        if found is not None:
            return found
        (y_scale, y_offset), (u_scale, u_offset) = header["y"], header["u"]
        closed, period, steps = header["closed"], header["period"], header["steps"]
        integral, previous, resolution = header["integral"], header["previous"], header["resolution"]
        given, noise, frozen = (arrays[name].tolist() for name in ("given", "noise", "frozen"))
        others = arrays["disturbances"].tolist()
        outputs, inputs, states = [], [], []
        last = 0.0
        machine.put(fixed, [u_scale * header["rest"] + u_offset, *others[0]])
        for k, value in enumerate(given):
            states.append(machine.states())
            seen = y_scale * machine.output() + y_offset
            last = reading(seen, noise[k], bool(frozen[k]) and k > 0, resolution, last)
            u = value
            if closed:
                u, integral, previous = pid_step(gains, integral, previous, value, last)
            outputs.append(last)
            inputs.append(u)
            machine.feed([u_scale * u + u_offset, *others[k]])
            machine.move(period, steps)
        states.append(machine.states())
        shape = (len(states), len(machine.references.states))
        return np.array(outputs), np.array(inputs), np.array(states).reshape(shape)


def _compiled_run(
    machine: CoSimulation, gains: Gains, fixed: list[float], header: Any, arrays: Any
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """The run in compiled code; None if it has events."""
    given, others = arrays["given"], arrays["disturbances"]
    machine.put(fixed, [header["u"][0] * header["rest"] + header["u"][1], *others[0].tolist()])
    ready = machine.run_arguments()
    if ready is None:
        return None
    y, u = np.empty(given.size), np.empty(given.size)
    states = np.empty((given.size + 1, len(machine.references.states)))
    numbers = [header[name] for name in ("resolution", "integral", "previous", "period")]
    status = compiled_run(
        *ready, header["closed"], gains, given, others, arrays["noise"], arrays["frozen"],
        np.array([*numbers, *header["y"], *header["u"]], dtype=np.float64), header["steps"], y, u, states,
    )  # fmt: skip
    if status == EVENT:
        return None
    if status != DONE:
        raise FmuRunError(f"one of its functions returned status {status}")
    return y, u, states


def main() -> None:
    """Answer requests until standard input is closed, by a parent that ends."""
    folder = Path.cwd()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # keeps the FMU's own output out of the answers
    questions = os.fdopen(os.dup(0), "rb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    threading.Thread(target=_end_with, args=(os.getppid(), folder), daemon=True).start()
    worker = FmuWorker()
    _limit()
    while message := _next(questions):
        # If the parent has ended, nobody else ends an FMU that hangs and lets no other thread run.
        signal.alarm(math.ceil(min(message.header["limit"], _LONGEST)) + _GRACE)
        answers.write(worker.answer(message))
        answers.flush()
        signal.alarm(0)
    _leave(folder)


def _gains(values: list[float]) -> Gains:
    named: dict[str, Any] = dict(zip(Gains._fields, values, strict=True))
    return Gains(**{**named, "on_measurement": bool(named["on_measurement"])})


def _next(questions: BinaryIO) -> ProcessMessage | None:
    def read(size: int) -> bytes:
        found = questions.read(size)
        if len(found) < size:
            raise EOFError
        return found

    try:
        return unpacked(read)
    except EOFError:
        return None


def _limit() -> None:
    """Limit the memory and the file sizes of the FMU."""
    taken = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    for what, most in (
        (resource.RLIMIT_AS, taken + MEMORY),
        (resource.RLIMIT_FSIZE, MOST_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(what, (most, most))


def _end_with(parent: int, folder: Path) -> None:
    """Exit when the parent has ended, which a hanging FMU would not notice."""
    while os.getppid() == parent:
        select.select([], [], [], 1.0)
    _leave(folder)


def _leave(folder: Path) -> None:
    """Exit and leave nothing behind; the parent, which would have cleared up, has ended."""
    end_marked(os.environ[MARK])
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


if __name__ == "__main__":
    main()
