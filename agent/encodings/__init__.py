"""Map encodings: how a robot's map becomes log entries, and entries become a map again.

There are `polygons`, `scans`, `cells`, `predictive`, `none`, and two baselines from ROS: `slam-toolbox` and
`zstd-maps`. Begin with `base.py`, their interface; `catalog.py` finds an encoding by its name.
"""
