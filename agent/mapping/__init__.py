"""Mapping: from the scans of a laser to a robot's own grid.

Begin with `mapper`. Exact readings are drawn; for lasers with errors, `estimator` has integer log odds per cell.
Teammates' copies of a noisy map may differ from it within a bound: `bound` chooses the cells that must be sent to keep
it, and `block_bound` those of copies at half resolution.
"""
