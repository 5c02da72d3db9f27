"""Predictive coding of maps: receivers are sent only what they cannot predict from the grid that they hold.

Of exact lasers, updates contain scans, which a receiver predicts by ray casting: `scan_updates` codes their prediction
errors, `scan_stream` the sequence of a map's updates, and `scan_author` decides when to send one. Of noisy lasers,
updates contain tiles of the grid, within a bounded error: `tiles`, `tile_stream`, and `tile_author`. Both share
`stream`, the dependencies between maps, and `coder`, the arithmetic coder. `contexts` and `mixer` are its probability
models.
"""
