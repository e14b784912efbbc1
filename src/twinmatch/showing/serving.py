"""What the servers of the live page and of Foxglove share."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Final

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


def place_settings(port: int) -> tuple[Setting, ...]:
    """The parameters of a server's node for its address, port and names, with this default port."""
    return (
        Setting(
            "address",
            "127.0.0.1",
            "Address to serve on; any but a loopback address is open to others.",
        ),
        Setting("port", port, "TCP port; 0: any free port.", "", 0, 65535),
        Setting(
            "hosts",
            [],
            "Names it answers to besides those of loopback and its address.",
        ),
    )


def listen(server: str, address: str, port: int) -> tuple[socket.socket, str]:
    """A socket that listens on an address, and the place it is reached at, as in a URL; port 0: any free one.

    Raises:
        ServingError: the address or port cannot be used.
    """
    try:
        family, kind, number, _, place = socket.getaddrinfo(
            address, port, type=socket.SOCK_STREAM
        )[0]
        bound = socket.socket(family, kind, number)
        try:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.setblocking(False)
            bound.bind(place)
            bound.listen(128)
        except OSError:
            bound.close()
            raise
    except OSError as error:
        raise unusable(server, address, port, error.strerror or error) from error
    host = f"[{address}]" if ":" in address else address
    return bound, f"{host}:{bound.getsockname()[1]}"


@dataclass(frozen=True)
class Hosts:
    """The names a server answers to, so that a foreign name that resolves to this machine opens nothing.

    Loopback names and addresses are always among them. An address cannot be made to resolve to another one,
    so that a server which is open to others answers to every address.
    """

    own: frozenset[str]
    """Names of this machine."""
    given: frozenset[str]
    """Names that the user gave; pages that come from there may use the server, too."""
    addresses: bool
    """Whether it answers to every address."""

    @classmethod
    def of(cls, address: str, named: Iterable[str] = ()) -> Hosts:
        """The names of a server on this address, and those that the user gave."""
        closed = is_loopback(address)
        names = (
            {}
            if closed
            else {
                address.lower(),
                socket.gethostname().lower(),
                socket.getfqdn().lower(),
            }
        )
        return cls(
            frozenset(names), frozenset(name.lower() for name in named), not closed
        )

    def refusal(
        self, host: str | None, origin: str | None, *, beside: bool = False
    ) -> str:
        """Why a request with these headers is refused, in a sentence; empty if it is not.

        With `beside`, pages of other servers of this machine and pages from files may use this server.
        """
        name = _name_in(host or "")
        if not (
            is_loopback(name)
            or name in self.own | self.given
            or (self.addresses and _is_address(name))
        ):
            reason = (
                f"under the name {_short(name)}"
                if name
                else "to a request without a host's name"
            )
            return f"this server does not answer {reason}; open it by its address, or name the host with --host"
        if origin is None:
            return ""
        _, _, place = origin.partition("://")
        origin_host = _name_in(place)
        if origin_host and (
            place.lower() == (host or "").lower() or origin_host in self.given
        ):
            return ""
        if beside and (origin == "file://" or is_loopback(origin_host)):
            return ""
        return f"a page of {_short(origin)} may not use this server; --host NAME lets those of a host use it"


_HOST: Final = re.compile(
    r"(?:\[([0-9a-f:.]+)\]|([\w.-]+))(?::\d{1,5})?", re.ASCII | re.IGNORECASE
)


def _name_in(host: str) -> str:
    """The name or address in `name:port`; empty if it is not that."""
    parts = _HOST.fullmatch(host)
    return "" if parts is None else (parts[1] or parts[2]).lower().removesuffix(".")


def _short(text: str) -> str:
    return ascii(text[:80])


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def warn_if_open(name: str, address: str, able: str) -> None:
    """Say on standard output that a server is open to other machines, if it is, and what they may do."""
    if not is_loopback(address):
        print(
            f"{name} OPEN: anyone who can reach {address} may {able}; the connection is not encrypted",
            flush=True,
        )


def is_loopback(address: str) -> bool:
    """Whether an address can be reached only from this machine."""
    return address == "localhost" or (
        _is_address(address) and ip_address(address).is_loopback
    )
