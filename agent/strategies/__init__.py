"""Where to go next: one file a paper.

They are made of the parts in `agent.planning`. Begin with `meier.py`, the shortest; `targets.py` has what all
that drive to targets share, `base.py` what a strategy is, and `registry.py` finds one by its name. A new strategy
is one new file here, or a class in any importable module, named ``package.module:Class``.
"""
