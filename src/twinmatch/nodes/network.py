"""Restrict the nodes to this machine, unless the network is explicitly opened.

By default ROS 2 sends discovery to the whole network and listens on every interface, and the wheels have no
DDS security. So every node binds to the loopback interface, and stops if it cannot: the profile is checked
before ROS starts, and the sockets after it has started. `TWINMATCH_NETWORK=open` in the environment leaves
the network to the usual ROS 2 variables instead.

Other programs need none of this to read our topics, but without it they listen on the network themselves.
`python -m twinmatch.nodes.network` prints the variables to set for them in a shell.
"""

from __future__ import annotations

import contextlib
import hashlib
import ipaddress
import os
import re
import shlex
import sys
from collections.abc import Iterator, Mapping, MutableMapping
from enum import Enum
from pathlib import Path

from twinmatch.errors import EXIT_USER_ERROR, TwinmatchError
from twinmatch.kept import cache_folder

VARIABLE = "TWINMATCH_NETWORK"
"""Environment variable whose value is that of a `Network`."""

PROFILES = {
    "FASTRTPS_DEFAULT_PROFILES_FILE": Path(__file__).with_name("fastdds2_loopback.xml"),
    "FASTDDS_DEFAULT_PROFILES_FILE": Path(__file__).with_name("fastdds3_loopback.xml"),
}
"""Profiles that bind Fast DDS to 127.0.0.1, by environment variable: the first is for version 2 (Jazzy), the
second for version 3 (Kilted and later), which also reads the first variable but cannot parse its file."""
VERSIONS = {
    "FASTRTPS_DEFAULT_PROFILES_FILE": "fastrtps",
    "FASTDDS_DEFAULT_PROFILES_FILE": "fastdds",
}
"""Folder in `share/` of the Fast DDS version that belongs to each variable."""

LEASE = "TWINMATCH_LEASE"
"""Environment variable with another lease than that of the profile: the time after which a node that says
nothing is forgotten, whole s. Where a plant waits for its graph, no suspended process may be forgotten."""

DOMAIN = "ROS_DOMAIN_ID"
LAST_DOMAIN = 232

FAST_DDS = ("", "rmw_fastrtps_cpp")
"""Values of RMW_IMPLEMENTATION that read the profile."""


class NetworkError(TwinmatchError):
    """The nodes would be reachable from other machines, or the network cannot be configured."""


class Network(Enum):
    """Which machines the nodes communicate with."""

    LOOPBACK = "loopback"
    """This machine only."""
    OPEN = "open"
    """As set by the ROS 2 variables of the environment; by default, the whole network."""


def prepare(
    environment: MutableMapping[str, str] = os.environ,
    profiles: Mapping[str, Path] = PROFILES,
) -> Network:
    """Set the variables that ROS 2 reads when it starts; call it before `rclpy.init`.

    Besides the network, this sets where ROS 2 finds its files when installed from wheels.

    Raises:
        NetworkError: `TWINMATCH_NETWORK` is neither `loopback` nor `open`, the profile is missing, the
            middleware is not Fast DDS and so would not read the profile, or the domain is invalid.
    """
    _find_wheels(environment)
    _check_domain(environment.get(DOMAIN, ""))
    value = environment.get(VARIABLE, Network.LOOPBACK.value)
    try:
        network = Network(value)
    except ValueError:
        msg = (
            f"network: {VARIABLE} is {value!r}; use 'loopback' (the default) or 'open'"
        )
        raise NetworkError(msg) from None
    if network is Network.OPEN:
        warning = f"NETWORK OPEN: {VARIABLE}=open, other machines can read and command these nodes"
        print(f"twinmatch: {warning}", file=sys.stderr, flush=True)
        return network
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    if middleware not in FAST_DDS:
        raise NetworkError(
            f"network: RMW_IMPLEMENTATION is {middleware}, which twinmatch cannot restrict to this machine; "
            f"unset it, or set {VARIABLE}=open and restrict it yourself"
        )
    for name in PROFILES:
        environment.pop(name, None)
    for name, profile in _installed(profiles, environment).items():
        if not profile.is_file():
            raise NetworkError(
                f"network: {profile} is missing, without which the nodes would be open to the whole network; "
                "reinstall twinmatch"
            )
        environment[name] = str(_with_lease(profile, environment.get(LEASE, "")))
    # With any narrower range, rmw_fastrtps replaces the transports of the profile with its own.
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SYSTEM_DEFAULT"
    for name in ("ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS"):
        environment.pop(name, None)
    return network


@contextlib.contextmanager
def lease(seconds: float | None) -> Iterator[None]:
    """Let this process, if ROS has not started yet, and its children have this lease, s (None: as it is)."""
    before = os.environ.get(LEASE)
    if seconds is not None:
        os.environ[LEASE] = f"{seconds:.0f}"
    try:
        yield
    finally:
        os.environ.pop(LEASE, None)
        if before is not None:
            os.environ[LEASE] = before


