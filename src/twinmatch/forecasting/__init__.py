"""What a twin says of samples nobody has seen, and the band that is to hold 90 % of them.

`Follower` carries a twin's states beside the plant, an `Outlook` is a twin at one sample and gives a
`Forecast` for any set-points ahead. `SetPoints` says which those are; `time_to_reach`, `time_held` and
`largest_input` read from a forecast what people ask of it, and `what_if` answers a whole `Question`.
`Calibration` learns from what came how wide bands have to be, and the `Ledger` what every candidate's
forecasts have cost.
"""

from twinmatch.forecasting.answers import Moment, Peak, largest_input, time_held, time_to_reach
from twinmatch.forecasting.bands import Calibration, leads_of
from twinmatch.forecasting.errors import ForecastError
from twinmatch.forecasting.follower import Follower
from twinmatch.forecasting.forecast import CONFIDENCE, HORIZONS, Band, Forecast
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
    "largest_input",
    "leads_of",
    "time_held",
    "time_to_reach",
    "what_if",
]
