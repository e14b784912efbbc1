"""The report card of a twin: its forecasts against what came, beside what a user would take instead.

`scoring` judges one forecast, `summary` many; the peers forecast from the same samples and set-points as the
twin and know nothing else. Import from these modules: they are slow to load, and `--help` is not.
"""
