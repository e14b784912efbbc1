"""FMUs added to a plant as structures, with the kernels of native equations, which run in their processes.

The name of such a structure contains the first digits of a hash of FMU and map, so that the name in a verdict
identifies the program.
"""

from __future__ import annotations

import hashlib
import sys
import threading
from collections.abc import Iterable, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from twinmatch.dynamics import (
    Model,
    Parameters,
    Structure,
    StructureLostError,
    begin,
    kernels,
    runs,
    simulate_driven,
    variances,
)
from twinmatch.dynamics.descent import Search, update_search
from twinmatch.dynamics.pace import plant_scale
from twinmatch.dynamics.runs import LeastSquares
from twinmatch.dynamics.store import KERNELS
from twinmatch.fmu.archive import (
    MAX_BYTES,
    MODEL_EXCHANGE,
    Described,
    FmuError,
    described_from,
    digest_of,
)
from twinmatch.fmu.mapping import FmuMap, loading, read_maps, sample_time
from twinmatch.fmu.process import (
    START,
    FmuMessageError,
    FmuProcess,
    ProcessLostError,
    tree_of,
    value_of,
)
from twinmatch.plants.records import MARK
from twinmatch.settings import Rule
from twinmatch.signals import FloatArray

_SAMPLES = 1000
"""Samples that one FMU's `patience` is for."""
_FINITE: Final = {"advance", "advance_side_by_side", "run", "run_with_tangents"}
"""Kernels whose results are refused unless all are finite."""
_ANSWERED: Final = {
    f"{kind.__module__}:{kind.__name__}": kind for kind in (runs.Start, runs.Tangents)
}
"""Classes of values that an answer may have."""
TESTED: Final = 300.0
"""Time over which memory is looked for, s, on a plant with a time constant of 100 s."""


class _RestartTest(Rule):
    """The test whether an FMU can be restarted from its states."""

    short: int = 8
    """Samples with drives that stay away from their limits, in the test."""
    tolerance: float = 1e-4
    """Tolerance of a state, in units of its span: a restarted solver chooses other steps."""


_RESTART: Final = _RestartTest()


