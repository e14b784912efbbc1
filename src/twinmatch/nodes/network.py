"""Where the nodes talk: on this machine only, unless somebody writes that they may talk further.

ROS 2 by default sends its discovery to the whole network and listens on every interface, and the wheels
have no DDS security. So every node binds to the loopback interface, and one that could not is stopped:
the profile is looked for before ROS starts, and the sockets are looked at after it has started.
`TWINMATCH_NETWORK=open` in the environment leaves the network to the usual ROS 2 variables instead.

Programs of other people need nothing of this to read our topics, but without it they listen on the network
themselves. `python -m twinmatch.nodes.network` prints what a shell has to set for them.
"""

from __future__ import annotations

import ipaddress
import os
import shlex
import sys
import tempfile
from collections.abc import Iterator, Mapping, MutableMapping
from enum import Enum
from pathlib import Path

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError

__all__ = [
    "PROFILES",
    "VARIABLE",
    "Network",
    "NetworkError",
    "check_sockets",
    "prepare",
    "shell_lines",
    "sockets_elsewhere",
]

VARIABLE = "TWINMATCH_NETWORK"
"""Environment variable that holds the value of a `Network`."""

PROFILES = {
    "FASTRTPS_DEFAULT_PROFILES_FILE": Path(__file__).with_name("fastdds2_loopback.xml"),
    "FASTDDS_DEFAULT_PROFILES_FILE": Path(__file__).with_name("fastdds3_loopback.xml"),
}
"""Settings that bind Fast DDS to 127.0.0.1, by the variable that names them: the first is for version 2
(Jazzy), the second for version 3 (Kilted and later), which still reads the other's variable and cannot parse
its file."""
VERSIONS = {"FASTRTPS_DEFAULT_PROFILES_FILE": "fastrtps", "FASTDDS_DEFAULT_PROFILES_FILE": "fastdds"}
"""Folder in `share/` that the version of each variable has."""

DOMAIN = "ROS_DOMAIN_ID"
LAST_DOMAIN = 232

FAST_DDS = ("", "rmw_fastrtps_cpp")
"""Values of RMW_IMPLEMENTATION that read the profile."""


class NetworkError(TwinmatchError):
    """The nodes would be reachable from elsewhere, or cannot be told how to talk."""


class Network(Enum):
    """How far the nodes talk."""

    LOOPBACK = "loopback"
    """With nodes on this machine."""
    OPEN = "open"
    """As the ROS 2 variables of the environment say, which by default is with the whole network."""


def prepare(
    environment: MutableMapping[str, str] = os.environ, profiles: Mapping[str, Path] = PROFILES
) -> Network:
    """Set the variables ROS 2 reads when it starts; call it before `rclpy.init`.

    Besides the network this tells ROS 2 where its files are when it comes from wheels, and where it may
    write its logs when there is no home.

    Raises:
        NetworkError: `TWINMATCH_NETWORK` is neither `loopback` nor `open`, the profile is missing, the
            middleware is not Fast DDS and so would not read it, or there is no such domain.
    """
    _find_wheels(environment)
    _find_log_folder(environment)
    _check_domain(environment.get(DOMAIN, ""))
    value = environment.get(VARIABLE, Network.LOOPBACK.value)
    try:
        network = Network(value)
    except ValueError:
        msg = f"network: {VARIABLE} is {value!r}; use 'loopback' (the default) or 'open'"
        raise NetworkError(msg) from None
    if network is Network.OPEN:
        warning = f"NETWORK OPEN: {VARIABLE}=open, other machines may read and command these nodes"
        print(f"twinmatch: {warning}", file=sys.stderr, flush=True)
        return network
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware not in FAST_DDS:
        msg = (
            f"network: RMW_IMPLEMENTATION is {middleware}, which cannot be bound to this machine by us; "
            f"unset it, or write {VARIABLE}=open and restrict it yourself"
        )
        raise NetworkError(msg)
    for name in PROFILES:
        environment.pop(name, None)
    for name, profile in _installed(profiles, environment).items():
        if not profile.is_file():
            msg = (
                f"network: {profile} is missing, the nodes would talk to the whole network; "
                "reinstall twinmatch"
            )
            raise NetworkError(msg)
        environment[name] = str(profile)
    # Any narrower range makes rmw_fastrtps replace the transports of the profile by its own.
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
    for name in ("ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS"):
        environment.pop(name, None)
    return network


