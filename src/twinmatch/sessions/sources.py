"""Opens whatever holds samples: a session or a recording."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from twinmatch.plants import Peltier, find_plant
from twinmatch.plants.files import is_plant_file
from twinmatch.sessions.errors import SessionError
from twinmatch.sessions.files import Told, open_regular
from twinmatch.sessions.importers import MAT_BEGINNING, RECORDING_SUFFIXES, read_recording
from twinmatch.sessions.reader import Session, read_session
from twinmatch.sessions.scan import MAGIC
from twinmatch.sessions.store import samples_of
from twinmatch.sessions.topics import PLANT_TOPICS, SAMPLE, plant_messages
from twinmatch.signals import Sample

__all__ = ["open_any", "session_of"]


def open_any(
    path: Path | str, topic: str | None = None, told: Told | None = None, *, plant: str | None = None
) -> Session:
    """Open a session (folder or `.mcap` file) or a recording (`.mat`, `.csv`) as a session.

    What a file is, its first bytes say before its name does.

    Args:
        path: what to open.
        topic: the topic with the samples, if a session has several.
        told: called now and then with how much of how much of a recording has been read.
        plant: name or file of the plant it is of, as a user gave it; needed where the session does not say
            it, or where the plant is in a file.

    Raises:
        SessionError: neither a session nor a recording, one that cannot be used, or one of another plant.
        PlantError: there is no such plant.
    """
    session = _open(Path(path), topic, told)
    if not plant:
        return session
    kind = find_plant(plant)
    said = session.plant
    if said and said != kind.name and not is_plant_file(said):
        msg = f"{path}: is of plant {said}, and {kind.name} is asked for; leave --plant out or name {said}"
        raise SessionError(msg)
    return replace(session, plant=kind.name)


def _open(path: Path, topic: str | None, told: Told | None) -> Session:
    beginning = _beginning(path)
    if beginning is None:
        return read_session(path, topic)
    if beginning.startswith(MAGIC) or path.suffix.lower() == ".mcap":
        return read_session(path, topic)
    if path.suffix.lower() in RECORDING_SUFFIXES:
        return _recording(path, told)
    hint = "; a MATLAB file needs the ending .mat" if beginning.startswith(MAT_BEGINNING) else ""
    msg = f"{path}: is neither a session (folder or .mcap) nor a recording (.mat, .csv){hint}"
    raise SessionError(msg)


def _beginning(path: Path) -> bytes | None:
    """The first bytes of a file; None: it is a folder."""
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


def _recording(path: Path, told: Told | None) -> Session:
    """A recording with the messages that an imported session of it would have."""
    return session_of(path, samples_of(read_recording(path, told)), plant=Peltier.name)


def session_of(path: Path, samples: list[Sample], *, plant: str, has_reference: bool = True) -> Session:
    """Samples as the session that an import of them would be.

    Args:
        path: of the file they are from.
        samples: at least one.
        plant: whose they are, by name.
        has_reference: whether their set-points say anything.
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
