"""What figures are made of: panels with their rulers, and SVG documents.

The modules of this package import matplotlib, so they are imported where the first figure is drawn.
"""