def _with_lease(profile: Path, seconds: str) -> Path:
    """A profile with another lease, in the user's cache; the profile itself if there is none.

    Raises:
        NetworkError: the lease is not a whole number, or the cache cannot be written.
    """
    if not seconds:
        return profile
    if not seconds.isdecimal():
        raise NetworkError(f"network: {LEASE} is {seconds!r}; give whole seconds")
    changed = re.sub(
        r"(<leaseDuration><sec>)\d+", rf"\g<1>{seconds}", profile.read_text("utf-8")
    )
    digest = hashlib.sha256(changed.encode()).hexdigest()[:12]
    profile_copy = cache_folder() / f"{profile.stem}-{digest}.xml"
    try:
        profile_copy.parent.mkdir(parents=True, exist_ok=True)
        part = profile_copy.with_name(f"{profile_copy.name}.{os.getpid()}")
        part.write_text(changed, "utf-8")
        part.replace(profile_copy)
    except OSError as error:
        raise NetworkError(
            f"network: {profile_copy} cannot be written ({error.strerror})"
        ) from error
    return profile_copy


def shell_lines(environment: Mapping[str, str] = os.environ) -> list[str]:
    """Shell commands after which the programs of that shell communicate as our nodes do.

    Raises:
        NetworkError: as `prepare`.
    """
    prepared = dict(environment)
    prepare(prepared)
    changed = (
        name for name in sorted(prepared) if environment.get(name) != prepared[name]
    )
    gone = sorted(set(environment) - set(prepared))
    return [f"export {name}={shlex.quote(prepared[name])}" for name in changed] + [
        f"unset {name}" for name in gone
    ]


def log_arguments(environment: Mapping[str, str] = os.environ) -> list[str]:
    """Arguments for `rclpy.init` with which ROS 2 writes no files of logs, where it has no folder for them.

    It does not start otherwise. What nodes log is printed all the same, and published on /rosout.
    """
    if "ROS_LOG_DIR" in environment or "ROS_HOME" in environment:
        return []
    home = environment.get("HOME", "")
    return (
        []
        if home and os.access(home, os.W_OK)
        else ["--ros-args", "--disable-external-lib-logs"]
    )


def check_sockets() -> None:
    """Check the sockets of this process; call it after the nodes were created.

    If Fast DDS cannot parse its profile, it only logs a line and opens the node to the network. Its versions
    2 and 3 cannot parse each other's profiles.

    Raises:
        NetworkError: a UDP socket is bound to an address that other machines can reach.
    """
    elsewhere = [socket for socket in sockets_elsewhere() if socket.startswith("udp")]
    if elsewhere:
        profiles = " and ".join(path.name for path in PROFILES.values())
        raise NetworkError(
            f"network: bound to {', '.join(elsewhere)} in spite of {profiles}; stopped. Reinstall "
            f"twinmatch, or set {VARIABLE}=open if other machines may communicate with these nodes"
        )


def sockets_elsewhere(process: int | str = "self") -> list[str]:
    """Sockets of a process that other machines could reach, such as `udp 0.0.0.0:7400`.

    These are bound UDP sockets and listening TCP sockets, except on a loopback address or a multicast group
    (which receives only from the interfaces it joined on). Empty where there is no /proc.
    """
    inodes = set(_socket_inodes(process))
    elsewhere = []
    for kind in ("udp", "udp6", "tcp", "tcp6"):
        for address, port, inode in _bound(process, kind):
            if inode in inodes and not (address.is_loopback or address.is_multicast):
                elsewhere.append(f"{kind} {address}:{port}")
    return elsewhere


def _check_domain(value: str) -> None:
    """Refuse a domain for which DDS, which computes its ports from it, has none: those from 233 on."""
    # ROS reads "" as domain 0.
    if value and not (
        value.isascii() and value.isdigit() and int(value[:9]) <= LAST_DOMAIN
    ):
        msg = f"network: {DOMAIN} is {value[:40]!r}; it must be a whole number from 0 to {LAST_DOMAIN}"
        raise NetworkError(msg)


def _installed(
    profiles: Mapping[str, Path], environment: Mapping[str, str]
) -> Mapping[str, Path]:
    """The profiles for the installed version of Fast DDS; all of them if none is found."""
    prefixes = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    shares = [Path(prefix) / "share" for prefix in prefixes if prefix]
    of_installed_version = {}
    for name, profile in profiles.items():
        if any((share / VERSIONS[name]).is_dir() for share in shares):
            of_installed_version[name] = profile
    return of_installed_version or profiles


def _find_wheels(environment: MutableMapping[str, str]) -> None:
    """Set AMENT_PREFIX_PATH for a ROS 2 from wheels; a sourced ROS 2 sets it itself."""
    if (
        "AMENT_PREFIX_PATH" not in environment
        and (Path(sys.prefix) / "share" / "rclpy").is_dir()
    ):
        environment["AMENT_PREFIX_PATH"] = sys.prefix


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
    """Parse the kernel's hexadecimal digits: four-byte words, each in the machine's byte order."""
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
