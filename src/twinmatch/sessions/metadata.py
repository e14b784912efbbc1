"""What a session says of itself: `metadata.yaml` of a rosbag2 bag, version 9, and the records in its files.

The records hold its plant, the parameters of its nodes, and its initial candidates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import yaml

from twinmatch.sessions.documents import (
    DocumentError,
    parse_json,
    parse_yaml,
    read_text,
)
from twinmatch.sessions.files import SessionError
from twinmatch.sessions.messages import Qos, Topic

METADATA = "metadata.yaml"
VERSION = 9
_MOST_TOLD: Final = 5
"""Topics named in a sentence."""

PLANT = "twinmatch/plant"
"""Record with the name of the `plant`; an import adds `source`, `map`, and `reference` if there is none."""
NO_REFERENCE = "none"
SAMPLED = "map.reference"
"""Parameter of the sampler with the topic of the set-points; empty: there are none."""
CONTINUES = "twinmatch/continues"
"""Record with the name of the `session` that another recorder of the same run began."""
DOUBT = "twinmatch/doubt/"
"""Records of samples during which a `topic` had several `publishers`: the `first`, the `last` once known."""
REPAIRED = "twinmatch/repaired"
"""Record of a repair that lost messages or could not confirm them: the `faults` that it found."""
PARAMETERS = "twinmatch/parameters"
CANDIDATES = "twinmatch/candidates"
"""Record with the `text` of the discriminator's file of initial candidates; empty: it was not readable."""


class Part(NamedTuple):
    """One MCAP file of a session."""

    file: str
    """Its name in the folder."""
    start: int
    """Log time of the earliest message, ns; 0 if there is none."""
    end: int
    """Log time of the latest message, ns."""
    messages: int
    """Number of messages."""


class Summary(NamedTuple):
    """The content of a session's metadata."""

    parts: tuple[Part, ...]
    """Its files, at least one."""
    counts: Mapping[Topic, int]
    """Messages per topic."""
    ros_distro: str
    """ROS 2 distribution of the recorder, or `unknown`."""

    def text(self) -> str:
        """The content as YAML; each MCAP file repeats it for itself."""
        return _dump(self._information())

    def file_text(self) -> str:
        """The text of `metadata.yaml`."""
        return _dump({"rosbag2_bagfile_information": self._information()})

    def _information(self) -> dict[str, object]:
        used = [part for part in self.parts if part.messages] or list(self.parts)
        start = min(part.start for part in used)
        end = max(part.end for part in used)
        return {
            "version": VERSION,
            "storage_identifier": "mcap",
            **_extent(start, end, sum(self.counts.values())),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [topic.qos.profile()],
                        "type_description_hash": topic.type_hash,
                    },
                    "message_count": count,
                }
                for topic, count in self.counts.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [part.file for part in self.parts],
            "files": [
                {"path": part.file, **_extent(part.start, part.end, part.messages)}
                for part in self.parts
            ],
            "custom_data": None,
            "ros_distro": self.ros_distro,
        }


def _extent(start: int, end: int, count: int) -> dict[str, object]:
    return {
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": count,
    }


def qos_text(qos: Qos) -> str:
    """The offered profiles as the YAML text of a channel's metadata."""
    return _dump([qos.profile()])


def parse_qos(text: str) -> Qos:
    """Parse the first offered profile of a channel; missing or unknown values give the default profile.

    rosbag2 wrote numbers before version 9, and writes words since.
    """
    try:
        profile = parse_yaml(text, "offered_qos_profiles")[0]
        reliability = {1: "reliable", 2: "best_effort"}.get(
            profile["reliability"], profile["reliability"]
        )
        durability = {1: "transient_local", 2: "volatile"}.get(
            profile["durability"], profile["durability"]
        )
        depth = int(profile["depth"])
    except (ValueError, TypeError, LookupError):
        return Qos()
    if reliability not in {"reliable", "best_effort"} or durability not in {
        "volatile",
        "transient_local",
    }:
        return Qos()
    # A recorder sees depth 0 where discovery does not report it.
    return Qos(reliability, durability, depth if depth > 0 else Qos().depth)


def files_listed(folder: Path) -> list[str]:
    """Names of the MCAP files listed in `metadata.yaml`; empty if it cannot be read."""
    with suppress(*_UNREADABLE):
        return [Path(name).name for name in _read(folder)["relative_file_paths"]]
    return []


def is_mcap(path: Path) -> bool:
    """Whether a file of a folder may be one of a session."""
    return path.suffix == ".mcap"


def _by_number(file: Path) -> tuple[int, str]:
    return len(file.name), file.name


