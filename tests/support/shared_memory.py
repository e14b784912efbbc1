"""What killed nodes leave in /dev/shm: Fast DDS removes its files only where a node ends by itself, or where
another one that has read them still runs."""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path

FOLDER = Path("/dev/shm")
LOCK_OF_SEGMENT = re.compile(r"fast(?:dds|rtps)_[0-9a-f]{16}_el")
FILE_OF_PORT = re.compile(r"(?:sem\.)?fast(?:dds|rtps)_port(\d+)(?:_el|_sl|_mutex)?")
FIRST_PORT = 7400
"""Of domain 0; the numbers of ports are those that DDSI-RTPS prescribes for UDP."""
PORTS_OF_DOMAIN = 250
BEGINS = 10.0
"""Seconds in which a node that starts has locked a file that it has made."""


def ports_of(domain: int) -> range:
    """The ports that only nodes of a ROS domain use."""
    first_port = FIRST_PORT + PORTS_OF_DOMAIN * domain
    return range(first_port, first_port + PORTS_OF_DOMAIN)


def remove_ports(domain: int) -> None:
    """Remove the ports of a domain in which nothing runs any longer, and which nobody else has."""
    ports = ports_of(domain)
    for path in _own_files():
        matched = FILE_OF_PORT.fullmatch(path.name)
        if matched and int(matched[1]) in ports:
            path.unlink(missing_ok=True)


def remove_segments() -> None:
    """Remove segments whose node has ended, of whichever domain: a node has its own locked as it lives."""
    for path in _own_files():
        if LOCK_OF_SEGMENT.fullmatch(path.name) and _has_no_owner(path):
            path.with_name(path.name.removesuffix("_el")).unlink(missing_ok=True)
            path.unlink(missing_ok=True)


def _own_files() -> Iterator[Path]:
    """Files of this user: the others' cannot be removed."""
    for path in FOLDER.glob("*fast*"):
        try:
            if path.stat().st_uid == os.getuid():
                yield path
        except FileNotFoundError:
            continue


def _has_no_owner(lock: Path) -> bool:
    try:
        if time.time() - lock.stat().st_mtime < BEGINS:
            return False
        with lock.open() as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # locked, or gone
        return False
    return True
