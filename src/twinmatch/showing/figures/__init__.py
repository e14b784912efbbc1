"""Figures of a judged session, drawn with matplotlib.

Each module draws one kind of figure and writes no files; `save`, `png` and `svg` in `drawing` do that. No
module but those of `elements` imports matplotlib, which is slow; drawing the first figure does.
"""
