"""Arrival of frames in tests that do not test the reachability check: late, and from a robot that forwards the map."""

LATE = {"step": 100_000, "sender": -1}
