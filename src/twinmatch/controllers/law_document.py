"""A law as a document: gains of PIDs, two levels, matrices, or the observer and weights of a regulator.

Every document may name `outputs` and `inputs`, in its own order of signals, `units` by signal, and the
`period`. What it says of them is compared with the plant and the session; nothing is reordered or converted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, Final

import msgspec
import numpy as np

from twinmatch.controllers.answer import ControllerError
from twinmatch.decoding import decoded, document_type, given_keys
from twinmatch.dynamics import Law, LinearLaw, PidGains, Plant, TwoLevel
from twinmatch.dynamics.pids import GREATEST, FilteredPid, pid_law
from twinmatch.signals import FloatArray

_Numbers = float | list[float | list[float]]


class _About(msgspec.Struct):
    """What any law may say of its signals, and of how often it runs."""

    outputs: list[str] | None = None
    inputs: list[str] | None = None
    units: dict[str, str] = {}
    period: float | None = None


_ABOUT: Final = {"kind", *_About.__struct_fields__}
_REGULATOR: Final = ("A", "B", "C", "Bd", "Cd", "K", "u0", "y0", "Qs", "Rs")
_MATRICES: Final = [
    field.name for field in fields(LinearLaw) if field.name not in {"period", "drives"}
]
_LEVELS: Final = [field for field in fields(TwoLevel) if field.name != "period"]
_GAINS: Final = [
    field.name for field in fields(FilteredPid) if field.name != "proportional"
]
_VECTORS: Final = {"offset", "shift", "low", "high", "u0", "y0"}
_Pid: Final = document_type(["proportional"], _GAINS)
_Loops: Final = document_type(["loops"], kind=list[dict[str, Any]])
_TwoLevel: Final = document_type(
    (field.name for field in _LEVELS if field.default is MISSING),
    (field.name for field in _LEVELS if field.default is not MISSING),
)
_StateSpace: Final = document_type(_MATRICES[:5], _MATRICES[5:], _Numbers)
_Regulator: Final = document_type(_REGULATOR, ("Re", "low", "high"), _Numbers)


def law_from(document: Any, plant: type[Plant], period: float) -> Law:
    """The law that a document describes, for a plant at a sample time, s.

    Without limits in the document, they are those of the plant's drives.

    Raises:
        ControllerError: a key is unknown or missing, a value has another type, or the document is for other
            signals, units or another period.
        PlantError: the law itself is not possible.
    """
    if not isinstance(document, Mapping):
        raise ControllerError(
            "is not an object of keys and values; give one with the key kind"
        )
    kind = document.get(
        "kind", "regulator" if document.keys() >= {*_REGULATOR} else None
    )
    makers = {
        "pid": _pid,
        "two-level": _two_level,
        "state-space": _state_space,
        "regulator": _regulator,
    }
    if not isinstance(kind, str) or kind not in makers:
        raise ControllerError(
            f"kind: {kind!r:.80} is not a kind of law; give one of {', '.join(makers)}"
        )
    about = _read(_About, document)
    _check_about(about, plant)
    law_keys = {}
    for key, value in document.items():
        if key not in _ABOUT:
            law_keys[key] = value.tolist() if isinstance(value, np.ndarray) else value
    law = makers[kind](
        law_keys, plant, period if about.period is None else about.period
    )
    return suited(law, plant, period)


def suited(law: Law, plant: type[Plant], period: float) -> Law:
    """The law itself, if it is one for a plant and a sample time, s.

    Raises:
        ControllerError: it is for other numbers of signals.
        PlantError: it is for another sample time.
    """
    n_outputs = len(plant.outputs)
    n_inputs = len(plant.drives)
    if (
        law.n_outputs != n_outputs
        or law.n_inputs != n_inputs
        or law.n_references != n_outputs
    ):
        raise ControllerError(
            f"is a law for {law.n_outputs} outputs, {law.n_references} set-points and {law.n_inputs} inputs; "
            f"plant {plant.name} has {n_outputs} outputs ({', '.join(plant.outputs)}) and {n_inputs} inputs "
            f"({', '.join(plant.drives)})"
        )
    law.require_period(period)
    return law


def pid_document(gains: PidGains) -> dict[str, Any]:
    """The document of a PID."""
    pid = FilteredPid.of(gains)
    values = {gain.name: getattr(pid, gain.name) for gain in fields(pid)}
    return {"kind": "pid", "period": gains.period} | values


def gains_from(
    document: Any, plant: type[Plant], period: float
) -> tuple[PidGains, ...]:
    """The PIDs that a document describes, one for each output, as a controller of this package runs them.

    Raises:
        ControllerError: as `law_from`, or it is not a PID, or one with a filter, weights or an offset.
        PlantError: the law itself is not possible.
    """
    law_from(document, plant, period)
    if document.get("kind") != "pid":
        raise ControllerError(
            "is not of kind pid; the controller of a rig runs one PID for each output"
        )
    law_keys = {key: value for key, value in document.items() if key not in _ABOUT}
    loops = []
    for pid in _pids(law_keys, plant):
        gains = PidGains(
            pid.proportional,
            pid.integral,
            pid.derivative,
            pid.back_calculation,
            pid.low,
            pid.high,
            period,
            on_measurement=pid.derivative_weight == 0.0,
        )
        if FilteredPid.of(gains) != pid:
            raise ControllerError(
                "has a filter, weights or an offset; the controller of a rig has none"
            )
        loops.append(gains)
    return tuple(loops)


def _check_about(about: _About, plant: type[Plant]) -> None:
    """Refuse a document whose signals or units are others than the plant's.

    Raises:
        ControllerError: they are.
    """
    for key, named, declared in (
        ("outputs", about.outputs, plant.outputs),
        ("inputs", about.inputs, plant.drives),
    ):
        if named is not None and named != list(declared):
            raise ControllerError(
                f"{key}: {', '.join(named):.200} is not the order of plant {plant.name}; "
                f"write the law for {', '.join(declared)}"
            )
    units = {
        name: signal.unit
        for name, signal in (*plant.outputs.items(), *plant.drives.items())
    }
    for name, unit in about.units.items():
        if name not in units:
            raise ControllerError(
                f"units: plant {plant.name} has no signal {name!r:.80}; it has {', '.join(units)}"
            )
        if unit != units[name]:
            raise ControllerError(
                f"units: {name} is in {unit:.80}, the plant's is in {units[name]}; convert the law"
            )


def _read(kind: type[msgspec.Struct], tree: Any, place: str = "") -> Any:
    return decoded(tree, kind, place, ControllerError)


def _arrays(
    kind: type[msgspec.Struct], given: Mapping[str, Any]
) -> dict[str, FloatArray]:
    """The matrices and vectors of a document, without those that it leaves out."""
    arrays = {}
    for key, value in given_keys(_read(kind, given)).items():
        array = _array(key, value)
        if key not in ("low", "high") and not (np.abs(array) <= GREATEST).all():
            # true for NaN, too
            raise ControllerError(
                f"{key}: has a number that is not finite, or above {GREATEST:g} in size; give others"
            )
        arrays[key] = array
    return arrays


def _array(key: str, value: Any) -> FloatArray:
    """The matrix or, under some keys, the vector of a document."""
    is_vector = key in _VECTORS
    try:
        array = np.array(value, dtype=np.float64)
    except ValueError:
        array = np.zeros(())
    if not array.ndim or (array.ndim != 2 and not is_vector):
        shape_word = "a list" if is_vector else "a matrix"
        raise ControllerError(
            f"{key}: is not {shape_word} of numbers with rows of one length; give one"
        )
    return array.ravel() if is_vector else array


def _limits(plant: type[Plant], number: int) -> FloatArray:
    """Those of the plant's drives, shape (2, m); none for a law of another number of commands."""
    if number != len(plant.drives):
        return np.repeat([[-np.inf], [np.inf]], number, axis=1)
    return np.array(
        [drive.limits for drive in plant.drives.values()], dtype=np.float64
    ).T


