"""What the servers of the live page and of Foxglove share."""

from __future__ import annotations

from ipaddress import ip_address

from twinmatch.errors import TwinmatchError
from twinmatch.parameters.declared import Setting


class ServingError(TwinmatchError):
    """The graph cannot be served, an option has an invalid value, or a request cannot be carried out."""


def unusable(server: str, address: str, port: int, cause: object) -> ServingError:
    """The error for an address or port that cannot be used."""
    return ServingError(
        f"{server}: {address}:{port} cannot be used: {cause}; "
        "choose another with --port (0: any free port) or --address"
    )


def place_settings(port: int) -> tuple[Setting, Setting]:
    """The parameters of a server's node for its address and port, with this default port."""
    return (
        Setting("address", "127.0.0.1", "Address to serve on; any but a loopback address is open to others."),
        Setting("port", port, "TCP port; 0: any free port.", "", 0, 65535),
    )


def warn_if_open(what: str, address: str, able: str) -> None:
    """Say on standard output that a server is open to other machines, if it is, and what they may do."""
    if not is_loopback(address):
        print(
            f"{what} OPEN: anyone who can reach {address} may {able}; the connection is not encrypted",
            flush=True,
        )


def is_loopback(address: str) -> bool:
    """Whether an address can be reached only from this machine."""
    if address == "localhost":
        return True
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False
