"""A forecast by a single twin in one call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from twinmatch.dynamics import Foresight, Law, LoopForecast, Parameters, law_of


def forecast_loop(
    parameters: Parameters,
    *,
    states: Any,
    covariance: Any,
    input: Any,
    drift: Any,
    unsure: Sequence[str] = (),
    reference: Any = None,
    controller: Any = None,
    law: Law | None = None,
    inputs: Any = None,
    disturbances: Any = None,
    **how: Any,
) -> LoopForecast:
    """Of the loop under these set-points, by default with the plant file's law at 1 s; or under inputs."""
    loop = None if reference is None else law or law_of(parameters.model.plant, 1.0)
    foresight = Foresight([(parameters, unsure)], loop, drift=[drift], **how)
    beginning = foresight.at([states], [covariance], input, controller)
    return foresight.ahead(
        beginning, inputs if reference is None else reference, disturbances
    )
