"""The process in which an FMU runs: reads requests from standard input, answers on its standard output.

An FMU is a program. Here it has its own folder, none of its parent's sockets, limits on memory and file size,
and exits with its parent. The parent enforces time limits. The kernels of `twinmatch.dynamics` run here, so
that only whole runs cross the border.
"""

from __future__ import annotations

import ctypes
import importlib
import math
import os
import resource
import select
import shutil
import signal
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

import numba
import numpy as np

from twinmatch.dynamics.kernels import Code
from twinmatch.dynamics.variances import foresee_each
from twinmatch.fmu import functions, machine
from twinmatch.fmu.archive import (
    CO_SIMULATION,
    MAX_BYTES,
    MODEL_EXCHANGE,
    Described,
    described_from,
    digest_of,
    read_description,
    unpack,
)
from twinmatch.fmu.mapping import Formula
from twinmatch.fmu.process import (
    MARK,
    START,
    ProcessMessage,
    end_marked,
    packed,
    tree_of,
    unpacked,
    value_of,
)
from twinmatch.settings import Rule

MEMORY: Final = 2 << 30
"""Memory that the FMU may use in addition to that of this process before loading, bytes."""


class _TimeLimit(Rule):
    """When the process ends itself, s."""

    grace: int = 10
    """Time after that of the request."""
    most: float = 1e8
    """Longest alarm that is set."""


_TIME_LIMIT: Final = _TimeLimit()


DESCRIPTION: Final = "modelDescription.xml"


class FmuRunError(Exception):
    """The FMU cannot be run, or violates FMI."""


class LoadedFmu:
    """An FMU whose library is loaded, as a plant for the kernels."""

    def __init__(self, folder: Path, load: Mapping[str, Any]) -> None:
        """Load it as a request says.

        Raises:
            FmuRunError: it cannot be loaded.
        """
        described = described_from(load["described"])
        kind = load["kind"]
        self._fmu = _instance(folder, described, kind)
        self._major = int(described.version[0])
        self._load = load
        self._m = len(load["parameters"])
        self._n = len(load["starts"])
        self._formulas = [
            Formula(f"start of a state of {described.name}", text)
            for text in load["starts"]
        ]
        references = {
            name: np.array(of_variables, dtype=np.uint32)
            for name, of_variables in load["references"].items()
        }
        self._memory = machine.memory_for(self._m, self._n, len(references["inputs"]))
        self.machine = machine.machine_of.py_func(*self._memory)  # type: ignore[attr-defined]
        self._kept = references, _RENEW(self._renew), _START(self._start)
        self.machine.functions[:] = [self._address(name) for name in machine.FUNCTIONS]
        head = self.machine.head[0]
        head.renew = ctypes.cast(self._kept[1], ctypes.c_void_p).value
        head.instance = self._fmu.component
        head.fmi_3 = self._major == 3
        head.exchange = kind == MODEL_EXCHANGE
        for name, of_variables in references.items():
            head[name] = of_variables.ctypes.data
        if kind == MODEL_EXCHANGE:
            if self._major == 2:
                head.n_indicators = described.indicators
            else:
                head.n_indicators = self._fmu.getNumberOfEventIndicators()
            self.machine.functions[machine.COMPLETED] *= described.after_steps
        self._set_numbers(load)
        self._owner, self._addresses = functions.functions_for(
            self._memory[0].ctypes.data,
            self._memory[1].ctypes.data,
            ctypes.cast(self._kept[2], ctypes.c_void_p).value or 0,
        )

    def _set_numbers(self, load: Mapping[str, Any]) -> None:
        """Give the machine the places of states and inputs, and the numbers of all its variables."""
        self.machine.places[:] = load["places"]
        self.machine.given[: len(load["given"])] = load["given"]
        arrays = ("factors", "offsets", "held", "sizes", "lowest", "highest")
        for name, numbers in zip(arrays, load["numbers"], strict=True):
            getattr(self.machine, name)[: len(numbers)] = numbers
        self.machine.head[0].rest = load["rest"]
        self.machine.head[0].sample = load["sample"]

    def code(self, unknown: list[int], shown: list[int]) -> Code:
        """The FMU for kernels, with derivatives by these of its parameters; `shown`: of the output, too."""
        self.machine.head[0].n_unknown = len(unknown)
        self.machine.unknown[: len(unknown)] = unknown
        self.machine.shown[: len(shown)] = shown
        return functions.code_for(self._addresses, self._m, self._n, len(unknown))

    def require_success(self) -> None:
        """Raises FmuRunError if one of its functions has reported an error."""
        error = machine.error_of(self.machine)
        if error:
            raise FmuRunError(error)

    def _address(self, name: str) -> int:
        name = machine.NAMES_3.get(name, name) if self._major == 3 else name
        function = (
            getattr(self._fmu.dll, f"fmi{self._major}{name}", None) if name else None
        )
        return (
            0
            if function is None
            else int(ctypes.cast(function, ctypes.c_void_p).value or 0)
        )

    def _renew(self) -> int:
        """Replace the instance, for an FMU that cannot be reset; returns a status."""
        try:
            getattr(self._fmu, f"fmi{self._major}FreeInstance")(self._fmu.component)
            self._fmu.instantiate()
        except Exception:  # FMPy raises many kinds
            return 3
        self.machine.head[0].instance = self._fmu.component
        return 0

    def _start(self, y: Any, u: Any, d: Any, p: Any, _: Any, out: Any) -> None:
        """Initial states at an output y after a drive u; their derivatives by y and by the unknowns."""
        output = self._load["signals"][0]
        names = self._load["parameters"]
        n = self._n
        values = self._values_at(float(y[0]), float(u[0]), d, p)
        reach = functions.WIDTH * (1.0 + abs(y[0]))
        unknown = self.machine.unknown[: self.machine.head[0].n_unknown].tolist()
        for i, formula in enumerate(self._formulas):
            out[i] = formula(values)
            out[n + i] = _slope(formula, values, output, (y[0] + reach, y[0] - reach))
            for j, k in enumerate(unknown):
                ends = functions.ends_of.py_func(self.machine, k, p[k])  # type: ignore[attr-defined]
                out[2 * n + i * len(unknown) + j] = _slope(
                    formula, values, names[k], ends
                )

    def _values_at(self, y: float, u: float, d: Any, p: Any) -> dict[str, float]:
        """Output, drive, disturbances and parameters by name, for the formulas of initial states."""
        output, drive, *disturbances = self._load["signals"]
        parameters = self._load["parameters"]
        values = {output: y, drive: u}
        values |= dict(zip(disturbances, d[: len(disturbances)], strict=True))
        values |= dict(zip(parameters, p[: len(parameters)], strict=True))
        return values


