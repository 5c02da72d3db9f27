"""Replication of map logs among robots: every robot ends up with every entry, over a narrow or lossy radio.

Read in this order: `engine` (the interface and its implementations), `replica`, `peers` and `log` (what robots hold),
`policies` and `gossip_policy` (which log ranges to send), `handshakes`, `acked_frames` and `gossip` (how they travel),
`delivery` (acknowledgments), `reports`, `neighbors`, `frame_builder`, `control_packets`. docs/replication.md has the
same story.
"""
