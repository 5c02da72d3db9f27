"""Exploration strategies: they choose the next target of a robot. Most files implement a paper each.

Strategies combine the algorithms of `agent.planning`. Begin with `meier.py`, the shortest. `base.py` is the interface,
`targets.py` the common part of all strategies that drive to targets, and `registry.py` finds a strategy by its name. A
new strategy is a new file here, or a plug-in (`protocol.plugins`).
"""
