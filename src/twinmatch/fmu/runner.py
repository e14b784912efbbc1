"""An FMU in the plant's units: the requests of a structure's kernels, and the management of its process."""

from __future__ import annotations

import sys
import threading
from typing import Any, NamedTuple

import numpy as np

from twinmatch.dynamics import StructureLostError
from twinmatch.dynamics.pid_step import Gains
from twinmatch.fmu.errors import FmuError
from twinmatch.fmu.fitting import described_by, loading
from twinmatch.fmu.mapping import FmuMap
from twinmatch.fmu.process import START, FmuProcess, ProcessLostError
from twinmatch.signals import FloatArray

__all__ = ["Runner", "Signals"]

_SAMPLES = 1000
"""Most samples of one request; the map's `patience` applies to so many."""


class Signals(NamedTuple):
    """Inputs of the runs, sample by sample, in the plant's units."""

    closed: bool
    gains: Gains
    given: FloatArray
    """Set-points of the loop, or inputs, shape (N,)."""
    disturbances: FloatArray
    """Shape (N, m)."""
    noise: FloatArray
    frozen: FloatArray
    resolution: float
    integral: float
    previous: float
    period: float
    steps: int


class Runner:
    """The FMU of a map: started by the first request, and abandoned when its process is lost."""

    def __init__(self, of: FmuMap, title: str, digest: str) -> None:
        """Start without a process.

        Args:
            of: the map of its variables.
            title: name of the structure in messages.
            digest: SHA-256 of the file; a file with another one is not run.
        """
        self.map, self.title, self._digest = of, title, digest
        self.lost = ""
        """Why it was abandoned; empty while it is usable."""
        self.in_use = False
        """Whether it was adopted: before, the error of `adopt_fmus` is the report."""
        self._process: FmuProcess | None = None
        self._lock = threading.RLock()
        links, plant = of.links, of.plant
        inputs = [plant.drive.name, *(name for name in plant.disturbances if name in links)]
        self._given = [k for k, name in enumerate(plant.disturbances) if name in links]
        self._output, self._inputs = links[plant.output.name], [links[name] for name in inputs]
        self._states = [links[name] for name in of.known_states]
        self._fixed = [*(links[name] for name in of.known_parameters), *self._states]
        self._factors = np.array([link.factor for link in self._fixed])
        self._offsets = np.array([link.offset for link in self._fixed])
        self.kind = ""
        """Interface type, after the first start."""

    def start(self) -> None:
        """Start its process, if it is not running.

        Raises:
            FmuError: the FMU cannot be loaded, or does not fit its map.
            StructureLostError: it was abandoned.
        """
        if self.lost:
            raise StructureLostError(f"{self.title}: {self.lost}")
        with self._lock:
            if self._process is None:
                self._started()

    def look(self, fixed: FloatArray, drive: FloatArray, disturbances: FloatArray) -> FloatArray:
        """Outputs, shape (B,), at parameters and states, shape (B, n), and inputs, shape (B,) and (B, m)."""
        answer = self._ask({"ask": "look"}, fixed=self._own(fixed), inputs=self._fed(drive, disturbances))
        return self._seen(answer)

    def ticks(
        self, fixed: FloatArray, drive: FloatArray, disturbances: FloatArray, period: float, steps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Advance each by one period: outputs before, shape (B,), and states after, shape (B, nx)."""
        header = {"ask": "ticks", "period": period, "steps": steps}
        answer = self._ask(header, fixed=self._own(fixed), inputs=self._fed(drive, disturbances))
        return self._seen(answer), self._moved(answer["after"])

    def rates(
        self, fixed: FloatArray, drive: FloatArray, disturbances: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Outputs, shape (B,), and derivatives of the states of a model-exchange FMU, shape (B, nx)."""
        answer = self._ask({"ask": "rates"}, fixed=self._own(fixed), inputs=self._fed(drive, disturbances))
        scale = np.array([link.factor for link in self._states])
        return self._seen(answer), answer["rates"] * scale

    def runs(self, fixed: FloatArray, signals: Signals) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Outputs and inputs, shape (B, N), and states, shape (B, N + 1, nx), of B runs."""
        drive = self._inputs[0]
        header = {
            "ask": "runs",
            "closed": bool(signals.closed),
            "gains": [float(value) for value in signals.gains],
            "y": [self._output.factor, self._output.offset],
            "u": [1.0 / drive.factor, -drive.offset / drive.factor],
            "rest": float(self.map.plant.drive.rest),
            **{n: float(getattr(signals, n)) for n in ("integral", "previous", "resolution", "period")},
            "steps": int(signals.steps),
        }
        answer = self._ask(
            header,
            fixed=self._own(fixed),
            given=signals.given,
            disturbances=self._others(signals.disturbances),
            noise=signals.noise,
            frozen=signals.frozen.astype(np.float64),
        )
        return answer["output"], answer["input"], self._moved(answer["states"])

    def close(self) -> None:
        """Stop its process; the next request starts another one."""
        with self._lock:
            if self._process is not None:
                self._process.close()
                self._process = None

    def lose(self, why: str) -> StructureLostError:
        """Abandon it permanently, with one message once it is in use; returns the error to raise."""
        with self._lock:
            if not self.lost:
                self.lost = why
            if self.in_use:
                self.in_use = False
                print(
                    f"twinmatch: {self.title}: {why}; everything else continues without this structure",
                    file=sys.stderr,
                )
            self.close()
        return StructureLostError(f"{self.title}: {self.lost}")

    def _ask(self, header: dict[str, Any], **arrays: FloatArray) -> dict[str, FloatArray]:
        """The answer to a request, split into parts, each with its own time limit."""
        samples = arrays["given"].size if "given" in arrays else 1
        rows, each = len(arrays["fixed"]), max(1, _SAMPLES // max(samples, 1))
        by_row = [name for name in ("fixed", "inputs") if name in arrays]
        parts = []
        if not rows:  # the derivatives of a structure without free parameters
            given = arrays.get("given")
            return {name: np.empty(shape) for name, shape in self._shapes(0, given).items()}
        for first in range(0, rows, each):
            part: dict[str, FloatArray] = {name: arrays[name][first : first + each] for name in by_row}
            parts.append(self._answer(header, {**arrays, **part}, max(samples / _SAMPLES, 1.0)))
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _answer(
        self, header: dict[str, Any], arrays: dict[str, FloatArray], share: float
    ) -> dict[str, FloatArray]:
        if self.lost:
            raise StructureLostError(f"{self.title}: {self.lost}")
        with self._lock:
            try:
                process = self._process or self._started()
                found = process.ask(header, arrays, limit=share * self.map.patience).arrays
            except ProcessLostError as error:
                raise self.lose(f"the FMU is lost: {error}") from error
            except FmuError as error:
                raise FmuError(f"{self.title}: the FMU reports: {error}") from error
        return self._checked(found, len(arrays["fixed"]), arrays.get("given"))

    def _checked(self, found: Any, runs: int, given: FloatArray | None) -> dict[str, FloatArray]:
        """The arrays, after a check of their shapes."""
        shapes = self._shapes(runs, given)
        for name, array in found.items():
            if array.shape != shapes.get(name):
                raise self.lose(f"the FMU's process answered with an array of shape {array.shape}")
        return dict(found)

    def _shapes(self, runs: int, given: FloatArray | None) -> dict[str, tuple[int, ...]]:
        """Shapes of the arrays in an answer, with and without signals."""
        n = len(self._states)
        if given is None:
            return {"output": (runs,), "after": (runs, n), "rates": (runs, n)}
        return {
            "output": (runs, given.size), "input": (runs, given.size), "states": (runs, given.size + 1, n),
        }  # fmt: skip

    def _started(self) -> FmuProcess:
        """Start the process and load the FMU, after a check against its map.

        Raises:
            FmuError: the FMU cannot be loaded, or does not fit its map.
        """
        of, process = self.map, FmuProcess()
        try:
            question, self.kind = loading(of, described_by(of.file, process))
            files = {"file": str(of.file.resolve()), "folder": str(process.folder / "fmu")}
            process.ask({**question, **files, "digest": self._digest}, limit=START)
        except ProcessLostError as error:
            process.close()
            raise FmuError(f"{of.place}: {of.file} cannot be loaded: {error}") from error
        except FmuError as error:
            process.close()
            raise FmuError(f"{of.place}: {error}") from error
        self._process = process
        return process

    def _seen(self, answer: dict[str, FloatArray]) -> FloatArray:
        return np.asarray(self._output.factor * answer["output"] + self._output.offset)

    def _own(self, fixed: FloatArray) -> FloatArray:
        return np.asarray((fixed - self._offsets) / self._factors)

    def _fed(self, drive: FloatArray, disturbances: FloatArray) -> FloatArray:
        link = self._inputs[0]
        return np.column_stack([(drive - link.offset) / link.factor, self._others(disturbances)])

    def _others(self, disturbances: FloatArray) -> FloatArray:
        links = self._inputs[1:]
        offsets, factors = (np.array([getattr(link, n) for link in links]) for n in ("offset", "factor"))
        return np.asarray((disturbances[:, self._given] - offsets) / factors)

    def _moved(self, states: FloatArray) -> FloatArray:
        count = len(self._states)
        if not count:
            return states
        return np.asarray(states * self._factors[-count:] + self._offsets[-count:])