def shell_lines(environment: Mapping[str, str] = os.environ) -> list[str]:
    """What a shell has to run so that the programs it starts talk as our nodes do.

    Raises:
        NetworkError: as `prepare`.
    """
    prepared = dict(environment)
    prepare(prepared)
    changed = (name for name in sorted(prepared) if environment.get(name) != prepared[name])
    gone = sorted(set(environment) - set(prepared))
    return [f"export {name}={shlex.quote(prepared[name])}" for name in changed] + [
        f"unset {name}" for name in gone
    ]


def check_sockets() -> None:
    """Look at the sockets of this process; call it after the nodes were made.

    A profile that Fast DDS cannot read is one line in its log and a node on the network. Its two versions do
    not read each other's.

    Raises:
        NetworkError: a UDP socket is bound to an address that other machines reach.
    """
    elsewhere = [socket for socket in sockets_elsewhere() if socket.startswith("udp")]
    if elsewhere:
        told = " and ".join(path.name for path in PROFILES.values())
        msg = (
            f"network: bound to {', '.join(elsewhere)} in spite of {told}; stopped. "
            f"Reinstall twinmatch, or write {VARIABLE}=open if other machines may talk to these nodes"
        )
        raise NetworkError(msg)


def sockets_elsewhere(process: int | str = "self") -> list[str]:
    """Sockets of a process that other machines could reach, such as `udp 0.0.0.0:7400`.

    UDP sockets that are bound and TCP sockets that listen, on neither a loopback address nor a multicast
    group (those hear only the interfaces on which they joined). Empty where there is no /proc.
    """
    inodes = set(_socket_inodes(process))
    return [
        f"{kind} {address}:{port}"
        for kind in ("udp", "udp6", "tcp", "tcp6")
        for address, port, inode in _bound(process, kind)
        if inode in inodes and not (address.is_loopback or address.is_multicast)
    ]


def _check_domain(value: str) -> None:
    """DDS reckons its ports from the domain, and from 233 on there are none."""
    # A domain of "" is the domain 0, as ROS reads it.
    if value and not (value.isascii() and value.isdigit() and int(value[:9]) <= LAST_DOMAIN):
        msg = f"network: {DOMAIN} is {value[:40]!r}; it must be a whole number from 0 to {LAST_DOMAIN}"
        raise NetworkError(msg)


def _installed(profiles: Mapping[str, Path], environment: Mapping[str, str]) -> Mapping[str, Path]:
    """Those for the version of Fast DDS that is there; all of them where none is found."""
    prefixes = [
        Path(prefix) for prefix in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix
    ]
    here = {
        name: profile
        for name, profile in profiles.items()
        if any((prefix / "share" / VERSIONS[name]).is_dir() for prefix in prefixes)
    }
    return here or profiles


def _find_wheels(environment: MutableMapping[str, str]) -> None:
    """A sourced ROS 2 says where its files are; its wheels do not."""
    if "AMENT_PREFIX_PATH" not in environment and (Path(sys.prefix) / "share" / "rclpy").is_dir():
        environment["AMENT_PREFIX_PATH"] = sys.prefix


def _find_log_folder(environment: MutableMapping[str, str]) -> None:
    """Without a place for its logs ROS 2 does not start."""
    if "ROS_LOG_DIR" in environment or "ROS_HOME" in environment:
        return
    home = environment.get("HOME", "")
    if not home or not os.access(home, os.W_OK):
        environment["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="twinmatch-log-")


def _socket_inodes(process: int | str) -> Iterator[str]:
    try:
        descriptors = list(Path(f"/proc/{process}/fd").iterdir())
    except OSError:
        return
    for descriptor in descriptors:
        try:
            target = str(descriptor.readlink())
        except OSError:  # closed in the meantime
            continue
        if target.startswith("socket:["):
            yield target[8:-1]


def _bound(
    process: int | str, kind: str
) -> Iterator[tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int, str]]:
    try:
        lines = Path(f"/proc/{process}/net/{kind}").read_text().splitlines()[1:]
    except OSError:
        return
    for line in lines:
        fields = line.split()
        if kind.startswith("tcp") and fields[3] != "0A":  # not listening
            continue
        address, port = fields[1].split(":")
        yield _address(address), int(port, 16), fields[9]


def _address(digits: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """From the kernel's digits: words of four bytes, each in the byte order of the machine."""
    raw = bytes.fromhex(digits)
    if sys.byteorder == "little":
        raw = b"".join(raw[i : i + 4][::-1] for i in range(0, len(raw), 4))
    address = ipaddress.ip_address(raw)
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return mapped or address


if __name__ == "__main__":
    try:
        print("\n".join(shell_lines()))
    except NetworkError as error:
        print(error, file=sys.stderr)
        sys.exit(EXIT_USER_ERROR)
