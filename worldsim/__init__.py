"""The physical world: maps, laser, motion and the clock.

It imports `protocol` only. Begin with `world.py`, the truth step by step; `process.py` is the shell around it.
"""
