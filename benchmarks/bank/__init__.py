"""A bank of hypotheses about plants with several inputs and outputs, beside the monitor of one loop.

`kernels` moves filters and traces on, `hypotheses` is the table of what may happen, `evidence` weighs it,
`monitor` names it. `python -m benchmarks.bank 6` shows what is said of simulated kits with two heaters.
"""
