"""The radio: who hears whom, how much goes on the air, and the ledger of every byte.

It imports `protocol` only. Begin with `radio.py`, one step of the medium; `process.py` is the relay around it,
`access.py` who may say what on the hub.
"""