def _slope(
    formula: Formula, values: Mapping[str, float], name: str, ends: tuple[float, float]
) -> float:
    """The derivative of a formula by one of its values, from those at both ends, the higher one first."""
    high, low = ends
    rise = formula({**values, name: high}) - formula({**values, name: low})
    return float(rise / (high - low))


_RENEW: Final = ctypes.CFUNCTYPE(ctypes.c_int)
_START: Final = ctypes.CFUNCTYPE(None, *(ctypes.POINTER(ctypes.c_double),) * 6)


def _instance(folder: Path, described: Described, kind: str) -> Any:
    """Load the FMU's library and create an instance.

    Raises:
        FmuRunError: it has none for this machine, or that refuses.
    """
    from fmpy import fmi2, fmi3, platform, platform_tuple  # noqa: PLC0415

    major = int(described.version[0])
    machine_name = platform if major == 2 else platform_tuple
    if machine_name not in described.platforms:
        available = ", ".join(described.platforms) or "no platform"
        raise FmuRunError(
            f"it has binaries for {available}; this machine is {machine_name}"
        )
    classes = {
        2: (fmi2.FMU2Model, fmi2.FMU2Slave),
        3: (fmi3.FMU3Model, fmi3.FMU3Slave),
    }[major]
    identifier = described.identifiers[described.kinds.index(kind)]
    library = folder / "binaries" / machine_name / f"{identifier}.so"
    name = library.relative_to(folder)
    if not library.is_file():
        raise FmuRunError(
            f"it has no {name}, the program for this machine; export it again"
        )
    try:
        fmu = classes[kind == CO_SIMULATION](
            guid=described.guid,
            modelIdentifier=identifier,
            unzipDirectory=str(folder),
            instanceName="twinmatch",
            libraryPath=str(library),
        )
    except Exception as error:  # FMPy raises many kinds
        why = str(error).rpartition(f"{library}: ")[2]
        raise FmuRunError(
            f"its {name} is not a library for this machine: {why}"
        ) from error
    try:
        fmu.instantiate()
    except Exception as error:
        raise FmuRunError(
            f"it cannot be instantiated ({error}): is it complete, and its licence?"
        ) from error
    return fmu


