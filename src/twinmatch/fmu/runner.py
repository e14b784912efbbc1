"""An FMU in the plant's units: checked against its map, asked by its structure's kernels, its process run."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twinmatch.dynamics import StructureLostError
from twinmatch.dynamics.loop import Gains
from twinmatch.fmu.archive import CO_SIMULATION, MODEL_EXCHANGE, Described, FmuError, described_from
from twinmatch.fmu.mapping import FmuMap, Link
from twinmatch.fmu.process import START, FmuProcess, ProcessLostError
from twinmatch.signals import FloatArray

_SAMPLES = 1000
"""Most samples of one request; the map's `patience` applies to so many."""


def described_by(file: Path, process: FmuProcess, limit: float = START) -> Described:
    """Read the description of an FMU, without executing its code.

    Raises:
        FmuError: the file is not an FMU, or cannot be used.
    """
    if not file.is_file():
        raise FmuError(f"{file}: does not exist; give the path of an FMU")
    try:
        answer = process.ask(
            {"ask": "describe", "file": str(file.resolve()), "folder": str(process.folder / "description")},
            limit=limit,
        )
        return described_from(dict(answer.header["described"]))
    except ProcessLostError as error:
        raise FmuError(f"{file}: its description cannot be read: {error}") from error
    except (FmuError, KeyError, TypeError, ValueError) as error:
        raise FmuError(f"{file}: {error}") from error


def loading(of: FmuMap, described: Described) -> tuple[dict[str, Any], str]:
    """The request that loads the FMU, without the paths of its files; and its interface type.

    Raises:
        FmuError: the FMU does not match the map.
    """
    kind = of.kind or next(iter(described.kinds), "")
    if kind not in described.kinds:
        ways = " and ".join(described.kinds) or "neither model exchange nor co-simulation"
        raise FmuError(f"it supports {ways}" + (f", not {kind}" if kind else ""))
    plant, links = of.plant, of.links
    inputs = [links[plant.drive.name], *(links[name] for name in plant.disturbances if name in links)]
    states = [links[name] for name in of.known_states]
    parameters = [links[name] for name in of.known_parameters]
    output = [links[plant.output.name]]
    for link in (*output, *inputs, *states, *parameters):
        for name in (link.variable, link.set):
            if described.called(name) is None:
                raise FmuError(f"has no real variable {name!r}; `twinmatch fmu` lists those it has")
    _check_inputs(described, inputs)
    own = [v.name for v in sorted(described.variables, key=lambda v: v.state) if v.state >= 0]
    if kind == MODEL_EXCHANGE:
        _check_states(described, own, [link.variable for link in states])
    fixed = [*parameters, *states] if kind == CO_SIMULATION else parameters
    _check_settable(described, fixed)
    references = {"fixed": [link.set for link in fixed]}
    references |= {
        name: [link.variable for link in those]
        for name, those in (("inputs", inputs), ("states", states), ("output", output))
    }
    return {
        "ask": "load",
        "described": described.tree,
        "kind": kind,
        "references": {name: _references(described, names) for name, names in references.items()},
        "places": [own.index(link.variable) for link in states] if kind == MODEL_EXCHANGE else [],
    }, kind


def _references(described: Described, names: list[str]) -> list[int]:
    return [found.reference for name in names if (found := described.called(name)) is not None]


def _check_states(described: Described, own: list[str], named: list[str]) -> None:
    """Check that the map names all states of a model-exchange FMU, and no others."""
    left = [name for name in own if name not in named]
    other = [name for name in named if name not in own]
    if left or other or described.states != len(named):
        what = "the map does not name all of them"
        if left:
            what = f"the map does not name {left[0]!r}"
        elif other:
            what = f"the map names {other[0]!r}, which is not one of them"
        raise FmuError(f"its continuous states are {', '.join(own) or 'none'}; {what}")


def _check_inputs(described: Described, links: list[Link]) -> None:
    """Check that the plant's inputs are inputs of the FMU: it may ignore values of others."""
    for link in links:
        variable = described.called(link.set)
        if variable is not None and variable.causality != "input" and variable.variability != "tunable":
            given = f"{variable.causality}, variability {variable.variability or 'not given'}"
            inputs = ", ".join(one.name for one in described.of("input")) or "none"
            raise FmuError(f"its variable {link.set!r} is not an input ({given}); its inputs are {inputs}")


def _check_settable(described: Described, links: list[Link]) -> None:
    for link in links:
        variable = described.called(link.set)
        if variable is not None and not variable.settable:
            msg = f"its variable {link.set!r} cannot be set before a run"
            raise FmuError(f"{msg} ({variable.causality}, initial {variable.initial or 'not given'})")


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

    def outputs(self, fixed: FloatArray, drive: FloatArray, disturbances: FloatArray) -> FloatArray:
        """Outputs, shape (B,), at parameters and states, shape (B, n), and inputs, shape (B,) and (B, m)."""
        answer = self._ask({"ask": "outputs"}, fixed=self._own(fixed), inputs=self._fed(drive, disturbances))
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
