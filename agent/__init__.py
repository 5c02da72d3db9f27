"""A robot's mind, and its process: map, outlines, teammates, plans.

It imports `protocol` only; inside, strategies and exchanges stand on `outline` and `planning`, and both on the
settings. Begin with `robot.py`, one pass of the thesis' Algorithm 10; `process.py` is the shell around it.
"""
