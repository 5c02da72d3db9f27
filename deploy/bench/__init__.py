"""`murmur bench`: each figure as a ratio against a named yardstick that is taken in the same run.

It stands on `run`, beside `after` and `study`. Begin with `ratios.py`, which lists the benches; a bench yields
figures. Timings go on other people's machines by their ratios, so absolute ones are never asserted.
"""
