"""Options shared by the commands that serve the graph: address, port, namespace."""

from __future__ import annotations

import argparse
import importlib.util
import re
from ipaddress import ip_address

from twinmatch.errors import TwinmatchError


def add_serving_arguments(parser: argparse.ArgumentParser, port: int) -> None:
    """Declare the options for the address, the port (default `port`) and the namespace."""
    parser.add_argument(
        "--address",
        default="127.0.0.1",
        help="serve on this address; any but 127.0.0.1 is open to other machines",
    )
    parser.add_argument(
        "--port", type=int, default=port, help=f"TCP port (default: {port}); 0: any free port"
    )
    parser.add_argument("--namespace", default="", metavar="/RIG", help="namespace of the plant to show")


def check_serving(
    command: str, options: argparse.Namespace, library: str, error: type[TwinmatchError]
) -> None:
    """Check the port, and that ROS and `library` (from the extra named `command`) are installed.

    Raises:
        TwinmatchError: of the type `error`.
    """
    if not 0 <= options.port <= 65535:
        msg = f"{command}: --port is {options.port}; give a port from 0 to 65535"
        raise error(msg)
    for name, extra in ((library, command), ("rclpy", "ros")):
        if importlib.util.find_spec(name) is None:
            msg = f"{command}: {name} is not installed; pip install 'twinmatch[{extra}]'"
            raise error(msg)


def namespace_words(command: str, namespace: str, error: type[TwinmatchError]) -> list[str]:
    """ROS arguments that put a node into a namespace; none for an empty one.

    Raises:
        TwinmatchError: of the type `error`, if it is not a namespace.
    """
    if not namespace:
        return []
    if re.fullmatch(r"(/?[A-Za-z_][A-Za-z0-9_]*)+", namespace) is None:
        msg = f"{command}: {namespace!r} is not a namespace; give one such as /rig_a"
        raise error(msg)
    return ["-r", f"__ns:=/{namespace.removeprefix('/')}"]


def is_loopback(address: str) -> bool:
    """Whether an address can be reached only from this machine."""
    if address == "localhost":
        return True
    try:
        return ip_address(address).is_loopback
    except ValueError:
        return False
