"""Opens any source of samples: a session, or a recording of the Peltier rig made by another program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from twinmatch.plants import find_plant
from twinmatch.plants.files import is_plant_file
from twinmatch.sessions.files import ProgressCallback, SessionError, open_regular
from twinmatch.sessions.reader import Session, read_session
from twinmatch.sessions.records import MAGIC


def open_any(
    path: Path | str,
    topic: str | None = None,
    progress: ProgressCallback | None = None,
    *,
    plant: str | None = None,
) -> Session:
    """Open a session (folder or `.mcap` file) or a recording (`.mat`, `.csv`) as a session.

    The first bytes of a file determine its type, before its name.

    Args:
        path: folder or file.
        topic: the topic with the samples, if a session has several.
        progress: called with the amount read and the total.
        plant: name or file of the plant, as given by the user; needed if the session does not name it, or
            the plant is in a file.

    Raises:
        SessionError: neither a session nor a recording, not usable, or of another plant.
        PlantError: the plant does not exist.
    """
    session = _open(Path(path), topic, progress)
    if not plant:
        return session
    given = find_plant(plant)
    recorded = session.plant
    if recorded and recorded != given.name and not is_plant_file(recorded):
        raise SessionError(
            f"{path}: was recorded from plant {recorded}, not {given.name}; leave --plant out"
        )
    return replace(session, plant=given.name)


def _open(path: Path, topic: str | None, progress: ProgressCallback | None) -> Session:
    beginning = _beginning(path)
    if (
        beginning is None
        or beginning.startswith(MAGIC)
        or path.suffix.lower() == ".mcap"
    ):
        return read_session(path, topic, progress)
    # what reads tables is imported for tables only: it takes as long as a session
    from twinmatch.importing.recordings import open_recording  # noqa: PLC0415

    return open_recording(path, beginning, progress)


def _beginning(path: Path) -> bytes | None:
    """The first bytes of a file; None for a folder."""
    try:
        with open_regular(path) as file:
            return file.read(32)
    except IsADirectoryError:
        return None
    except FileNotFoundError:
        raise SessionError(f"{path}: does not exist") from None
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror})") from error