def _pid(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    return pid_law(_pids(given, plant), period)


def _pids(given: Mapping[str, Any], plant: type[Plant]) -> list[FilteredPid]:
    """One PID, whose gains are in the document itself, or one per output in the list `loops`."""
    rows = _read(_Loops, given).loops if "loops" in given else [given]
    if len(rows) != len(plant.outputs):
        raise ControllerError(
            f"loops: {len(rows)} PIDs for {len(plant.outputs)} outputs; give one for each of "
            f"{', '.join(plant.outputs)}"
        )
    pids = []
    for k, (row, low, high) in enumerate(
        zip(rows, *_limits(plant, len(rows)), strict=True)
    ):
        gains = given_keys(_read(_Pid, row, f"loops[{k}]" if "loops" in given else ""))
        pids.append(FilteredPid(**({"low": low, "high": high} | gains)))
    return pids


def _two_level(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    law = TwoLevel(**given_keys(_read(_TwoLevel, given)), period=period)
    low, high = _limits(plant, 1)[:, 0]
    if law.off < low or law.on > high:
        raise ControllerError(
            f"off, on: {law.off:g} and {law.on:g} are not within {low:g} to {high:g}"
        )
    return law


def _state_space(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    """A linear law; matrices that are left out are zero."""
    arrays = _arrays(_StateSpace, given)
    m, q = arrays["C"].shape
    r = arrays["E"].shape[1]
    low, high = _limits(plant, m)
    left_out = {
        "F": np.zeros((q, r)),
        "G": np.zeros((q, m)),
        "offset": np.zeros(m),
        "shift": np.zeros(q),
        "low": low,
        "high": high,
    }
    return LinearLaw(**(left_out | arrays), period=period)


def _regulator(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    """A linear-quadratic regulator with an observer of states and disturbances, around u0 and y0.

    It aims at the states and commands at which the model is at rest on its set-points under the estimated
    disturbances: x⁺ = A·x + B·u + Bd·d, y = C·x + Cd·d; weights Qs of the outputs and Rs of the commands.
    """
    from scipy.linalg import solve_discrete_are  # noqa: PLC0415

    matrices = _arrays(_Regulator, given)
    A, B, C, Bd, Cd, K = (matrices[key] for key in ("A", "B", "C", "Bd", "Cd", "K"))
    u0 = matrices["u0"]
    y0 = matrices["y0"]
    try:
        n = len(A)
        p = len(C)
        n_disturbances = Bd.shape[1]
        m = B.shape[1]
        cost_to_go = solve_discrete_are(A, B, C.T @ matrices["Qs"] @ C, matrices["Rs"])
        weights = matrices["Rs"] + B.T @ cost_to_go @ B
        gain = np.asarray(
            np.linalg.solve(weights, B.T @ cost_to_go @ A), dtype=np.float64
        )
        aim = _aim(matrices, gain)
        aim_of_disturbances = aim[:, :n_disturbances]
        aim_of_set_points = aim[:, n_disturbances:]
        model_A = np.block(
            [[A, Bd], [np.zeros((n_disturbances, n)), np.eye(n_disturbances)]]
        )
        model_B = np.vstack([B, np.zeros((n_disturbances, m))])
        model_C = np.hstack([C, Cd])
        low, high = _limits(plant, m)
        return LinearLaw(
            A=model_A - K @ model_C,
            B=K,
            C=np.hstack([-gain, aim_of_disturbances]),
            D=np.zeros((m, p)),
            E=aim_of_set_points,
            F=np.zeros((n + n_disturbances, p)),
            G=model_B,
            offset=u0 - aim_of_set_points @ y0,
            shift=-K @ y0 - model_B @ u0,
            low=matrices.get("low", low),
            high=matrices.get("high", high),
            period=period,
        )
    except (ValueError, IndexError, np.linalg.LinAlgError) as error:
        raise ControllerError(
            f"regulator: its matrices do not fit together ({error})"
        ) from error


def _aim(matrices: Mapping[str, FloatArray], gain: FloatArray) -> FloatArray:
    """How the commands of a regulator depend on disturbances and set-points, shape (m, d + p).

    At rest x = A·x + B·u + Bd·d and r = C·x + Cd·d give x and u; the command is u + gain·x there.
    """
    A, B, C, Bd, Cd = (matrices[key] for key in ("A", "B", "C", "Bd", "Cd"))
    n = len(A)
    p = len(C)
    steady = np.block([[np.eye(n) - A, -B], [C, np.zeros((p, B.shape[1]))]])
    right = np.block([[Bd, np.zeros((n, p))], [-Cd, np.eye(p)]])
    states_and_inputs = np.linalg.solve(steady, right)
    return np.asarray(
        gain @ states_and_inputs[:n] + states_and_inputs[n:], dtype=np.float64
    )
