"""Loading of an unpacked FMU."""

from __future__ import annotations

from pathlib import Path

from twinmatch.fmu.described import CO_SIMULATION, Described
from twinmatch.fmu.exchange import Exchange
from twinmatch.fmu.machine import Machine, MachineError, Wires

__all__ = ["machine_of"]


def machine_of(folder: Path, described: Described, kind: str, wires: Wires, places: list[int]) -> Machine:
    """Load the FMU's library and create an instance.

    Raises:
        MachineError: it has none for this machine, or that refuses.
    """
    from fmpy import fmi2, fmi3, platform, platform_tuple  # noqa: PLC0415 (an extra)

    major = int(described.version[0])
    here = platform if major == 2 else platform_tuple
    if here not in described.platforms:
        available = ", ".join(described.platforms) or "no platform"
        raise MachineError(f"it has binaries for {available}; this machine is {here}")
    classes = {2: (fmi2.FMU2Model, fmi2.FMU2Slave), 3: (fmi3.FMU3Model, fmi3.FMU3Slave)}[major]
    identifier = described.identifiers[described.kinds.index(kind)]
    library = folder / "binaries" / here / f"{identifier}.so"
    name = library.relative_to(folder)
    if not library.is_file():
        raise MachineError(f"it has no {name}, the program for this machine; export it again")
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
        raise MachineError(f"its {name} is not a library for this machine: {why}") from error
    try:
        fmu.instantiate()
    except Exception as error:
        raise MachineError(
            f"it cannot be instantiated ({error}): is it complete, and its licence?"
        ) from error
    if kind == CO_SIMULATION:
        return Machine(fmu, major, wires)
    return Exchange(fmu, major, wires, described, places)
