"""A law as a document: gains of PIDs, two levels, matrices, or the observer and weights of a regulator.

Every document may name `outputs` and `inputs`, in its own order of signals, `units` by signal, and the
`period`. What it says of them is compared with the plant and the session; nothing is reordered or converted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, Final

import numpy as np
from scipy.linalg import solve_discrete_are

from twinmatch.controllers.answer import ControllerError
from twinmatch.controllers.pids import FilteredPid, pid_law
from twinmatch.dynamics import Law, LinearLaw, PidGains, Plant, TwoLevel
from twinmatch.signals import FloatArray

_ABOUT: Final = {"kind", "outputs", "inputs", "units", "period"}
_REGULATOR: Final = {"A", "B", "C", "Bd", "Cd", "K", "Re", "u0", "y0", "Qs", "Rs"}
_NEEDED: Final = _REGULATOR - {"Re"}
_MATRICES: Final = {each.name for each in fields(LinearLaw)} - {"period", "drives"}


def law_from(document: Any, plant: type[Plant], period: float) -> Law:
    """The law that a document describes, for a plant at a sample time, s.

    Without limits in the document, they are those of the plant's drives.

    Raises:
        ControllerError: a key is unknown or missing, a value is not a number, or the document is for other
            signals, units or another period.
        PlantError: the law itself is not possible.
    """
    if not isinstance(document, Mapping):
        raise ControllerError("is not an object of keys and values; give one with the key kind")
    kind = document.get("kind", "regulator" if document.keys() >= _NEEDED else None)
    makers = {"pid": _pid, "two-level": _two_level, "state-space": _state_space, "regulator": _regulator}
    if kind not in makers:
        raise ControllerError(f"kind: {kind!r} is not a kind of law; give one of {', '.join(makers)}")
    _check_signals(document, plant)
    if "period" in document and _number("period", document["period"]) != period:
        raise ControllerError(
            f"period: the law runs every {document['period']:g} s, the samples come every {period:g} s; "
            "give a law for that period"
        )
    given = {key: value for key, value in document.items() if key not in _ABOUT}
    law = makers[kind](given, plant, period)
    sizes, of = (law.n_outputs, law.n_inputs), (len(plant.outputs), len(plant.drives))
    if sizes != of or law.n_references != of[0]:
        raise ControllerError(
            f"is a law for {sizes[0]} outputs, {law.n_references} set-points and {sizes[1]} inputs; plant "
            f"{plant.name} has {of[0]} outputs ({', '.join(plant.outputs)}) and {of[1]} inputs "
            f"({', '.join(plant.drives)})"
        )
    return law


def pid_document(gains: PidGains) -> dict[str, Any]:
    """The document of a PID."""
    pid = FilteredPid.of(gains)
    known = {each.name: getattr(pid, each.name) for each in fields(pid)}
    return {"kind": "pid", "period": gains.period} | known


def _check_signals(document: Mapping[str, Any], plant: type[Plant]) -> None:
    for key, declared in (("outputs", plant.outputs), ("inputs", plant.drives)):
        if key in document and list(document[key]) != list(declared):
            raise ControllerError(
                f"{key}: {', '.join(map(str, document[key]))} is not the order of plant {plant.name}; "
                f"write the law for {', '.join(declared)}"
            )
    units = {name: each.unit for name, each in (*plant.outputs.items(), *plant.drives.items())}
    for name, unit in dict(document.get("units", {})).items():
        if name not in units:
            raise ControllerError(
                f"units: plant {plant.name} has no signal {name!r}; it has {', '.join(units)}"
            )
        if unit != units[name]:
            raise ControllerError(
                f"units: {name} is in {unit}, the plant's is in {units[name]}; convert the law"
            )


def _checked(given: Mapping[str, Any], known: set[str], needed: set[str]) -> None:
    if unknown := sorted(given.keys() - known):
        raise ControllerError(f"{unknown[0]}: is not a known key; there are {', '.join(sorted(known))}")
    if missing := sorted(needed - given.keys()):
        raise ControllerError(f"{missing[0]}: is missing; give {', '.join(sorted(needed))}")


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ControllerError(f"{key}: {value!r} is not a number")
    return float(value)


def _array(key: str, value: Any) -> FloatArray:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ControllerError(f"{key}: is not a matrix of numbers with rows of one length") from None


def _limits(plant: type[Plant], number: int) -> FloatArray:
    """Those of the plant's drives, shape (2, m); none for a law of another number of commands."""
    if number != len(plant.drives):
        return np.repeat([[-np.inf], [np.inf]], number, axis=1)
    return np.array([drive.limits for drive in plant.drives.values()], dtype=np.float64).T


