"""Replication of map logs among robots: every robot ends up with every entry, over a narrow or lossy radio.

Begin with `engine`, the interface and its implementations. Then read `replica`, `peers` and `log` (what robots hold),
`policies` and `gossip_policy` (which log ranges to send), `handshakes`, `acked_frames` and `gossip` (how they travel).
"""
