"""The physical world: maps, laser, motion and the clock.

It imports `protocol` only. Start with `world.py`, the true state step by step; `process.py` is the shell around it.
"""
