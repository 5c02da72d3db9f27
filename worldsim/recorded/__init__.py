"""Logs of real robots as a world: readers of log formats, and the world that replays them.

Begin with `log`, the common form of all logs, and `world`.
"""
