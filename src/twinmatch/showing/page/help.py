"""The page's help table: what is on the page, what it means, and what to do."""

from __future__ import annotations

from typing import Final

__all__ = ["HELP"]

HELP: Final[tuple[tuple[str, str, str], ...]] = (
    (
        "trusted ✓",
        "The measurements lie within the leader's forecast bands.",
        "Nothing. Ask the leader what comes next.",
    ),
    (
        "doubtful !",
        "The measurements lie outside those bands: the twin and the plant have drifted apart.",
        "Do not rely on forecasts. Let the plant step and settle, so that a twin is matched again.",
    ),
    (
        "fault ✕",
        "No twin explains the plant's behaviour. “What to do” says where to look.",
        "Look at the plant: drive, sensor, cables.",
    ),
    (
        "unknown ?",
        "No forecast has been compared with measurements yet.",
        "Wait, or step the set-point.",
    ),
    (
        "leader",
        "The twin with the best forecasts so far. The leader may change; the time line shows when.",
        "Ask it: “What if” does not move the plant.",
    ),
    (
        "nominal",
        "The centre of the family: the twin closest to all the others (smallest sum of ν-gaps).",
        "Use its parameters if a single set has to represent the plant.",
    ),
    (
        "forecast and band",
        "Dashed, to the right of the newest sample: the leader's forecast for a constant set-point, and the "
        "band that contains nine measurements in ten.",
        "Compare new measurements with the band; most of them should lie inside.",
    ),
    (
        "plant − twin",
        "The residuals of the twins, with a band of ± 2 RMS. The input of the closed-loop twin is the "
        "set-point, that of the driven twin the measured plant input.",
        "Watch for a residual that leaves its band and stays outside.",
    ),
    (
        "what happened",
        "Matches admitted or refused, changes of trust and leader, faults, errors of nodes; each with its "
        "reason.",
        "Read the reason; it says what would help.",
    ),
    (
        "ν-gap",
        "How differently two candidates' plants behave in closed loop: 0 the same, 1 entirely different.",
        "Nothing; a row that is dark throughout is an outlier.",
    ),
    (
        "nodes need attention",
        "A node of the graph reports a warning or an error, or is silent.",
        "Scroll down to “Nodes”: it shows each node's report.",
    ),
    (
        "the replay has ended",
        "The session has been played to its end; nothing is wrong, and no more samples will come.",
        "Play another session, or close the page.",
    ),
)
"""Name on the page, what it means, what to do."""
