"""Radios without a relay: robots send sealed frames to each other, over UDP or a serial modem (docs/field.md).

    sealing, replay_window        what a frame proves: a key holder of the team sent it, and it is no replay
    team_key, session_file        the shell of these: the key file, and the counters that survive restarts
    pacing, neighbors             when this robot may send, and which teammates it received recently
    peer_medium                   the core: it turns sealed frames into the events that a relay reports, and back
    transport, udp, serial_modem  where frames go

The cores read no clock: callers pass the time in nanoseconds, of a clock that never goes back.
"""
