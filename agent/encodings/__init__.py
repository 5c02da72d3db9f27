"""Map encodings: how a robot's map becomes log entries, and entries become a map again.

There are five: `polygons`, `scans`, `cells`, `predictive` and `none`. Begin with `base.py`, their interface;
`catalog.py` finds an encoding by its name.
"""
