"""The files of bags: MCAP and SQLite (rosbag2), `.bag` (ROS 1), all messages in the order of recording.

A pass over a file gives its messages. `Scan` is that over MCAP, which is read as far as it is intact;
`SqliteScan` and `Ros1Scan` have the same interface. What follows the last field of a
message is not read: rclpy writes some bytes too many, which the library `rosbags` would refuse.
"""

from __future__ import annotations

import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import cache, lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import zstandard

from twinmatch.sampling.channels import Field
from twinmatch.sessions.files import RecordingError, SessionError, open_regular
from twinmatch.sessions.messages import Message, Qos, Topic, schema_of
from twinmatch.sessions.metadata import parse_qos
from twinmatch.sessions.scan import MAX_UNPACKED, Scan

PACKED: Final = ".zstd"
"""Suffix of files that rosbag2 compresses as a whole."""
_ZSTD: Final = b"\x28\xb5\x2f\xfd"
"""Begins a message that rosbag2 compressed alone; CDR begins with a zero."""
_NEXT_IDL: Final = re.compile(r"^=+\nIDL: .*\n", re.MULTILINE)
"""What separates the parts of a definition in IDL."""
_JOURNAL_SUFFIXES: Final = ("-wal", "-journal")
"""Of files that SQLite keeps beside a database while it writes."""
_ROWS: Final = """SELECT topic_id, CAST(timestamp AS INTEGER), CAST(data AS BLOB)
                  FROM messages ORDER BY rowid"""


class SqliteScan(Scan):
    """One pass over an SQLite file."""

    def __iter__(self) -> Iterator[Message]:
        """The messages in the order in which they were written.

        Raises:
            RecordingError: the file cannot be opened, is damaged, or is not a bag.
        """
        without_topic = 0
        try:
            with database_at(self.path) as data:
                topics = self._topics_in(data)
                for topic_id, stamp, content in data.execute(_ROWS):
                    if topic_id in topics:
                        yield Message(
                            topics[topic_id], stamp or 0, stamp or 0, content or b""
                        )
                    else:
                        without_topic += 1
        except (sqlite3.Error, OSError, LookupError) as error:
            problem = f"cannot be read as a bag, or is damaged ({error}); try sqlite3 {self.path.name} .recover"
            raise RecordingError(f"{self.path}: {problem}") from error
        if without_topic:
            self.fault = f"{without_topic} messages belong to no topic and are left out"

    def _topics_in(self, data: sqlite3.Connection) -> dict[int, Topic]:
        """The topics of the file by their numbers in it.

        Raises:
            RecordingError: it has no tables as a bag has them.
        """
        tables = {
            name
            for (name,) in data.execute(
                "SELECT name FROM sqlite_master WHERE type = 'table'"
            )
        }
        if not {"messages", "topics"} <= tables:
            raise RecordingError(
                f"{self.path}: has no tables messages and topics, as a bag has"
            )
        data.row_factory = sqlite3.Row
        has_definitions = "message_definitions" in tables  # since ROS 2 Iron
        rows = (
            data.execute("SELECT * FROM message_definitions ORDER BY id")
            if has_definitions
            else []
        )
        definitions = {row["topic_type"]: dict(row) for row in rows}
        topics = {}
        for row in map(dict, data.execute("SELECT * FROM topics ORDER BY id")):
            definition = definitions.get(row["type"], {})
            topics[row["id"]] = Topic(
                str(row["name"]),
                str(row["type"]),
                str(definition.get("encoded_message_definition", "")),
                str(row.get("type_description_hash", "")),
                parse_qos(str(row.get("offered_qos_profiles", ""))),
                str(row["serialization_format"]),
                str(definition.get("encoding", "")),
            )
        data.row_factory = None
        self.topics = list(topics.values())
        return topics