def check_restart(model: Model) -> None:
    """Simulate several time constants in one run, and again with restarts from its states: at every sample
    for that sample, and at each quarter for all that follows; all must agree.

    Forecasts start from states that an observer has estimated. An FMU with internal states that its map does
    not name, such as a filter, a switch with hysteresis or a slow wall, would then give wrong forecasts.

    Raises:
        FmuError: they disagree, or the FMU has no finite values.
    """
    plant = model.plant
    parameters = model.parameters()
    period = sample_time(model.plant)
    size = round(TESTED * plant_scale(plant, period) / period)
    low, high = plant.drive.limits
    ends = 0.5 * (plant.drive.rest + np.array([high, low]))
    drive = np.concatenate(
        [np.repeat(ends, _RESTART.short // 2), np.repeat([high, low], size // 2)]
    )
    y = float(np.mean(plant.output.set_points or plant.output.span))
    run = simulate_driven(parameters, drive, states=begin(parameters, y), period=period)
    for first, last in _stretches_of(drive):
        after, outputs = _restarted_each(
            parameters, run.states[first:last], drive[first], period, run.steps
        )
        for k in range(first, min(last, drive.size - 1)):
            _require_same(
                model,
                outputs[k - first, 0],
                run.output[k + 1],
                after[k - first],
                run.states[k + 1],
            )
    for k in (drive.size // 4, drive.size // 2, 3 * drive.size // 4):
        restarted = simulate_driven(
            parameters, drive[k:], states=run.states[k], period=period
        )
        for j in range(drive.size - k):
            _require_same(
                model,
                restarted.output[j],
                run.output[k + j],
                restarted.states[j],
                run.states[k + j],
            )


def _stretches_of(drive: FloatArray) -> list[tuple[int, int]]:
    """The first sample of each stretch with one drive, and the first after it."""
    changes = np.flatnonzero(np.diff(drive)) + 1
    edges = [0, *changes.tolist(), drive.size]
    return list(pairwise(edges))


def _restarted_each(
    parameters: Parameters, states: FloatArray, drive: float, period: float, steps: int
) -> tuple[FloatArray, FloatArray]:
    """The states, shape (k, n), a sample after each of some states, and the outputs then, shape (k, 1).

    From the last to the first, so that what an FMU remembers is never what it would remember in one run.
    """
    model = parameters.model
    vectors = np.tile(parameters.vector, (len(states), 1))
    backwards = np.ascontiguousarray(states[::-1])
    after, outputs = model.kernels.advance_side_by_side(
        vectors, backwards, np.array([drive]), model.disturbances, period, steps
    )
    return after[::-1], outputs[::-1]


def _require_same(
    model: Model, output: float, expected: float, states: FloatArray, wanted: FloatArray
) -> None:
    spans = np.array([state.span[1] - state.span[0] for state in model.declared_states])
    deviations = np.abs(states - wanted) / spans if spans.size else np.zeros(1)
    if (
        abs(output - expected) <= model.plant.output.noise
        and deviations.max() <= _RESTART.tolerance
    ):
        return
    difference = f"its output {output:g} instead of {expected:g}"
    if deviations.max() > _RESTART.tolerance:
        worst = int(np.argmax(deviations))
        difference = (
            f"{model.states[worst]} {states[worst]:g} instead of {wanted[worst]:g}"
        )
    raise FmuError(
        f"{model.title}: restarted from its states, the FMU has {difference}; it has internal states that "
        "its map does not name: name all, or export it without them"
    )


def _insensitive(model: Model) -> frozenset[int]:
    """Indices of the free parameters by which the output at given states has no derivative at all.

    For co-simulation each of these derivatives would cost two starts of the FMU.
    """
    output = model.plant.output
    free = model.structure.free
    states = begin(model.parameters(), float(np.mean(output.set_points or output.span)))
    point = model.parameters().vector, states, model.rest, model.disturbances
    try:
        by_parameters = model.kernels_by(free).slopes_at(*point)[5]
    except FmuError:  # a match will tell
        return frozenset()
    none = np.flatnonzero((by_parameters == 0.0).all(axis=0)).tolist()
    return frozenset(model.names.index(free[k]) for k in none)


class FmuKernels:
    """The kernels of `twinmatch.dynamics`, run in an FMU's process, with derivatives by some parameters."""

    QUANTITIES: Final[tuple[str, ...]] = ()
    RATE_LIMIT = kernels.RATE_LIMIT
    MAX_STEPS = kernels.MAX_STEPS

    def __init__(self, source: FmuSource, unknown: tuple[str, ...]) -> None:
        self._source = source
        self.UNKNOWN = unknown
        self.STATES = source.map.known_states
        self.PARAMETERS = source.map.known_parameters
        self._unknown = [self.PARAMETERS.index(name) for name in unknown]
        for kernel in KERNELS:
            if not hasattr(self, kernel.__name__):
                setattr(self, kernel.__name__, partial(self.call, kernel))

    def call(self, kernel: Any, *arguments: Any) -> Any:
        """The results of a kernel."""
        evaluations = (
            1
            if kernel.__name__ == "run"
            else 1 + 4 * (len(self.UNKNOWN) + len(self.STATES) + 1)
        )
        name = f"{kernel.__module__}:{kernel.__name__}"
        result = self._source.ask(name, self._unknown, arguments, evaluations)
        if kernel.__name__ in _FINITE:
            self._require_finite(result)
        return result

    def _require_finite(self, result: Any) -> None:
        if not all(np.isfinite(array).all() for array in _arrays(result)):
            raise FmuError(
                f"{self._source.title}: the FMU has no finite values at these parameters"
            )

    def foresee_each(  # noqa: PLR0917
        self,
        sizes: NDArray[np.int64],
        vectors: FloatArray,
        which: NDArray[np.int64],
        states: FloatArray,
        covariances: FloatArray,
        process_noise: FloatArray,
        steps: NDArray[np.int64],
        wanted: NDArray[np.int64],
        *others: Any,
    ) -> tuple[FloatArray, FloatArray]:
        """As `twinmatch.dynamics.variances.foresee_each`, of this FMU alone."""
        given = (
            sizes,
            vectors,
            which,
            states,
            covariances,
            process_noise,
            steps,
            wanted,
            *others,
        )
        means: FloatArray
        spreads: FloatArray
        means, spreads = self.call(variances.foresee_each, *given)
        self._require_finite(means)
        if wanted[0] == variances.BANDED:  # otherwise they are NaN
            self._require_finite(spreads)
        return means, spreads

    def step_count(self, *arguments: Any) -> int:
        """Runge–Kutta steps per sample; 1 for co-simulation."""
        return int(self.call(kernels.step_count, *arguments)) if self._exchange else 1

    def start_at(self, problem: LeastSquares, values: FloatArray) -> Any:
        """As `twinmatch.dynamics.runs.start_at`."""
        return self.call(runs.start_at, self._single_step(problem), values)

    def normal_at(self, problem: LeastSquares, values: FloatArray, limit: float) -> Any:
        """As `twinmatch.dynamics.runs.normal_at`."""
        arguments = self._single_step(problem), values, limit
        return self._source.ask(
            "twinmatch.fmu.functions:normal_at", [], arguments, 1 + 2 * values.size
        )

    def search(self, problem: LeastSquares, state: Search) -> None:
        """Let a search run to its end, one request for each point."""
        is_asking = True
        while is_asking:
            normal = self.normal_at(problem, state.point, float(state.best[0]))
            is_asking = update_search(state, *normal)

    @property
    def _exchange(self) -> bool:
        return self._source.kind == MODEL_EXCHANGE

    def _single_step(self, problem: LeastSquares) -> LeastSquares:
        """With one step per sample for co-simulation: no corners at which the fastest rate is searched."""
        return (
            problem if self._exchange else problem._replace(corners=problem.corners[:0])
        )


def _arrays(result: Any) -> list[Any]:
    return (
        [result]
        if not isinstance(result, tuple)
        else [array for member in result for array in _arrays(member)]
    )


class FmuSource:
    """The implementation of a structure that is an FMU; see `twinmatch.dynamics.ExternalEquations`.

    Its process is started by the first request, and abandoned for good when it is lost.
    """

    def __init__(self, fmu: FmuMap, name: str, digest: str) -> None:
        """Begin without a process; `digest` is the hash of the FMU that was given."""
        self.map = fmu
        self.title = f"{fmu.plant.title}, {name}"
        self.parameters = fmu.parameters
        self.states = fmu.states
        self.lost = ""
        """Why it can no longer be run; empty while it can."""
        self.in_use = False
        """Whether a loss is reported: it has passed all checks."""
        self.hidden: frozenset[int] = frozenset()
        """Indices of the parameters that act on the output through the states only, as far as is known."""
        self._digest = digest
        self._process: FmuProcess | None = None
        self._lock = threading.RLock()
        self._kind = ""

    def kernels_by(self, unknown: Iterable[str]) -> FmuKernels:
        """Its kernels with derivatives by these parameters."""
        return FmuKernels(self, tuple(unknown))

    @property
    def kind(self) -> str:
        """Interface type; the first use starts the process."""
        if not self._kind:
            self.start()
        return self._kind

    def start(self) -> FmuProcess:
        """Its process, started if it is not running.

        Raises:
            FmuError: the FMU cannot be loaded, or does not fit its map.
            StructureLostError: it was abandoned.
        """
        with self._lock:
            if self.lost:
                raise StructureLostError(f"{self.title}: {self.lost}")
            self._process = self._process or self._start()
            return self._process

    def close(self) -> None:
        """Stop its process; the next request starts another one."""
        with self._lock:
            if self._process is not None:
                self._process.close()
                self._process = None

    def lose(self, why: str) -> StructureLostError:
        """Abandon it permanently, with one message once it is in use; returns the error to raise."""
        with self._lock:
            self.lost = self.lost or why
            if self.in_use:
                self.in_use = False
                print(
                    f"twinmatch: {self.title}: {why}; everything else continues without this structure",
                    file=sys.stderr,
                )
            self.close()
        return StructureLostError(f"{self.title}: {self.lost}")

    def ask(
        self,
        kernel: str,
        unknown: list[int],
        arguments: tuple[Any, ...],
        evaluations: int,
    ) -> Any:
        """The results of a kernel, by module and name, which takes each sample about `each` times.

        Arrays that it changes are changed.

        Raises:
            FmuError: the FMU reports an error.
            StructureLostError: its process is lost.
        """
        arrays: list[NDArray[Any]] = []
        header = {
            "ask": "call",
            "kernel": kernel,
            "unknown": unknown,
            "shown": [int(k not in self.hidden) for k in unknown],
            "arguments": tree_of(arguments, arrays),
        }
        samples = evaluations * max((len(array) for array in arrays), default=1)
        limit = self.map.own.patience * max(samples / _SAMPLES, 1.0)
        with self._lock:
            process = self.start()
            try:
                answer = process.ask(header, arrays, limit=limit)
                result = value_of(
                    answer.header["found"], answer.arrays, _ANSWERED.__getitem__
                )
                changed = dict(
                    zip(answer.header["changed"], answer.arrays, strict=False)
                )
                if any(array.shape != arrays[k].shape for k, array in changed.items()):
                    raise FmuMessageError("an array of another shape")
            except ProcessLostError as error:
                raise self.lose(f"the FMU is lost: {error}") from error
            except FmuError as error:
                raise FmuError(f"{self.title}: the FMU reports: {error}") from error
            except (FmuMessageError, KeyError, IndexError, TypeError) as error:
                raise self.lose(
                    f"the FMU's process gave an invalid answer: {error}"
                ) from error
        for k, array in changed.items():
            arrays[k][...] = array
        return result

    def _start(self) -> FmuProcess:
        """Start the process and load the FMU, after a check against its map."""
        fmu = self.map
        process = FmuProcess()
        try:
            question, self._kind = loading(fmu, described_by(fmu.file, process))
            files = {
                "file": str(fmu.file.resolve()),
                "folder": str(process.folder / "fmu"),
            }
            process.ask({**question, **files, "digest": self._digest}, limit=START)
        except ProcessLostError as error:
            process.close()
            raise FmuError(
                f"{fmu.place}: {fmu.file} cannot be loaded: {error}"
            ) from error
        except FmuError as error:
            process.close()
            raise FmuError(f"{fmu.place}: {error}") from error
        return process


def unmarked(structure: str) -> str:
    """The name of a structure in its map, without the hash."""
    return MARK.sub("", structure)


def adopt_fmus(file: Path) -> tuple[Model, ...]:
    """Add the FMUs of a map file to its plant as structures; each is loaded and checked.

    Call it only if the user has allowed these programs to run.

    Raises:
        FmuError: the file or an FMU cannot be used.
        PlantError: a structure is not valid for the plant.
    """
    return tuple(_adopt(fmu) for fmu in read_maps(file))


def _adopt(fmu: FmuMap) -> Model:
    digest = _digest(fmu)
    name = f"{fmu.name} (FMU {_mark(fmu, digest)})"
    structure = fmu.plant.structures.get(name)
    if (
        structure is not None
        and structure.external is not None
        and not structure.external.lost
    ):
        return fmu.plant.model(name)
    for outdated in [
        n for n in fmu.plant.structures if unmarked(n) == fmu.name and n != fmu.name
    ]:
        fmu.plant.disown(outdated)
    source = FmuSource(fmu, name, digest)
    model = fmu.plant.adopt(
        name,
        Structure(
            free=fmu.own.free,
            fixed=fmu.own.fixed,
            free_starts=fmu.own.free_starts,
            starts=fmu.searches,
            watched=fmu.own.watched,
            text=f"FMU {fmu.file.name}",
            external=source,
        ),
    )
    try:
        source.start()
        check_restart(model)
        source.hidden = _insensitive(model)
        source.in_use = True
    except BaseException:
        fmu.plant.disown(name)
        raise
    return model


def _digest(fmu: FmuMap) -> str:
    if not fmu.file.is_file():  # a pipe or a device would never end
        raise FmuError(
            f"{fmu.place}: {fmu.file} does not exist or is not a file; give the path of an FMU"
        )
    try:
        if fmu.file.stat().st_size > MAX_BYTES:
            raise FmuError(
                f"{fmu.place}: {fmu.file} is larger than the limit of {MAX_BYTES >> 20} MiB"
            )
        return digest_of(fmu.file)
    except OSError as error:
        raise FmuError(
            f"{fmu.place}: {fmu.file} cannot be read: {error.strerror}"
        ) from error


def _in_order(table: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Names and values, in an order that does not depend on the file's."""
    return sorted((name, repr(value)) for name, value in table.items())


def _mark(fmu: FmuMap, digest: str) -> str:
    """First digits of a hash of the FMU and its map, without the path of the file."""
    formulas = {name: formula.text for name, formula in fmu.starts.items()}
    contents = (
        digest,
        fmu.own.kind,
        _in_order(fmu.links),
        _in_order(formulas),
        fmu.own.free,
        _in_order(fmu.own.fixed),
        fmu.own.free_starts,
        _in_order(fmu.parameters),
        _in_order(fmu.states),
    )
    return hashlib.sha256(repr(contents).encode()).hexdigest()[:8]


def described_by(file: Path, process: FmuProcess) -> Described:
    """Read the description of an FMU, without executing its code.

    Raises:
        FmuError: the file is not an FMU, or cannot be used.
    """
    if not file.is_file():
        raise FmuError(f"{file}: does not exist; give the path of an FMU")
    try:
        asked = {
            "file": str(file.resolve()),
            "folder": str(process.folder / "description"),
        }
        answer = process.ask({"ask": "describe", **asked}, limit=START)
        return described_from(dict(answer.header["described"]))
    except ProcessLostError as error:
        raise FmuError(f"{file}: its description cannot be read: {error}") from error
    except (FmuError, KeyError, TypeError, ValueError) as error:
        raise FmuError(f"{file}: {error}") from error
