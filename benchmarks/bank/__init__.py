"""Simulated kits with two loops, to which things happen, and what the monitor of several signals says.

`python -m benchmarks.bank 6` makes the table.
"""