@contextmanager
def database_at(path: Path) -> Iterator[sqlite3.Connection]:
    """An SQLite file, with the messages that a killed recorder left in a journal; no file is changed.

    SQLite itself would change them: it moves a journal into the database. So both are copied.
    """
    open_regular(path).close()
    journals = _journals_of(path)
    if not journals:
        with closing(_connected(path, "mode=ro&immutable=1")) as data:
            yield data
        return
    with TemporaryDirectory(prefix="twinmatch-bag-") as folder:
        for file in (path, *journals):
            shutil.copyfile(file, Path(folder) / file.name)
        with closing(_connected(Path(folder) / path.name, "mode=rw")) as data:
            yield data


def _journals_of(path: Path) -> list[Path]:
    """The journals of a database that are not empty."""
    files = [path.with_name(path.name + suffix) for suffix in _JOURNAL_SUFFIXES]
    return [file for file in files if file.is_file() and file.stat().st_size]


def _connected(path: Path, mode: str) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?{mode}", uri=True)


class Ros1Scan(Scan):
    """One pass over a file of ROS 1."""

    def __iter__(self) -> Iterator[Message]:
        """The messages in the order in which they were written.

        Raises:
            RecordingError: the file cannot be opened, is damaged, or is not a bag.
        """
        from rosbags.rosbag1 import Reader  # noqa: PLC0415
        from rosbags.rosbag1.reader import IndexData  # noqa: PLC0415

        class ByPosition(IndexData):
            """An entry of the index, sorted by its position in the file; the library sorts by time."""

            __slots__ = ()

            def __lt__(self, other: tuple[int, ...]) -> bool:
                return self[1:] < other[1:]

        try:
            open_regular(self.path).close()
            with Reader(self.path) as reader:
                topics = {
                    connection.id: Topic(
                        connection.topic,
                        connection.msgtype,
                        connection.msgdef.data,
                        "",
                        encoding="ros1",
                    )
                    for connection in reader.connections
                }
                reader.indexes = {
                    number: sorted(map(ByPosition._make, index))
                    for number, index in reader.indexes.items()
                }
                self.topics = list(topics.values())
                for connection, stamp, content in reader.messages():
                    yield Message(topics[connection.id], stamp, stamp, content)
        except Exception as error:  # the library raises many kinds for damaged bytes
            msg = f"{self.path}: cannot be read as a bag, or is damaged ({first_line(error)})"
            raise RecordingError(msg) from error


SCANS: Final[Mapping[str, type[Scan]]] = {
    ".mcap": Scan,
    ".db3": SqliteScan,
    ".bag": Ros1Scan,
}
"""By the suffix of a file."""


def suffix_of(path: Path) -> str:
    """The suffix of a file, or of the file that is compressed in it."""
    return Path(path.name.lower().removesuffix(PACKED)).suffix


@contextmanager
def scans_of(files: Sequence[Path]) -> Iterator[Callable[[], list[Scan]]]:
    """A function that makes a new pass over each file; compressed files are unpacked until the context ends.

    Raises:
        RecordingError: a file cannot be unpacked.
    """
    with TemporaryDirectory(prefix="twinmatch-bag-") as folder:
        plain_files = [_unpacked(file, Path(folder)) for file in files]
        yield lambda: [
            SCANS[suffix_of(plain_file)](plain_file) for plain_file in plain_files
        ]


def _unpacked(file: Path, folder: Path) -> Path:
    """The file itself or, if it is compressed as a whole, its content, unpacked into a folder."""
    if not file.name.lower().endswith(PACKED):
        return file
    unpacked = folder / file.stem
    try:
        with open_regular(file) as packed, unpacked.open("wb") as plain:
            zstandard.ZstdDecompressor().copy_stream(packed, plain)
    except (zstandard.ZstdError, OSError) as error:
        raise RecordingError(f"{file}: cannot be unpacked ({error})") from error
    return unpacked


class Definition(NamedTuple):
    """How the messages of a type are read."""

    fields_of: Callable[[str], Mapping[str, Field]]
    """The fields of the type and of those nested in it."""
    decode: Callable[[bytes], Any]


