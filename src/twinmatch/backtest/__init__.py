"""The report card of a twin: its forecasts against what came, beside what a user would take instead."""
