"""How a robot's map is encoded for teammates: `polygons`, `scans`, `cells`, `predictive`, `none`.

Begin with `base.py`, the interface of all encodings; `catalog.py` has all by name.
"""
