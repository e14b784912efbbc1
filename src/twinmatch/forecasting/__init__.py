"""Forecasts of future samples by a twin, with bands that are to hold 90 % of them.

`StateFilter` estimates a twin's states beside the plant; an `Outlook` is a twin at one sample and gives a
`Forecast` for any future set-points. `SetPoints` defines these; `time_to_reach`, `settling_time` and
`largest_input` evaluate a forecast, and `what_if` answers a complete `Question`. `Calibration` learns the
width of the bands from past errors, and the `Ledger` keeps the cost of every candidate's forecasts, and how
much better they are than those of the baselines, which need no twin.
"""

from twinmatch.fitting.arx import Arx, ArxForecast
from twinmatch.forecasting.arrival import Arrival, ArrivalQuestion, arrival
from twinmatch.forecasting.calibration import Calibration, leads_of
from twinmatch.forecasting.forecast import (
    CONFIDENCE,
    HORIZONS,
    Band,
    Forecast,
    ForecastError,
)
from twinmatch.forecasting.ledger import Ledger
from twinmatch.forecasting.outlook import Followers, Outlook, StateFilter
from twinmatch.forecasting.set_points import SetPoints
from twinmatch.forecasting.what_if import (
    MAX_SAMPLES,
    NEAR,
    Moment,
    Question,
    WhatIfResult,
    largest_input,
    settling_time,
    time_to_reach,
    what_if,
)

__all__ = [
    "CONFIDENCE",
    "HORIZONS",
    "MAX_SAMPLES",
    "NEAR",
    "Arrival",
    "ArrivalQuestion",
    "Arx",
    "ArxForecast",
    "Band",
    "Calibration",
    "Followers",
    "Forecast",
    "ForecastError",
    "Ledger",
    "Moment",
    "Outlook",
    "Question",
    "SetPoints",
    "StateFilter",
    "WhatIfResult",
    "arrival",
    "largest_input",
    "leads_of",
    "settling_time",
    "time_to_reach",
    "what_if",
]
