"""A robot: its control logic and its process, with map, outlines, teammates, plans.

It imports `protocol` only; inside, strategies and exchanges build on `outline` and `planning`, and both on the
settings. Start with `robot.py`, one pass of the thesis' Algorithm 10; `process.py` is the shell around it.
"""
