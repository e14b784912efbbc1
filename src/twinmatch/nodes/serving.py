"""What commands that serve the graph to somebody have in common: address, port, namespace."""

from __future__ import annotations

import argparse
import importlib.util
import re
from ipaddress import ip_address

from twinmatch.errors import TwinmatchError

__all__ = ["add_serving_arguments", "check_serving", "is_loopback", "namespace_words"]


def add_serving_arguments(parser: argparse.ArgumentParser, port: int) -> None:
    """Declare where to serve (`port` unless told otherwise) and whose graph."""
    parser.add_argument(
        "--address",
        default="127.0.0.1",
        help="serve on this address; others than 127.0.0.1 are open to others",
    )
    parser.add_argument("--port", type=int, default=port, help=f"TCP port ({port}); 0: any that is free")
    parser.add_argument("--namespace", default="", metavar="/RIG", help="namespace of the plant to show")


def check_serving(
    command: str, options: argparse.Namespace, library: str, error: type[TwinmatchError]
) -> None:
    """Refuse a port that cannot be, and a machine without ROS or `library`, of the extra named `command`.

    Raises:
        TwinmatchError: of the type `error`.
    """
    if not 0 <= options.port <= 65535:
        msg = f"{command}: there is no port {options.port}; give one from 0 to 65535"
        raise error(msg)
    for name, extra in ((library, command), ("rclpy", "ros")):
        if importlib.util.find_spec(name) is None:
            msg = f"{command}: {name} is not installed; pip install 'twinmatch[{extra}]'"
            raise error(msg)


def namespace_words(command: str, namespace: str, error: type[TwinmatchError]) -> list[str]:
    """ROS arguments that put a node into a namespace; none for an empty one.

    Raises:
        TwinmatchError: of the type `error`, if it is no namespace.
    """
    if not namespace:
        return []
    if re.fullmatch(r"(/?[A-Za-z_][A-Za-z0-9_]*)+", namespace) is None:
        msg = f"{command}: {namespace!r} is no namespace; give one such as /rig_a"
        raise error(msg)
    return ["-r", f"__ns:=/{namespace.removeprefix('/')}"]


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches an address."""
    if address == "localhost":
        return True
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False
