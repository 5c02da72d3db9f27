"""Mapping: from the scans of a laser to a robot's own grid.

Begin with `mapper`. Exact readings are drawn; for lasers with errors, `estimator` has integer log odds per cell.
"""
