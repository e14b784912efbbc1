"""Progress of the discriminator, from its reports on /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray

from twinmatch.nodes.discriminator import SETTLED, VERDICTS, DiscriminatorNode

__all__ = ["Settled"]


class Settled:
    """Follows the discriminator's reports."""

    def __init__(self) -> None:
        """Start without a report."""
        self._sample: int | None = None
        self._verdicts = 0

    def take(self, message: DiagnosticArray) -> None:
        """Take a message; reports of other nodes are ignored."""
        for status in message.status:
            if status.name.endswith(f"{DiscriminatorNode.NAME}: health"):
                values = {entry.key: entry.value for entry in status.values}
                settled = values.get(SETTLED, "")
                self._sample = int(settled) if settled.isdigit() else None
                self._verdicts = int(values.get(VERDICTS, "0"))

    def complete(self, last: int, received: int) -> bool:
        """Whether all is judged up to sample `last`, and `received` verdicts are all that were published."""
        return self._sample is not None and self._sample >= last and received >= self._verdicts