def files_of(
    folder: Path, wanted: Callable[[Path], bool]
) -> tuple[list[Path], list[str]]:
    """The files of a recording in their order, and what is to be said of them, as sentences.

    They are those listed in `metadata.yaml`, all wanted ones without it.
    """
    in_folder = sorted(filter(wanted, folder.iterdir()), key=_by_number)
    listed = [folder / name for name in files_listed(folder)]
    if not listed:
        return in_folder, [
            f"{METADATA} is missing or unreadable: the recording was not finished"
        ]
    present = [file for file in listed if file.is_file() and wanted(file)]
    notes = [
        f"{file.name} is listed in {METADATA} but missing"
        for file in listed
        if file not in present
    ]
    stray = [file.name for file in in_folder if file not in listed]
    notes += [
        f"{name} is not listed in {METADATA} and is left out; read it alone"
        for name in stray
    ]
    return present, notes


def counts_listed(folder: Path) -> Mapping[str, int]:
    """Messages per topic name listed in `metadata.yaml`; empty if it cannot be read."""
    counts: Counter[str] = Counter()
    with suppress(*_UNREADABLE):
        for topic in _read(folder)["topics_with_message_count"]:
            counts[str(topic["topic_metadata"]["name"])] += int(topic["message_count"])
        return counts
    return {}


def miscounted(listed: Mapping[str, int], counted: Mapping[str, int]) -> list[str]:
    """A sentence on the topics of which `metadata.yaml` lists another number of messages than were found."""
    if not listed:
        return []
    wrong = []
    for name in sorted({*listed, *counted}):
        stated = listed.get(name, 0)
        present = counted.get(name, 0)
        if stated != present:
            wrong.append(f"{stated} of {name} ({present} found)")
    if not wrong:
        return []
    text = ", ".join(wrong[:_MOST_TOLD])
    further = (
        f" and others of {len(wrong) - _MOST_TOLD} more topics"
        if len(wrong) > _MOST_TOLD
        else ""
    )
    return [
        f"{METADATA} lists other numbers of messages than the files hold: {text}{further}"
    ]


def mcap_files(folder: Path) -> list[Path]:
    """The MCAP files in a folder, in their order.

    Raises:
        SessionError: there are none.
    """
    files = sorted(filter(is_mcap, folder.iterdir()), key=_by_number)
    if not files:
        raise SessionError(
            f"session {folder}: is not a session: the folder has no MCAP file"
        )
    return files


def distro_of(folder: Path) -> str:
    """The ROS 2 distribution in `metadata.yaml`; `unknown` if it cannot be read."""
    with suppress(*_UNREADABLE):
        return str(_read(folder)["ros_distro"])
    return "unknown"


_UNREADABLE: Final = (OSError, ValueError, TypeError, LookupError, OverflowError)


def _read(folder: Path) -> Any:
    path = folder / METADATA
    return parse_yaml(read_text(path), str(path))["rosbag2_bagfile_information"]


def _dump(value: object) -> str:
    return str(yaml.safe_dump(value, sort_keys=False))


def doubt_record(number: int) -> str:
    """Name of the record of a doubt, from 1."""
    return f"{DOUBT}{number}"


def doubts(records: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Which samples of a session are doubted, as sentences."""
    sentences = []
    for name, doubt in records.items():
        if name.startswith(DOUBT):
            first = doubt.get("first")
            last = doubt.get("last") or "the last"
            sentences.append(
                f"samples {first} to {last} are doubted: {doubt.get('topic')} was published by "
                f"{doubt.get('publishers')}, and a twin may have taken others than are recorded"
            )
    return sentences


def repairs(records: Mapping[str, Mapping[str, str]]) -> list[str]:
    """What a repaired session had lost, as sentences."""
    faults = records.get(REPAIRED, {}).get("faults", "")
    return [f"it was repaired: {faults}"] if faults else []


def parameters_record(node: str) -> str:
    """Name of the record with the parameters of a node (full name); the values are JSON."""
    return PARAMETERS + node


def parameters_of(
    records: Mapping[str, Mapping[str, str]], node: str
) -> dict[str, Any] | None:
    """The parameters of a node (full name); None if they were not recorded.

    Raises:
        SessionError: a value is not valid JSON.
    """
    record = records.get(parameters_record(node))
    if record is None:
        return None
    try:
        return {name: parse_json(value, name) for name, value in record.items()}
    except DocumentError as error:
        raise SessionError(
            f"session: the recorded parameters of {node} cannot be read: {error}"
        ) from error


def plant_of(records: Mapping[str, Mapping[str, str]]) -> str:
    """The recorded plant of a session: its name, or the path of its file; empty if not recorded."""
    plant = records.get(PLANT, {}).get("plant", "")
    for name, values in records.items():
        if not plant and name.startswith(PARAMETERS) and "plant" in values:
            try:
                plant = str(parse_json(values["plant"], name))
            except DocumentError:
                continue
    return plant


def has_reference(records: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether the session's set-points are meaningful; False if an import found none, or the sampler had no
    topic for them."""
    topics = (
        values.get(SAMPLED)
        for name, values in records.items()
        if name.startswith(PARAMETERS)
    )
    return (
        records.get(PLANT, {}).get("reference", "") != NO_REFERENCE
        and '""' not in topics
    )
