"""Opens any source of samples: a session or a recording."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from twinmatch.plants import Peltier, find_plant
from twinmatch.plants.files import is_plant_file
from twinmatch.sessions.errors import SessionError
from twinmatch.sessions.files import ProgressCallback, open_regular
from twinmatch.sessions.importers import MAT_BEGINNING, RECORDING_SUFFIXES, read_recording
from twinmatch.sessions.reader import Session, read_session
from twinmatch.sessions.scan import MAGIC
from twinmatch.sessions.store import samples_of
from twinmatch.sessions.topics import PLANT_TOPICS, SAMPLE, plant_messages
from twinmatch.signals import Sample

__all__ = ["open_any", "session_of"]


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
    kind = find_plant(plant)
    recorded = session.plant
    if recorded and recorded != kind.name and not is_plant_file(recorded):
        msg = f"{path}: was recorded from plant {recorded}, not {kind.name}; leave --plant out"
        raise SessionError(msg)
    return replace(session, plant=kind.name)


def _open(path: Path, topic: str | None, progress: ProgressCallback | None) -> Session:
    beginning = _beginning(path)
    if beginning is None:
        return read_session(path, topic, progress)
    if beginning.startswith(MAGIC) or path.suffix.lower() == ".mcap":
        return read_session(path, topic, progress)
    if path.suffix.lower() in RECORDING_SUFFIXES:
        return _recording(path, progress)
    hint = "; a MATLAB file needs the suffix .mat" if beginning.startswith(MAT_BEGINNING) else ""
    msg = f"{path}: is neither a session (folder or .mcap) nor a recording (.mat, .csv){hint}"
    raise SessionError(msg)


def _beginning(path: Path) -> bytes | None:
    """The first bytes of a file; None for a folder."""
    try:
        with open_regular(path) as file:
            return file.read(32)
    except IsADirectoryError:
        return None
    except FileNotFoundError:
        msg = f"{path}: does not exist"
        raise SessionError(msg) from None
    except OSError as error:
        msg = f"{path}: cannot be read ({error.strerror})"
        raise SessionError(msg) from error


def _recording(path: Path, progress: ProgressCallback | None) -> Session:
    """A recording as a session, with the messages that its import would have."""
    return session_of(path, samples_of(read_recording(path, progress)), plant=Peltier.name)


def session_of(path: Path, samples: list[Sample], *, plant: str, has_reference: bool = True) -> Session:
    """Samples as a session, equal to their import.

    Args:
        path: file of the samples.
        samples: at least one.
        plant: name of the plant.
        has_reference: whether the set-points are meaningful.
    """
    counts = Counter(message.topic.name for message in plant_messages(samples))
    return Session(
        name=path.stem,
        path=path,
        topic=SAMPLE.name,
        samples=samples,
        topics=list(PLANT_TOPICS),
        counts={topic.name: counts[topic.name] for topic in PLANT_TOPICS},
        start=samples[0].stamp,
        end=samples[-1].stamp,
        notes=[],
        source=lambda: plant_messages(samples),
        plant=plant,
        has_reference=has_reference,
    )
