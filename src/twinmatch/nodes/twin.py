"""The three nodes of the twin in one process, as the launch scripts start them."""

from __future__ import annotations

from twinmatch.nodes.discriminator import DiscriminatorNode
from twinmatch.nodes.matcher import MatcherNode
from twinmatch.nodes.runner import program
from twinmatch.nodes.twin_simulator import TwinSimulatorNode

main = program(TwinSimulatorNode, MatcherNode, DiscriminatorNode)


if __name__ == "__main__":
    main()
