"""Mapping: from the scans of a laser to a robot's own grid.

Begin with `mapper`. Exact readings are drawn; for lasers with errors, `estimator` has integer log odds per cell.
`bound` chooses the cells of this grid that teammates must be sent if their copies may have a bounded error, and
`block_bound` those of copies at half resolution.
"""
