"""The page's own help: what is on it, what it means, and what to do about it."""

from __future__ import annotations

from typing import Final

__all__ = ["HELP"]

HELP: Final[tuple[tuple[str, str, str], ...]] = (
    (
        "trusted ✓",
        "What came lies in the bands that the leader had given before.",
        "Nothing. Ask it what comes next.",
    ),
    (
        "doubtful !",
        "What came lies outside those bands: the twin and the plant have drifted apart.",
        "Do not rely on forecasts. Let the plant step and settle, so that a twin is matched anew.",
    ),
    (
        "fault ✕",
        "The plant does what no twin explains. “What to do” says where to look.",
        "Look at the plant: drive, sensor, cables.",
    ),
    (
        "unknown ?",
        "Nothing has come yet of what a twin foretold.",
        "Wait, or let the set-point step.",
    ),
    (
        "leader",
        "The twin whose forecasts have been worth most. It may change; the time line says when.",
        "Ask it: “What if” moves nothing.",
    ),
    (
        "nominal",
        "The centre of the family: behaves most like all the others (smallest sum of ν-gaps).",
        "Take its parameters if one set has to stand for the plant.",
    ),
    (
        "forecast and band",
        "Dashed, to the right of the newest sample: what the leader foretells if the set-point stays, and "
        "the band that holds nine readings in ten.",
        "Compare what comes with the band; most of it should lie inside.",
    ),
    (
        "plant − twin",
        "What the twins get wrong, with a band of ± 2 RMS. The closed-loop twin is given the set-point, the "
        "driven twin the measured input.",
        "Watch for a residual that leaves its band and stays outside.",
    ),
    (
        "what happened",
        "Matches admitted or refused, changes of trust and leader, faults, errors of nodes; each with its "
        "reason.",
        "Read the reason; every one says what would help.",
    ),
    (
        "ν-gap",
        "How differently two candidates' plants behave in a loop: 0 the same, 1 as different as can be.",
        "Nothing; rows that are dark throughout are odd ones out.",
    ),
    (
        "nodes need a look",
        "A program of the graph warns, reports an error or is silent.",
        "Scroll down to “Nodes”: each says what is wrong.",
    ),
    (
        "the replay has ended",
        "The session has been played to its end; nothing is wrong and nothing more comes.",
        "Play another one, or close the page.",
    ),
)
"""Name on the page, what it means, what to do."""
