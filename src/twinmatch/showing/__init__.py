"""Verdicts for people and as JSON for other programs.

What is shown is computed once, so that terminal, live page, report and notebook show the same values:
`verdicts` says what verdicts say in rows, words, events and trust over time, `summary` what a session comes
to, `family` who the candidates are, `forecasts` what is to come, `series` what plant and twins did, and
`quantities` gives numbers, names and units. `lines`, `terminal`, `figures`, `report`, `page` and `foxglove`
draw it, in the colours of `style`.
"""
