"""The radio: who hears whom, how much goes on the air, and the ledger of every byte.

It imports `protocol` only. Start with `radio.py`, one step of the medium; `process.py` is the relay around it,
`access.py` the access control of the hub.
"""
