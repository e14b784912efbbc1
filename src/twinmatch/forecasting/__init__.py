"""What a twin says of samples nobody has seen, and the band that is to hold 90 % of them."""

from twinmatch.forecasting.errors import ForecastError
from twinmatch.forecasting.forecast import CONFIDENCE, HORIZONS, Band, Forecast

__all__ = ["CONFIDENCE", "HORIZONS", "Band", "Forecast", "ForecastError"]
