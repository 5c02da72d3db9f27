"""Predictive coding of maps: receivers are sent only what they cannot predict from the grid that they hold.

`stream` is the sequence of a map's updates, and the grid that author and receivers hold after each of them. `coder` is
the arithmetic coder. What an update contains depends on the laser:

exact    scans, which receivers predict by ray casting: `contexts`, `scan_updates`, `scan_stream`
noisy    tiles of the author's grid, within a bounded error (`agent.mapping.bound`): `mixer`, `tiles`, `block_tiles`,
         `tile_stream`

On narrow media, `wall_model` and `pose_model` predict scans better. `model_table` reads trained models.

`author`, with `scan_author` and `tile_author`, decides when an update is encoded. `history` holds decoded updates, and
`shared_decoder` decodes them once for all robots of a process.
"""
