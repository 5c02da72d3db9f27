"""Mapping: from noisy scans to a grid.

Begin with `estimator`: integer log odds per cell, with hysteresis.
"""
