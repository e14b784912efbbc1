"""What a twin says of samples nobody has seen, and the band that is to hold 90 % of them.

`SetPoints` says which set-points a forecast is made for; `time_to_reach`, `time_held` and `largest_input`
read from a `Forecast` what people ask of it.
"""

from twinmatch.forecasting.answers import Moment, Peak, largest_input, time_held, time_to_reach
from twinmatch.forecasting.errors import ForecastError
from twinmatch.forecasting.forecast import CONFIDENCE, HORIZONS, Band, Forecast
from twinmatch.forecasting.profile import SetPoints

__all__ = [
    "CONFIDENCE",
    "HORIZONS",
    "Band",
    "Forecast",
    "ForecastError",
    "Moment",
    "Peak",
    "SetPoints",
    "largest_input",
    "time_held",
    "time_to_reach",
]