def _pid(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    """One PID, whose gains are in the document itself, or one per output in the list `loops`."""
    rows = given.get("loops", [given])
    if "loops" in given:
        _checked(given, {"loops"}, set())
        if not (isinstance(rows, list) and all(isinstance(row, Mapping) for row in rows)):
            raise ControllerError("loops: is not a list of PIDs; give an object of gains for each output")
    if len(rows) != len(plant.outputs):
        raise ControllerError(
            f"loops: {len(rows)} PIDs for {len(plant.outputs)} outputs; give one for each of "
            f"{', '.join(plant.outputs)}"
        )
    known = {each.name for each in fields(FilteredPid)}
    pids = []
    for row, low, high in zip(rows, *_limits(plant, len(rows)), strict=True):
        _checked(row, known, {"proportional"})
        numbers = {"low": low, "high": high} | {key: _number(key, value) for key, value in row.items()}
        pids.append(FilteredPid(**numbers))
    return pid_law(pids, period)


def _two_level(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    known = {each.name for each in fields(TwoLevel)} - {"period"}
    _checked(given, known, {each.name for each in fields(TwoLevel) if each.default is MISSING})
    law = TwoLevel(**{key: _number(key, value) for key, value in given.items()}, period=period)
    low, high = _limits(plant, 1)[:, 0]
    if law.off < low or law.on > high:
        raise ControllerError(f"off, on: {law.off:g} and {law.on:g} are not within {low:g} to {high:g}")
    return law


def _state_space(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    """A linear law; matrices that are left out are zero."""
    _checked(given, _MATRICES, {"A", "B", "C", "D", "E"})
    arrays = {key: _array(key, value) for key, value in given.items()}
    if any(arrays[key].ndim != 2 for key in "CE"):
        raise ControllerError("C, E: give matrices with a row for each input")
    (m, q), r = arrays["C"].shape, arrays["E"].shape[1]
    low, high = _limits(plant, m)
    usual = {"F": np.zeros((q, r)), "G": np.zeros((q, m)), "offset": np.zeros(m), "shift": np.zeros(q)}
    return LinearLaw(**({**usual, "low": low, "high": high} | arrays), period=period)


def _regulator(given: Mapping[str, Any], plant: type[Plant], period: float) -> Law:
    """A linear-quadratic regulator with an observer of states and disturbances, around u0 and y0.

    It aims at the states and commands at which the model is at rest on its set-points under the estimated
    disturbances: x⁺ = A·x + B·u + Bd·d, y = C·x + Cd·d; weights Qs of the outputs and Rs of the commands.
    """
    _checked(given, _REGULATOR | {"low", "high"}, _NEEDED)
    m = {key: _array(key, value) for key, value in given.items()}
    a, b, c, bd, cd, k = (m[key] for key in ("A", "B", "C", "Bd", "Cd", "K"))
    u0, y0 = m["u0"].ravel(), m["y0"].ravel()
    try:
        n, nd, entries = len(a), bd.shape[1], b.shape[1]
        weight = solve_discrete_are(a, b, c.T @ m["Qs"] @ c, m["Rs"])
        gain = np.linalg.solve(m["Rs"] + b.T @ weight @ b, b.T @ weight @ a)
        steady = np.block([[np.eye(n) - a, -b], [c, np.zeros((len(c), entries))]])
        right = np.block([[bd, np.zeros((n, len(c)))], [-cd, np.eye(len(c))]])
        aims = np.linalg.solve(steady, right)
        aim = np.asarray(gain @ aims[:n] + aims[n:], dtype=np.float64)
        model = np.block([[a, bd], [np.zeros((nd, n)), np.eye(nd)]])
        into = np.vstack([b, np.zeros((nd, entries))])
        seen = np.hstack([c, cd])
        low, high = _limits(plant, entries)
        return LinearLaw(
            A=model - k @ seen, B=k, C=np.hstack([-gain, aim[:, :nd]]), D=np.zeros((entries, len(c))),
            E=aim[:, nd:],
            F=np.zeros((n + nd, len(c))), G=into, offset=u0 - aim[:, nd:] @ y0, shift=-k @ y0 - into @ u0,
            low=m.get("low", low), high=m.get("high", high), period=period,
        )  # fmt: skip
    except (ValueError, IndexError, np.linalg.LinAlgError) as error:
        raise ControllerError(f"regulator: its matrices do not fit together ({error})") from error
