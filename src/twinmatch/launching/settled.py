"""How far the discriminator has come, as it says itself on /diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray

from twinmatch.nodes.discriminator import SETTLED, VERDICTS, DiscriminatorNode

__all__ = ["Settled"]


class Settled:
    """Listens to the discriminator's reports."""

    def __init__(self) -> None:
        """Begin with nothing heard."""
        self._sample: int | None = None
        self._verdicts = 0

    def take(self, message: DiagnosticArray) -> None:
        """Take what nodes report; that of others is passed over."""
        for status in message.status:
            if status.name.endswith(f"{DiscriminatorNode.NAME}: health"):
                values = {entry.key: entry.value for entry in status.values}
                settled = values.get(SETTLED, "")
                self._sample = int(settled) if settled.isdigit() else None
                self._verdicts = int(values.get(VERDICTS, "0"))

    def all_said(self, last: int, heard: int) -> bool:
        """Whether everything is said up to sample `last`, and this many verdicts are all there are."""
        return self._sample is not None and self._sample >= last and heard >= self._verdicts
