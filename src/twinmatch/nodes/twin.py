"""The three nodes of the twin in one process, as the launch scripts start them."""

from __future__ import annotations

import sys

from twinmatch.nodes.discriminator import DiscriminatorNode
from twinmatch.nodes.matcher import MatcherNode
from twinmatch.nodes.runner import run
from twinmatch.nodes.twin_simulator import TwinSimulatorNode

__all__ = ["main"]


def main() -> None:
    """Console script."""
    sys.exit(run([TwinSimulatorNode, MatcherNode, DiscriminatorNode]))


if __name__ == "__main__":
    main()
