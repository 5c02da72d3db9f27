"""Replication of map logs among robots: every robot ends up with every entry, over a narrow or lossy radio.

Read in this order: `engine` (what the rest of the robot uses), `replica` and `peers` (logs, version vectors, trust),
`policies` and `gossip_policy` (which log ranges to send), `handshakes`, `acked_frames` and `gossip` (how they travel),
`delivery` (acknowledgments), `frame_builder`, `log`. docs/replication.md tells the same story with its tables.
"""
