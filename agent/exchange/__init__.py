"""How maps are shared: what is sent of them, and to whom and when.

What: `polygon`, `laser`, `predictive`, `none`. To whom and when: `session`, `gossip`. It stands on `agent.outline` and
`agent.predictive`. Begin with `base.py`, what every exchange does, and `session.py`, the handshakes that carry the logs;
`gossip.py` is their alternative by broadcast; `catalog.py` has all by name.
"""
