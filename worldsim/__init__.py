"""The simulated world: maps, lasers and their errors, the motion of robots and people, and the clock.

It imports `protocol` only. Start with `world.py`, the true state step by step; `process.py` is the shell around it.
"""
