"""The relay of the radio: it decides which robots receive which frames, and accounts for every byte.

It imports `protocol` only. Start with `radio.py`, the rounds of a step; then `admission.py`, the checks of frames;
`medium.py` and `channel.py`, which carry them; `frame_log.py` and `ledger.py`, the account. `process.py` is the shell
around it, and `access.py` the access control of the hub.
"""
