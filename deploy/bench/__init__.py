"""`murmur bench`: each figure as a ratio against a named yardstick that is measured in the same run.

It builds on `run`, independent of `after` and `study`. Start with `ratios.py`, which lists the benches; a bench
yields figures. Only ratios carry over to other machines, so absolute timings are never asserted.
"""
