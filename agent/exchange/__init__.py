"""How maps travel: what is told of them (`polygon`, `laser`, `none`), and to whom and when (`session`).

It stands on `agent.outline`. Begin with `base.py`, what every exchange does, and `session.py`, the handshakes
that carry the logs; `catalogue.py` has the exchanges by name.
"""
