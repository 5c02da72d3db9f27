"""Mapping: from the scans of a laser to a robot's own grid.

Begin with `mapper`. Exact readings are drawn; for lasers with errors, `estimator` has integer log odds per cell.
Copies of a noisy map may differ from it within a `bound`, which says what teammates must be sent. `block_bound` does so
for copies at half resolution.
"""