class FmuWorker:
    """One FMU, and the requests it answers."""

    def __init__(self, answers: BinaryIO) -> None:
        self._answers = answers
        self._fmu: LoadedFmu | None = None
        self._asks: dict[str, Callable[[ProcessMessage], bytes]] = {
            "describe": self._describe,
            "load": self._load_fmu,
            "call": self._call,
        }

    def answer(self, message: ProcessMessage) -> None:
        """Answer a request; errors of the FMU are an answer too."""
        try:
            reply = self._asks[message.header["ask"]](message)
        except Exception as error:  # FMPy raises many kinds for faults of the FMU
            words = " ".join(str(error).split()) or type(error).__name__
            reply = packed({"error": words[:600]})
        self._say(reply)

    def _say(self, message: bytes) -> None:
        self._answers.write(message)
        self._answers.flush()

    def _describe(self, message: ProcessMessage) -> bytes:
        file = Path(message.header["file"])
        folder = Path(message.header["folder"])
        names = unpack(file, folder, DESCRIPTION)
        return packed({"described": read_description(folder, names).tree})

    def _load_fmu(self, message: ProcessMessage) -> bytes:
        file = Path(message.header["file"])
        folder = Path(message.header["folder"])
        if digest_of(file) != message.header["digest"]:
            raise FmuRunError(
                "the file has changed since it was added to the plant; start again"
            )
        unpack(file, folder)
        self._fmu = LoadedFmu(folder, message.header)
        return packed({})

    def _call(self, message: ProcessMessage) -> bytes:
        """The results of a kernel, and the arrays that it has changed."""
        if self._fmu is None:
            raise FmuRunError("no FMU is loaded")
        header = message.header
        arrays = message.arrays
        kernel = _named(header["kernel"])
        before = [array.tobytes() for array in arrays]
        owners = (self._fmu.machine,) if kernel is functions.normal_at else ()
        arguments = value_of(header["arguments"], arrays, _named)
        code = self._fmu.code(header["unknown"], header["shown"])
        if kernel is foresee_each:  # of several plants, of which this is the only one
            code = code[np.newaxis]
        whole = (code, *owners, *arguments)
        kinds = tuple(map(numba.typeof, whole))
        if kinds not in kernel.overloads:
            self._say(packed({"loading": True}))
            signal.alarm(
                math.ceil(min(2 * header["limit"] + START, _TIME_LIMIT.most))
                + _TIME_LIMIT.grace
            )
            kernel.compile(kinds)
            self._say(packed({"loading": False}))
        result = kernel(*whole)
        self._fmu.require_success()
        changed = [i for i, was in enumerate(before) if arrays[i].tobytes() != was]
        sent = [arrays[i] for i in changed]
        return packed({"changed": changed, "found": tree_of(result, sent)}, sent)


def _named(name: str) -> Any:
    """A kernel, or the class of an argument, by module and name."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


def main() -> None:
    """Answer requests until standard input is closed, by a parent that ends."""
    folder = Path.cwd()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # keeps the FMU's own output out of the answers
    questions = os.fdopen(os.dup(0), "rb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    threading.Thread(target=_end_with, args=(os.getppid(), folder), daemon=True).start()
    worker = FmuWorker(answers)
    _limit()
    with suppress(EOFError):
        while True:
            message = unpacked(lambda size: _read(questions, size))
            # If the parent has ended, nobody else ends an FMU that hangs and lets no other thread run.
            signal.alarm(
                math.ceil(min(message.header["limit"], _TIME_LIMIT.most))
                + _TIME_LIMIT.grace
            )
            worker.answer(message)
            signal.alarm(0)
    _leave(folder)


def _read(questions: BinaryIO, size: int) -> bytes:
    part = questions.read(size)
    if len(part) < size:
        raise EOFError
    return part


def _limit() -> None:
    """Limit the memory and the file sizes of the FMU."""
    used = (
        int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        * resource.getpagesize()
    )
    for limit, most in (
        (resource.RLIMIT_AS, used + MEMORY),
        (resource.RLIMIT_FSIZE, MAX_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(limit, (most, most))


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
