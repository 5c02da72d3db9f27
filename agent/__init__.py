"""A robot: its control logic and its process, with map, outlines, teammates, plans.

It imports `protocol` only. Strategies build on `planning`, map encodings on `outline`, `predictive`, and `mapping`, and
all of them on the settings. Start with `robot.py`, one pass of the thesis' Algorithm 10; `process.py` is the shell
around it.
"""
