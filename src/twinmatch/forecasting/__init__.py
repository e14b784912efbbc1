"""Forecasts of future samples by a twin, with bands that are to hold 90 % of them.

`Follower` estimates a twin's states beside the plant; an `Outlook` is a twin at one sample and gives a
`Forecast` for any future set-points. `SetPoints` defines these; `time_to_reach`, `time_held` and
`largest_input` evaluate a forecast, and `what_if` answers a complete `Question`. `Calibration` learns the
width of the bands from past errors, and the `Ledger` keeps the cost of every candidate's forecasts.
"""

from twinmatch.forecasting.answers import Moment, Peak, largest_input, time_held, time_to_reach
from twinmatch.forecasting.bands import Calibration, leads_of
from twinmatch.forecasting.errors import ForecastError
from twinmatch.forecasting.follower import Follower
from twinmatch.forecasting.forecast import CONFIDENCE, HORIZONS, Band, Forecast, horizons_for, stretched
from twinmatch.forecasting.ledger import PERSISTENCE, Ledger
from twinmatch.forecasting.outlook import Outlook
from twinmatch.forecasting.profile import SetPoints
from twinmatch.forecasting.what_if import NEAR, Answer, Question, what_if

__all__ = [
    "CONFIDENCE",
    "HORIZONS",
    "NEAR",
    "PERSISTENCE",
    "Answer",
    "Band",
    "Calibration",
    "Follower",
    "Forecast",
    "ForecastError",
    "Ledger",
    "Moment",
    "Outlook",
    "Peak",
    "Question",
    "SetPoints",
    "horizons_for",
    "largest_input",
    "leads_of",
    "stretched",
    "time_held",
    "time_to_reach",
    "what_if",
]