@lru_cache(maxsize=1024)
def definition_of(topic: Topic) -> Definition:
    """How the messages of a topic are read: by the definition in its file, a standard or an installed one.

    Raises:
        RecordingError: no definition can be used, or the messages are neither in CDR nor as in ROS 1.
    """
    return _definition(topic._replace(name="", qos=Qos()))


@lru_cache(maxsize=256)
def _definition(topic: Topic) -> Definition:
    """As `definition_of`, for a topic without what the definition does not depend on."""
    if topic.encoding not in ("cdr", "ros1"):
        raise RecordingError(
            f"messages in {topic.encoding or 'an unnamed encoding'} are not read, only CDR"
        )
    problem = f"the bag does not contain the definition of {topic.type}; source the workspace that has it"
    for store_of in (_in_file, _standard, _installed):
        try:
            store = store_of(topic)
            parsed = store.get_msgdef(topic.type)
            wanted_hash = topic.type_hash if store_of is not _in_file else ""
            has_wanted_hash = (
                not wanted_hash or store.hash_rihs01(topic.type) == wanted_hash
            )
        except (KeyError, SessionError):
            continue  # this source lacks the type, or one that is nested in it
        except Exception as error:
            # the library raises many kinds for what it cannot read
            problem = (
                f"the definition of {topic.type} cannot be read ({first_line(error)})"
            )
            continue
        if not has_wanted_hash:
            problem = f"{topic.type} was recorded with another definition than that which is installed"
            continue
        ros1 = partial(store.deserialize_ros1, typename=topic.type)
        fields_of = partial(_fields_in, store)
        return Definition(
            fields_of,
            ros1 if topic.encoding == "ros1" else partial(_from_cdr, store, parsed),
        )
    raise RecordingError(problem)


def _in_file(topic: Topic) -> Any:
    """The types that the file defines."""
    from rosbags.typesys import (  # noqa: PLC0415
        Stores,
        get_types_from_idl,
        get_types_from_msg,
        get_typestore,
    )

    store = get_typestore(Stores.EMPTY)
    if topic.schema and topic.language == "ros2msg":
        store.register(get_types_from_msg(topic.schema, topic.type))
    for part in (
        re.split(_NEXT_IDL, topic.schema)
        if topic.language in ("ros2idl", "omgidl")
        else ()
    ):
        if part.strip():
            store.register(get_types_from_idl(part))
    return store


def _standard(_: Topic) -> Any:
    """The types of the ROS 2 common interfaces."""
    return _common()


@cache
def _common() -> Any:
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    return get_typestore(Stores.ROS2_JAZZY)


def _installed(topic: Topic) -> Any:
    """The types that the sourced workspace defines."""
    return _in_file(topic._replace(schema=schema_of(topic.type), language="ros2msg"))


def _fields_in(store: Any, kind: str) -> dict[str, Field]:
    return {name: _field(described) for name, described in store.fielddefs[kind][1]}


def _field(described: Any) -> Field:
    """Convert a field description of rosbags: a pair of node kind and content."""
    node, content = described
    name = node.name
    if name in ("ARRAY", "SEQUENCE"):
        inner, length = content
        return _field(inner)._replace(
            array=True, length=length if name == "ARRAY" else None
        )
    return Field(content[0] if name == "BASE" else content)


def _from_cdr(store: Any, parsed: Any, data: bytes) -> Any:
    """The message at the beginning of these bytes; rclpy writes more than that."""
    if data[:4] == _ZSTD:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= MAX_UNPACKED:
            raise RecordingError(
                f"a compressed message of {size} bytes; {MAX_UNPACKED} is the most"
            )
        data = zstandard.decompress(data)
    deserialize = {
        b"\0\0": parsed.deserialize_cdr_be,
        b"\0\1": parsed.deserialize_cdr_le,
    }.get(data[:2])
    if deserialize is None:
        raise RecordingError(f"{data[:4].hex(' ')} does not begin plain CDR")
    return deserialize(data[4:], 0, parsed.cls, store)[0]


def first_line(error: Exception) -> str:
    """What a library says of an error, else its kind."""
    return (str(error).splitlines() or [type(error).__name__])[0]
