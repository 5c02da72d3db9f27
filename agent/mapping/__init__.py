"""Mapping: from noisy scans to a grid.

Begin with `estimator`: integer log odds per cell, with hysteresis. `bound` then decides what of it is shared.
"""
